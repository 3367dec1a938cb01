// The manifest (NAME.ffm) in memory and its parser. FORMAT.md section 2 describes the bytes.
#pragma once
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "formats/codec/chunk.h"
#include "formats/codec/records.h"
#include "formats/model.h"
#include "formats/result.h"

namespace ff::formats {

struct Manifest {
  WorldInfo info;
  std::vector<LevelInfo> levels;
  std::vector<ShardRecord> shards;
  ChunkPtr root;
};

// bytes: the whole file. Errors carry offsets but no file name. Memory taken is bounded by what the bytes really hold.
Result<Manifest> parseManifest(std::span<const std::byte> bytes);

// Rejects names that could leave the manifest's folder.
bool isPlainFileName(const std::string& name);

}  // namespace ff::formats
