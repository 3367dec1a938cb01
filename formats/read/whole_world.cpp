#include "formats/read/whole_world.h"

#include <algorithm>
#include <new>
#include <numeric>
#include <tuple>

#include "formats/codec/records.h"

namespace ff::formats {
namespace {

constexpr uint64_t kMaxNodes = 0xfffffffeu;  // of a level: arrays over them have numbers of 32 bits

}  // namespace

Result<WholeWorld> WholeWorld::open(const std::string& path, const StoragePtr& storage) try {
  auto opened = World::open(path, storage);
  if (!opened) return opened.error();
  for (size_t l = 0; l < opened->levels().size(); ++l)
    if (const uint64_t nodes = opened->levels()[l].nodes; nodes > kMaxNodes)
      return Error{ErrorCode::kUsage, path, "", "level " + std::to_string(l) + " has " + std::to_string(nodes) + " nodes, and what reads a whole world numbers " + std::to_string(kMaxNodes) + " at most",
                   "look at places of it: ffinspect info, locate, tile, row and pair, or the run time"};
  WholeWorld world(std::move(*opened));
  world.expectAll();
  if (auto ok = world.readChunks(); !ok) return ok.error();
  if (auto ok = world.checkShards(); !ok) return ok.error();
  return world;
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, path, "", "out of memory for the whole index", "close other programs"};
}

Result<void> WholeWorld::readChunks() {
  const size_t n = levels().size();
  tiles_.resize(n);
  chunks_.resize(n);
  children_.resize(n);
  std::vector<ChunkPtr> above{root()};
  for (size_t l = n; l-- > 0;) {
    uint64_t records = 0;
    for (const ChunkPtr& chunk : above)
      for (uint32_t k = 0; k < chunk->children.size(); ++k) {
        records += chunk->children[k].record.stored_bytes;
        auto below = child(chunk, k);
        if (!below) return below.error();
        tiles_[l].insert(tiles_[l].end(), (*below)->tiles.begin(), (*below)->tiles.end());
        chunks_[l].push_back(std::move(*below));
      }
    above = chunks_[l];
    if (l + 1 < n) {
      std::vector<uint32_t> parents;
      parents.reserve(levels()[l].nodes);
      for (const ChunkPtr& chunk : chunks_[l])
        for (uint32_t t = 0; t < chunk->tiles.size(); ++t)
          for (const uint8_t index : chunk->parentIndexOf(t)) parents.push_back(wholeNumber(tiles_[l + 1][chunk->tiles[t].parent_tile].first_node + index));
      auto& [start, below] = children_[l + 1];
      start.assign(levels()[l + 1].nodes + 1, 0);
      for (const uint32_t p : parents) ++start[p + 1];
      std::partial_sum(start.begin(), start.end(), start.begin());
      std::vector<uint32_t> next(start.begin(), start.end() - 1);
      below.resize(parents.size());
      for (uint32_t node = 0; node < parents.size(); ++node) below[next[parents[node]]++] = node;
    }
    LevelInfo sum;
    for (const TileInfo& tile : tiles_[l]) {
      sum.entries += tile.entries;
      sum.stored_bytes += tile.strip.stored_bytes;
    }
    sum.stored_bytes += records;
    if (sum.entries != levels()[l].entries || sum.stored_bytes != levels()[l].stored_bytes)
      return Error{ErrorCode::kInvalidFile, path(), "level " + std::to_string(l), "the index does not hold what the manifest promises", "restore the world's files from one copy, or bake again"};
  }
  return {};
}

// What lies in a shard follows each other from its header to its end. Several may share bytes that are the same.
Result<void> WholeWorld::checkShards() const {
  std::vector<std::tuple<uint32_t, uint64_t, uint64_t>> extents;  // shard, first byte, end
  const auto add = [&](const Extent& e) { extents.emplace_back(e.shard, e.offset, e.offset + e.stored_bytes); };
  for (const auto& chunks : chunks_)
    for (const ChunkPtr& chunk : chunks) {
      for (const TileInfo& tile : chunk->tiles) add(tile.strip);
      for (const GeometryInfo& geometry : chunk->geometry) add(geometry.strip);
      for (const ChildChunk& below : chunk->children) add(below.record);
    }
  for (const ChildChunk& below : root()->children) add(below.record);
  std::ranges::sort(extents);
  extents.erase(std::unique(extents.begin(), extents.end()), extents.end());
  size_t k = 0;
  for (uint32_t shard = 0; shard < shards().size(); ++shard) {
    if (auto opened = descriptor(shard); !opened) return opened.error();
    uint64_t next = kShardHeaderBytes;
    for (; k < extents.size() && std::get<0>(extents[k]) == shard && std::get<1>(extents[k]) == next; ++k) next = std::get<2>(extents[k]);
    if (next != shards()[shard].bytes)
      return Error{ErrorCode::kInvalidFile, folderOf(path()) + shards()[shard].name, "offset " + std::to_string(next), "bytes that nothing names, or that two name",
                   "restore the world's files from one copy, or bake again"};
  }
  if (k != extents.size()) return Error{ErrorCode::kInvalidFile, path(), "", "names bytes in a shard that is not there", "restore the world's files from one copy, or bake again"};
  return {};
}

TileRef WholeWorld::ref(TileId id) const {
  const auto after = std::ranges::upper_bound(chunks_[id.level], id.tile, {}, [](const ChunkPtr& c) { return c->firstTile(); });
  const ChunkPtr& chunk = *(after - 1);
  return {chunk, id.tile - chunk->firstTile()};
}

uint32_t WholeWorld::tileOf(uint32_t level, uint64_t node) const {
  const auto after = std::ranges::upper_bound(tiles_[level], node, {}, &TileInfo::first_node);
  return (after - 1)->id.tile;
}

uint32_t WholeWorld::parent(uint32_t level, uint64_t node) const {
  if (level + 1 >= tiles_.size()) return kNoParent;
  const TileRef tile = ref({level, tileOf(level, node)});
  return wholeNumber(tile.parent().info().first_node + tile.parentIndex()[node - tile.info().first_node]);
}

}  // namespace ff::formats
