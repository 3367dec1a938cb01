// Writes a world: NAME.ffm (manifest), NAME.0000.ffs ... (strips), NAME.geometry.0000.ffs ... (drawing geometry).
// The world becomes valid only in finish(): shards are synced first, then the manifest by temp file, fsync, rename and
// directory fsync. A writer that is destroyed before finish() removes what it wrote. Not thread-safe: strips come in
// order from one thread. The bytes depend on nothing but the calls. Never linked by a reader.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/layout.h"
#include "formats/result.h"

namespace ff::formats {

// Encodes a strip to its stored bytes (header and compressed payload), to be passed to WorldWriter::addStrip.
// Pure and thread-safe, so that callers encode in parallel. Errors: the strip breaks a rule of FORMAT.md (our own bug
// or an unfit setting), compressor out of memory.
struct EncodedStrip {
  TileInfo info;  // shard and offset are set by the writer
  std::vector<std::byte> bytes;
};
Result<EncodedStrip> encodeStrip(const Strip& strip, const Box& bounds);

class WorldWriter {
 public:
  // path: the manifest to be, "out/town.ffm". Its folder must exist. shard_bytes: a shard is closed once it has this many.
  static Result<WorldWriter> create(const std::string& path, uint64_t shard_bytes = uint64_t{256} << 20);
  WorldWriter(WorldWriter&&) noexcept;
  WorldWriter& operator=(WorldWriter&&) noexcept;
  ~WorldWriter();

  // Order: levels from the coarsest to 0, tiles ascending from 0 within a level.
  Result<void> addStrip(EncodedStrip strip);
  // Level-0 tiles, ascending; every tile once or none at all. Positions are quantised to 16 bits over the tile's
  // bounds and triangles are kept in order.
  Result<void> addGeometry(const TileGeometry& geometry);
  // parents[l][i]: number of the parent at level l + 1 of node i of level l; one vector for each level but the last. They ascend within
  // a tile, where siblings are consecutive, and lie in one tile, whose number does not fall from one tile to the next.
  // cell_m[l]: grid cell edge. spatial_grid: a NanoVDB IntGrid (cell -> number of the level-0 tile that holds the
  // cell's first patch, + 1; 0: none), or empty.
  Result<void> finish(const WorldInfo& info, std::span<const std::vector<uint32_t>> parents,
                      std::span<const float> cell_m, std::span<const std::byte> spatial_grid);

 private:
  struct State;
  explicit WorldWriter(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace ff::formats
