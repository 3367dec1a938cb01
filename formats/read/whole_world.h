// A world whose index has all been read, for what looks at every tile: checks, exports, charts, solves of the whole. Nodes and tiles have their
// numbers in the world's order, so that arrays can be made of them. Takes memory and reads in proportion to the world; what
// streams takes a World.
#pragma once
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "formats/read/reader.h"

namespace ff::formats {

// A node's number within its level, or how many nodes there are: of a whole world, where 32 bits hold it.
constexpr uint32_t wholeNumber(uint64_t node) { return static_cast<uint32_t>(node); }

class WholeWorld : public World {
 public:
  // As World::open(); also checks that strips, geometry and chunks fill their shards, and the levels' totals. kUsage: a level has 2^32 - 1 nodes or more.
  static Result<WholeWorld> open(const std::string& path, const StoragePtr& storage = nullptr);

  std::span<const TileInfo> tiles(uint32_t level) const { return tiles_[level]; }  // by number
  std::span<const ChunkPtr> chunks(uint32_t level) const { return chunks_[level]; }
  TileRef ref(TileId id) const;
  // The tile that holds a node; node < levels()[level].nodes. Logarithmic.
  uint32_t tileOf(uint32_t level, uint64_t node) const;
  // Number of a node's parent at level + 1; kNoParent at the coarsest level.
  uint32_t parent(uint32_t level, uint64_t node) const;
  // Numbers of the nodes of level - 1 under a node, ascending; level >= 1.
  std::span<const uint32_t> children(uint32_t level, uint64_t node) const {
    const Children& c = children_[level];
    return std::span(c.node).subspan(c.start[node], c.start[node + 1] - c.start[node]);
  }

 private:
  explicit WholeWorld(World world) : World(std::move(world)) {}
  Result<void> readChunks();
  Result<void> checkShards() const;

  std::vector<std::vector<TileInfo>> tiles_;   // by level
  std::vector<std::vector<ChunkPtr>> chunks_;  // by level, in the world's order
  struct Children {
    std::vector<uint32_t> start, node;  // start: by parent
  };
  std::vector<Children> children_;      // by level; none at level 0
};

}  // namespace ff::formats
