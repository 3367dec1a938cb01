// Writes a world: NAME.ffm (manifest), NAME.HASH.ffs ... (strips), NAME.geometry.HASH.ffs ... (drawing geometry), NAME.index.HASH.ffs
// (the chunks); HASH is of a shard's content. The world becomes valid only in finish(): the shards are synced and named, beside those of a world that was
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
#include "formats/storage/storage.h"

namespace ff::formats {

// Encodes a strip to its stored bytes (header and compressed payload), to be passed to WorldWriter::addStrip.
// Pure and thread-safe, so that callers encode in parallel. Errors: the strip breaks a rule of FORMAT.md (our own bug
// or an unfit setting), compressor out of memory.
// The bytes depend on nothing outside the strip but how far its partners' chunks lie from its own. names: of all tiles of its level, by number.
struct EncodedStrip {
  TileInfo info;  // the rest of it is set by the writer
  TileName name;
  uint32_t quanta = 0;  // samples of the row that has most
  std::vector<std::byte> bytes;
};
Result<EncodedStrip> encodeStrip(const Strip& strip, const Box& bounds, std::span<const TileName> names);

class WorldWriter {
 public:
  // Claims it, until the writer is destroyed: of two that write one world the second is refused. path: the manifest to be, "out/town.ffm". Its folder must exist. shard_bytes: a shard is closed once it has this many.
  static Result<WorldWriter> create(const std::string& path, uint64_t shard_bytes = uint64_t{256} << 20, StoragePtr storage = posixStorage());
  WorldWriter(WorldWriter&&) noexcept;
  WorldWriter& operator=(WorldWriter&&) noexcept;
  ~WorldWriter();

  // Order: levels from the coarsest to 0, tiles ascending from 0 within a level. The tiles of a chunk are numbered from 0 in this order; they need not follow each other.
  Result<void> addStrip(EncodedStrip strip);
  // Level-0 tiles, ascending, after all strips; every tile once or none at all. Positions are quantised to 16 bits over the tile's
  // bounds and triangles are kept in order. world: cell_m alone is looked at.
  Result<void> addGeometry(const TileGeometry& geometry, const WorldInfo& world);
  // parents[l][i]: number of the parent at level l + 1 of node i of level l; one vector for each level but the last. Those of
  // a tile's nodes lie in one tile, whose number does not fall from one tile to the next; siblings lie in one tile.
  // The child tiles of a tile lie in one chunk, which lies in the tile's own.
  // What could not be done without harm to the world is a warning in warnings(): a folder that cannot be synced, an old shard
  // that cannot be removed.
  Result<void> finish(const WorldInfo& info, std::span<const std::span<const uint32_t>> parents);
  Result<void> finish(const WorldInfo& info, std::span<const std::vector<uint32_t>> parents) {
    return finish(info, std::vector<std::span<const uint32_t>>(parents.begin(), parents.end()));
  }

  std::span<const std::string> warnings() const;  // a line each

 private:
  struct State;
  explicit WorldWriter(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace ff::formats
