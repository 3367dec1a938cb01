// Reads a world. Everything small (manifest, shard indices, parent links) is read by open(); strips and geometry are read
// on demand. All const members are thread-safe (files are read at offsets, there is no shared cursor). Every extent is checked
// against the file's size before memory is taken; what a file says can make a call fail, never crash.
#pragma once
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage.h"

namespace ff::formats {

struct ShardInfo {
  std::string name;     // beside the manifest
  uint64_t bytes = 0;
  bool geometry = false;
  int descriptor = -1;  // open for reading as long as the World lives, for asynchronous readers; never close it. -1: none
};

class World {
 public:
  // path: the .ffm file. Errors: kIo (missing, unreadable), kInvalidFile (each with place and remedy).
  static Result<World> open(const std::string& path, const StoragePtr& storage = posixStorage());
  World(World&&) noexcept;
  World& operator=(World&&) noexcept;
  ~World();

  const std::string& path() const;
  const WorldInfo& info() const;
  std::span<const LevelInfo> levels() const;              // [0] = patches
  std::span<const ShardInfo> shards() const;
  std::span<const TileInfo> tiles(uint32_t level) const;  // by tile number

  uint32_t tileOf(uint32_t level, uint32_t node) const;   // the tile that holds a node; node < levels()[level].nodes
  uint32_t parent(uint32_t level, uint32_t node) const;   // kNoParent at the top level; constant time
  // Numbers of the first and last + 1 nodes of level - 1 under `node`; level >= 1.
  std::pair<uint32_t, uint32_t> children(uint32_t level, uint32_t node) const;
  // Tiles form a tree: the tile of level + 1 that holds the parents of all of a tile's nodes. Not for the top level.
  uint32_t parentTile(TileId id) const;
  // Numbers of the first and last + 1 tiles of level - 1 whose parent tile is `id`; level >= 1.
  std::pair<uint32_t, uint32_t> childTiles(TileId id) const { return childTiles(id.level, id.tile, id.tile + 1); }
  // Likewise of the tiles first..end - 1, at least one, of a level: children of consecutive tiles are consecutive.
  std::pair<uint32_t, uint32_t> childTiles(uint32_t level, uint32_t first, uint32_t end) const;
  // Index of the node's parent within its tile's parent tile. Not for the top level; constant time.
  uint32_t placeOfParent(uint32_t level, uint32_t node) const;

  // Decodes stored bytes (TileInfo::stored_bytes of them, read from TileInfo::offset of the shard by any means) into
  // `out`, whose vectors are reused. Checks the checksum (mixed with id and offset) and every rule of FORMAT.md.
  Result<void> decodeStrip(TileId id, std::span<const std::byte> stored, Strip& out) const;
  // Reads them; out: TileInfo::stored_bytes.
  Result<void> readStored(TileId id, std::span<std::byte> out, const ReadOptions& options = {}) const;
  // Reads and decodes.
  Result<Strip> strip(TileId id) const;
  // Drawing geometry of a level-0 tile; kInvalidFile if the world has none.
  bool hasGeometry() const;
  Result<TileGeometry> geometry(uint32_t tile) const;
  // The NanoVDB grid as written, 32-byte aligned; empty if there is none.
  std::span<const std::byte> spatialGrid() const;

 private:
  struct State;
  explicit World(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace ff::formats
