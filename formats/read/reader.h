// Reads a world. open() reads the manifest alone, whatever the world's size. The index is a tree of chunks (chunk.h) that are read on
// demand, shared while someone holds them, and forgotten again; strips and geometry are read on demand and belong to the caller. All const
// members are thread-safe (files are read at offsets, there is no shared cursor). Every extent is checked
// against the file's size before memory is taken; what a file says can make a call fail, never crash.
#pragma once
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/codec/chunk.h"
#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::formats {

struct PartnerName;

// A chunk that may not have been read: its parent, and which child of that it is.
struct ChildRef {
  ChunkPtr parent;
  uint32_t child = 0;
  TileId id() const { return {parent->level - 1, parent->firstTileOf(child)}; }  // its first tile, by which it is known
};

struct ShardInfo {
  std::string name;     // beside the manifest
  uint64_t bytes = 0;
  uint32_t kind = 0;    // kKindRows, kKindGeometry, kKindIndex
};

class World {
 public:
  // path: the .ffm file, or its address. storage: null: storageFor(path). Errors: kIo (missing, unreadable), kInvalidFile (each with place and remedy).
  static Result<World> open(const std::string& path, const StoragePtr& storage = nullptr);
  World(World&&) noexcept;
  World& operator=(World&&) noexcept;
  ~World();

  const std::string& path() const;
  const WorldInfo& info() const;
  std::span<const LevelInfo> levels() const;              // [0] = patches
  uint32_t top() const { return static_cast<uint32_t>(levels().size()) - 1; }  // the coarsest level
  std::span<const ShardInfo> shards() const;
  // XXH3-64 of the manifest's bytes: other bakes have others.
  uint64_t checksum() const;
  // Opens all shards: from then on whatever becomes of their names is nothing to this world. Errors: one that is missing, or not what the manifest says.
  Result<void> openShards(const ReadOptions& options = {}) const;
  // Of a shard that is opened now if it was not: for asynchronous readers, valid as long as the World lives; never close it. -1: the storage has none.
  Result<int> descriptor(uint32_t shard, const ReadOptions& options = {}) const;
  // What will be read next. Over a network all of it is asked for at once, and this waits until it is here; else it does nothing. What fails is told by the reads.
  void bring(std::span<const Extent> extents, const ReadOptions& options = {}) const;

  // The index. All but root() may read.
  // Has no tiles; its children are the chunks of the coarsest level.
  const ChunkPtr& root() const;
  // The child number `child` of a chunk; the same object for all who hold it at one time.
  Result<ChunkPtr> child(const ChunkPtr& parent, uint32_t child, const ReadOptions& options = {}) const;
  // Several that will be asked for by child(), as bring().
  void bringChildren(std::span<const ChildRef> children, const ReadOptions& options = {}) const;
  // By number. kUsage: there is no such tile.
  Result<TileRef> tile(TileId id) const;
  // kUsage: there is no such tile.
  Result<TileRef> tile(uint32_t level, const TileName& name) const;
  // The tile that holds a node of a level, by number. kUsage: there is no such node.
  Result<TileRef> tileOfNode(uint32_t level, uint64_t node) const;
  // The tiles whose parent tile is `tile`, of level - 1: they lie in one chunk. first, last + 1: numbers within it. level >= 1.
  struct Tiles {
    ChunkPtr chunk;
    uint32_t first = 0, end = 0;
  };
  Result<Tiles> childTiles(const TileRef& tile, const ReadOptions& options = {}) const;

  // Where a strip's partner tiles lie, for those who look further.
  using PartnerChunks = std::vector<PartnerChunk>;
  // Decodes stored bytes (of `tile`'s strip, read by any means) into `out`, whose vectors are reused. Checks the checksum and every rule of
  // FORMAT.md. May read the index of the partners' chunks, all of one level together; partners: theirs, in the order of blocks, if it is not null.
  Result<void> decodeStrip(const TileRef& tile, std::span<const std::byte> stored, Strip& out, PartnerChunks* partners = nullptr, RowWords* words = nullptr,
                           const ReadOptions& options = {}) const;
  // Reads stored bytes. out: Extent::stored_bytes.
  Result<void> readStored(const Extent& extent, std::span<std::byte> out, const ReadOptions& options = {}) const;
  // Reads and decodes.
  Result<Strip> strip(const TileRef& tile) const;
  Result<Strip> strip(TileId id) const;
  // Drawing geometry of a level-0 tile; kInvalidFile if the world has none.
  bool hasGeometry() const;
  Result<TileGeometry> geometry(const TileRef& tile, const ReadOptions& options = {}) const;
  Result<TileGeometry> geometry(uint32_t tile) const;

 protected:
  // That all of it will be read, so that a storage that is slow to answer is asked for much at a time. Before anything is read.
  void expectAll();

 private:
  struct State;
  explicit World(std::unique_ptr<State> state);
  ChunkPtr childHere(const Chunk& parent, uint32_t child) const;  // null: nobody holds it
  Result<void> readChildren(std::span<const ChildRef> children, std::vector<ChunkPtr>& read, const ReadOptions& options = {}) const;
  Result<size_t> findPartners(const TileRef& tile, std::span<const PartnerName> names, PartnerChunks& partners, const ReadOptions& options) const;
  Result<ChunkPtr> chunkWith(uint32_t level, uint64_t LevelCount::*what, uint64_t number) const;
  std::unique_ptr<State> state_;
};

}  // namespace ff::formats
