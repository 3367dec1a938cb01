// Writes a world: NAME.ffm (manifest), NAME.HASH.ffs ... (strips), NAME.geometry.HASH.ffs ... (drawing geometry); HASH is of a
// shard's content. The world becomes valid only in finish(): the shards are synced and named, beside those of a world that was
// there before under the same NAME, then the manifest takes the place of the old one in a single step, and only then the shards
// that it does not name are removed. Whatever happens at any moment, there is the old world or the new one. A writer that is
// destroyed before finish() removes what it wrote. Not thread-safe: strips come in order from one thread. The bytes depend on
// nothing but the calls. Never linked by a reader.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage.h"

namespace ff::formats {

// Encodes a strip to its stored bytes (header and compressed payload), to be passed to WorldWriter::addStrip.
// Pure and thread-safe, so that callers encode in parallel. Errors: the strip breaks a rule of FORMAT.md (our own bug
// or an unfit setting), compressor out of memory.
struct EncodedStrip {
  TileInfo info;  // shard and offset are set by the writer
  uint32_t quanta = 0;  // samples of the row that has most
  std::vector<std::byte> bytes;
};
Result<EncodedStrip> encodeStrip(const Strip& strip, const Box& bounds);

class WorldWriter {
 public:
  // path: the manifest to be, "out/town.ffm". Its folder must exist. shard_bytes: a shard is closed once it has this many.
  static Result<WorldWriter> create(const std::string& path, uint64_t shard_bytes = uint64_t{256} << 20, StoragePtr storage = posixStorage());
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
  // What could not be done without harm to the world is a warning in warnings(): a folder that cannot be synced, an old shard
  // that cannot be removed, a grid larger than maxGridBytes(), which is left out.
  Result<void> finish(const WorldInfo& info, std::span<const std::vector<uint32_t>> parents,
                      std::span<const float> cell_m, std::span<const std::byte> spatial_grid);

  std::span<const std::string> warnings() const;  // a line each

 private:
  struct State;
  explicit WorldWriter(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace ff::formats
