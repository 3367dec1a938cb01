// The index of a world: a tree of chunks (model.h). Each chunk's index is a record of its own that names its tiles and, with their checksums,
// the records of its children; so a reader holds the chunks near it and no others, and the root in the manifest vouches for
// every byte of a world. Immutable once read: shared by all who need it, freed by the last.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"

namespace ff::formats {

// How many tiles and nodes there are of a level.
struct LevelCount {
  uint64_t tiles = 0, nodes = 0;
  LevelCount& operator+=(const LevelCount& other) {
    tiles += other.tiles, nodes += other.nodes;
    return *this;
  }
  friend bool operator==(const LevelCount&, const LevelCount&) = default;
};

// What a chunk says of one of its children.
struct ChildChunk {
  ChunkCell cell{};
  Extent record;
  Box bounds;                      // m, of the tiles of its own level
  std::vector<LevelCount> counts;  // by level, 0 to its own: of all that lies in it
};

struct Chunk;
using ChunkPtr = std::shared_ptr<const Chunk>;

struct Chunk : std::enable_shared_from_this<Chunk> {
  uint32_t level = 0;
  ChunkCell cell{};
  uint32_t first_number = 0;           // of tiles: those of one cell may stand in several records, where a coarse cell has more nodes than a tile
  std::vector<TileInfo> tiles;
  std::vector<uint8_t> parent_index;   // by node, in the order of tiles: index of its parent within the tile's parent tile. None at the coarsest level.
  std::vector<GeometryInfo> geometry;  // of level 0, by tile; none without drawing geometry
  std::vector<ChildChunk> children;    // in the world's order
  std::vector<uint8_t> child_octants;  // of these, octantOf(): a search asks all of them; none of the root's
  std::vector<LevelCount> first;       // by level, 0 to its own: numbers of the first tile and node of all that lies in it
  mutable std::vector<std::weak_ptr<const Chunk>> children_here;  // World's, under its lock: of the children, those that somebody holds; empty until one was read
  ChunkPtr parent;                     // of the coarsest level's chunks: the root, which has no tiles and lies one level higher

  uint32_t firstTile() const { return static_cast<uint32_t>(first[level].tiles); }
  uint64_t firstNode() const { return first[level].nodes; }
  bool isTop() const { return parent_index.empty(); }
  // By node of a tile: the part of parent_index.
  std::span<const uint8_t> parentIndexOf(uint32_t tile) const {
    return std::span(parent_index).subspan(tiles[tile].first_node - firstNode(), tiles[tile].nodes);
  }
  // Number of the first tile of a child, of the child's own level.
  uint32_t firstTileOf(uint32_t child) const;
  // The child that holds tile number `tile` of the level below; the caller knows that one does.
  uint32_t childWith(uint32_t tile) const;
};

// A tile whose chunk has been read.
struct TileRef {
  ChunkPtr chunk;
  uint32_t index = 0;  // in chunk->tiles
  const TileInfo& info() const { return chunk->tiles[index]; }
  TileId id() const { return info().id; }
  TileName name() const { return {chunk->cell, chunk->first_number + index}; }
  // Not of the coarsest level.
  TileRef parent() const { return {chunk->parent, info().parent_tile - chunk->parent->firstTile()}; }
  // By node of the tile: index of its parent in parent(). Not of the coarsest level.
  std::span<const uint8_t> parentIndex() const { return chunk->parentIndexOf(index); }
};

// Where a strip's partner tiles lie: those of the blocks behind the part before, up to end_block.
struct PartnerChunk {
  ChunkPtr chunk;
  size_t end_block = 0;
};

// "tile 12 of chunk 3,-1,0 of level 2"
std::string tileText(const TileRef& tile);

// Corner of a chunk with the lowest coordinates, m. Bounds and drawing geometry in files count from there.
std::array<double, 3> chunkCorner(const WorldInfo& world, uint32_t level, const ChunkCell& cell);
// Into the coordinates of a file, and back.
Vec3 lessCorner(Vec3 point, const std::array<double, 3>& corner);
Vec3 plusCorner(Vec3 point, const std::array<double, 3>& corner);
inline Box lessCorner(const Box& box, const std::array<double, 3>& corner) { return {lessCorner(box.lo, corner), lessCorner(box.hi, corner)}; }
inline Box plusCorner(const Box& box, const std::array<double, 3>& corner) { return {plusCorner(box.lo, corner), plusCorner(box.hi, corner)}; }

// "chunk 3,-1,0 of level 2"
std::string chunkText(uint32_t level, const ChunkCell& cell);

// The chunk of the level above that holds a chunk.
constexpr ChunkCell parentCell(const ChunkCell& cell) { return {cell[0] >> 1, cell[1] >> 1, cell[2] >> 1}; }
// In which eighth of that it lies: a bit an axis.
constexpr uint8_t octantOf(const ChunkCell& cell) { return static_cast<uint8_t>((cell[0] & 1) | (cell[1] & 1) << 1 | (cell[2] & 1) << 2); }

// Reads a chunk's record, decompressed. parent: a chunk or the root, whose child number `child` it is. The record is checked against what
// the parent says of it, and against itself. Errors carry no file name.
Result<ChunkPtr> decodeChunk(const WorldInfo& world, const ChunkPtr& parent, uint32_t child, std::span<const std::byte> raw);
// The record of a chunk, not compressed. Child tiles of the chunk's tiles are told by the children's number and place.
std::vector<std::byte> encodeChunk(const WorldInfo& world, const Chunk& chunk);

// The root, as the manifest holds it.
Result<ChunkPtr> decodeRoot(std::span<const LevelInfo> levels, std::span<const std::byte> bytes);
std::vector<std::byte> encodeRoot(std::span<const ChildChunk> chunks);

}  // namespace ff::formats
