// The manifest (NAME.ffm) in memory and its parser. FORMAT.md section 2 describes the bytes.
#pragma once
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/parent_links.h"
#include "formats/records.h"
#include "formats/result.h"

namespace ff::formats {

// NanoVDB asks for this alignment.
struct alignas(32) GridLine {
  std::byte bytes[32];
};

struct Manifest {
  WorldInfo info;
  std::vector<LevelInfo> levels;
  std::vector<ShardRecord> shards;
  std::vector<LevelLinks> links;  // of each level but the last; whether places fit the tiles, World::open() checks
  std::vector<GridLine> grid;
  size_t grid_bytes = 0;
};

// bytes: the whole file. Errors carry offsets but no file name. Memory taken is bounded by what the bytes really hold.
Result<Manifest> parseManifest(std::span<const std::byte> bytes);

// Bytes of a spatial grid, at most, in a world whose level 0 has `nodes` with parents: the links have vouched for those. Writers leave
// out a larger one (patches far apart); it serves look-ups by hand alone.
constexpr uint64_t maxGridBytes(uint64_t nodes) { return (uint64_t{4} << 20) + 512 * nodes; }

// Rejects names that could leave the manifest's folder.
bool isPlainFileName(const std::string& name);

}  // namespace ff::formats
