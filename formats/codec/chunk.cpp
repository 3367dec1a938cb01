#include "formats/codec/chunk.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <new>
#include <string>

#include "formats/codec/bytes.h"
#include "formats/codec/records.h"

namespace ff::formats {
namespace {

Error broken(uint32_t level, const ChunkCell& cell, const std::string& message) {
  return {ErrorCode::kInvalidFile, "", chunkText(level, cell), message, "restore the world's files from one copy, or bake again"};
}

bool isBox(const Box& box) { return !box.empty() && std::isfinite(length(box.hi - box.lo)) && std::isfinite(length(box.lo)); }

void readCounts(ByteReader& r, uint32_t levels, std::vector<LevelCount>& counts) {
  counts.resize(levels);
  for (LevelCount& c : counts) r.u64(c.tiles), r.u64(c.nodes);
}

void writeCounts(ByteWriter& w, std::span<const LevelCount> counts) {
  for (const LevelCount& c : counts) w.u64(c.tiles), w.u64(c.nodes);
}

// What is wrong with a child, whatever its parent; null: nothing.
const char* faultOf(const ChildChunk& child) {
  if (child.record.stored_bytes == 0 || child.record.raw_bytes < kChunkHeaderBytes || child.record.raw_bytes > kMaxChunkRawBytes) return "has a child of an impossible size";
  if (!isBox(child.bounds)) return "has a child with bounds that cannot be";
  for (const LevelCount& c : child.counts)
    if (c.tiles < 1 || c.tiles > kMaxLevelTiles || c.nodes < c.tiles || c.nodes > kTileNodes * c.tiles) return "has a child with numbers of tiles and nodes that cannot be";
  return nullptr;
}

// Each node of a parent tile has children, all in one tile.
const char* checkFamilies(const Chunk& chunk, const Chunk& parent) {
  std::array<uint32_t, kTileNodes> child_tile{};  // by parent; counted from 1
  size_t t = 0;
  for (const TileInfo& above : parent.tiles) {
    if (above.end_child <= chunk.firstTile() || above.first_child >= chunk.firstTile() + chunk.tiles.size()) continue;
    child_tile.fill(0);
    uint32_t families = 0;
    for (uint32_t number = above.first_child; number < above.end_child; ++number, ++t) {
      if (t >= chunk.tiles.size() || chunk.tiles[t].id.tile != number) return "has other tiles than its parent says";
      const uint32_t own = number - above.first_child + 1;
      for (const uint8_t index : chunk.parentIndexOf(static_cast<uint32_t>(t))) {
        if (index >= above.nodes) return "has a node whose parent is not there";
        if (child_tile[index] == own) continue;
        if (child_tile[index] != 0) return "has siblings in two tiles";
        child_tile[index] = own;
        ++families;
      }
    }
    if (families != above.nodes) return "has a parent without children";
  }
  return t == chunk.tiles.size() ? nullptr : "has tiles without parents";
}

}  // namespace

std::string chunkText(uint32_t level, const ChunkCell& c) {
  return "chunk " + std::to_string(c[0]) + "," + std::to_string(c[1]) + "," + std::to_string(c[2]) + " of level " + std::to_string(level);
}

std::string tileText(const TileRef& tile) { return "tile " + std::to_string(tile.name().tile) + " of " + chunkText(tile.chunk->level, tile.chunk->cell); }

uint32_t Chunk::firstTileOf(uint32_t child) const {
  uint64_t tile = first[level - 1].tiles;
  for (uint32_t k = 0; k < child; ++k) tile += children[k].counts[level - 1].tiles;
  return static_cast<uint32_t>(tile);
}

uint32_t Chunk::childWith(uint32_t tile) const {
  uint64_t before = first[level - 1].tiles;
  uint32_t k = 0;
  while (k + 1 < children.size() && before + children[k].counts[level - 1].tiles <= tile) before += children[k++].counts[level - 1].tiles;
  return k;
}

std::array<double, 3> chunkCorner(const WorldInfo& world, uint32_t level, const ChunkCell& cell) {
  const double edge = std::ldexp(static_cast<double>(world.cell_m), static_cast<int>(level) + kChunkLog);
  return {edge * cell[0], edge * cell[1], edge * cell[2]};
}

Vec3 lessCorner(Vec3 point, const std::array<double, 3>& corner) {
  for (int a = 0; a < 3; ++a) point[a] = static_cast<float>(static_cast<double>(point[a]) - corner[static_cast<size_t>(a)]);
  return point;
}

Vec3 plusCorner(Vec3 point, const std::array<double, 3>& corner) {
  for (int a = 0; a < 3; ++a) point[a] = static_cast<float>(static_cast<double>(point[a]) + corner[static_cast<size_t>(a)]);
  return point;
}

Result<ChunkPtr> decodeChunk(const WorldInfo& world, const ChunkPtr& parent, uint32_t number, std::span<const std::byte> raw) try {
  const ChildChunk& self = parent->children[number];
  auto chunk = std::make_shared<Chunk>();
  Chunk& c = *chunk;
  c.level = parent->level - 1;
  c.cell = self.cell;
  c.parent = parent;
  const bool top = parent->tiles.empty();
  c.first.assign(parent->first.begin(), parent->first.begin() + c.level + 1);
  for (uint32_t k = 0; k < number; ++k)
    for (uint32_t l = 0; l <= c.level; ++l) c.first[l] += parent->children[k].counts[l];
  const auto bad = [&](const std::string& what) { return broken(c.level, c.cell, what); };
  const std::array<double, 3> corner = chunkCorner(world, c.level, c.cell);

  ByteReader r(raw);
  ChunkHeader head;
  ChunkHeader::fields(r, head);
  if (head.magic != kChunkMagic || head.level != c.level) return bad("is the record of another chunk");
  const bool geometry = head.geometry != 0;
  if (head.tiles < 1 || head.tiles > kMaxChunkTiles || head.nodes < head.tiles || head.nodes > uint64_t{kTileNodes} * head.tiles ||
      head.geometry > 1 || (geometry && c.level != 0) || (head.children == 0) != (c.level == 0) || head.first_number > kMaxChunkTiles - head.tiles)
    return bad("has numbers of tiles, nodes or children that cannot be");
  const uint64_t expected = kChunkHeaderBytes + uint64_t{kTileRecordBytes} * head.tiles + (geometry ? uint64_t{kGeometryRecordBytes} * head.tiles : 0) +
                            (top ? 0 : head.nodes) + head.children * (kChildRecordBytes + kLevelCountBytes * uint64_t{c.level});
  if (expected != raw.size()) return bad("has " + std::to_string(raw.size()) + " bytes instead of " + std::to_string(expected));

  c.first_number = head.first_number;
  c.tiles.resize(head.tiles);
  std::vector<TileRecord> records(head.tiles);
  uint32_t nodes = 0;
  for (uint32_t t = 0; t < head.tiles; ++t) {
    TileRecord& x = records[t];
    TileRecord::fields(r, x);
    TileInfo& info = c.tiles[t];
    if (x.nodes < 1 || x.nodes > kTileNodes || x.strip.stored_bytes < kStripHeaderBytes || x.strip.raw_bytes > kMaxStripRawBytes ||
        (c.level == 0 && (x.child != 0 || x.first_child != 0 || x.child_tiles != 0)))
      return bad("tile " + std::to_string(t) + " holds a value that cannot be");
    info.id = {c.level, c.firstTile() + t};
    info.strip = x.strip;
    info.first_node = c.firstNode() + nodes;
    info.nodes = x.nodes;
    info.entries = x.entries;
    info.bounds = plusCorner(x.bounds, corner);
    if (!isBox(x.bounds) || !isBox(info.bounds)) return bad("tile " + std::to_string(t) + " has bounds that cannot be");
    nodes += x.nodes;
    if (top) {
      if (x.parent != 0xffff) return bad("tile " + std::to_string(t) + " has a parent above the coarsest level");
      continue;
    }
    if (x.parent >= parent->tiles.size() || (t > 0 && x.parent < records[t - 1].parent)) return bad("tile " + std::to_string(t) + " has no parent, or tiles are not in the order of these");
    info.parent_tile = parent->firstTile() + x.parent;
    if (const TileInfo& above = parent->tiles[x.parent]; info.id.tile < above.first_child || info.id.tile >= above.end_child)
      return bad("tile " + std::to_string(t) + " and its parent disagree");
  }
  if (nodes != head.nodes) return bad("has other nodes than its tiles");
  if (geometry) {
    c.geometry.resize(head.tiles);
    for (GeometryInfo& g : c.geometry) {
      GeometryRecord::fields(r, g);
      if (g.strip.stored_bytes < kStripHeaderBytes || g.triangles > kMaxGeometryTriangles) return bad("has geometry of an impossible size");
    }
  }
  if (!top) {
    c.parent_index.resize(nodes);
    r.bytes(c.parent_index);  // steps, until they are added up
    for (const TileInfo& tile : c.tiles)
      for (uint64_t first = tile.first_node - c.firstNode(), i = 1; i < tile.nodes; ++i)
        c.parent_index[first + i] = static_cast<uint8_t>(c.parent_index[first + i] + c.parent_index[first + i - 1]);
  }
  std::vector<LevelCount> counts(c.level + 1);
  counts[c.level] = {head.tiles, head.nodes};
  for (uint32_t k = 0; k < head.children; ++k) {
    ChildChunk& child = c.children.emplace_back();
    uint8_t octant = 0;
    r.u8(octant), r.reserved(3);
    ExtentRecord::fields(r, child.record);
    r.box(child.bounds);
    readCounts(r, c.level, child.counts);
    if (octant > 7) return bad("has a child outside it");
    c.child_octants.push_back(octant);
    for (size_t a = 0; a < 3; ++a) child.cell[a] = static_cast<int32_t>(static_cast<uint32_t>(c.cell[a]) * 2 + (octant >> a & 1u));
    child.bounds = plusCorner(child.bounds, corner);
    if (const char* fault = faultOf(child)) return bad(fault);
    for (uint32_t l = 0; l < c.level; ++l) counts[l] += child.counts[l];
  }
  if (r.reservedUsed()) return bad("uses a reserved byte");
  if (counts != self.counts) return bad("holds other tiles and nodes than its parent says");
  // Child tiles: ranges that follow each other, each within one child.
  if (c.level > 0) {
    uint32_t k = 0, next = 0;
    for (uint32_t t = 0; t < head.tiles; ++t) {
      const TileRecord& x = records[t];
      if (x.child == k + 1u && next == c.children[k].counts[c.level - 1].tiles) ++k, next = 0;
      if (x.child != k || x.first_child != next || x.child_tiles < 1 || x.child_tiles > c.children[k].counts[c.level - 1].tiles - next)
        return bad("tile " + std::to_string(t) + " has child tiles that do not follow those of the tile before");
      c.tiles[t].first_child = c.firstTileOf(k) + next;
      next += x.child_tiles;
      c.tiles[t].end_child = c.firstTileOf(k) + next;
    }
    if (k + 1 != c.children.size() || next != c.children[k].counts[c.level - 1].tiles) return bad("has child tiles without a parent");
  }
  if (!top)
    if (const char* fault = checkFamilies(c, *parent)) return bad(fault);
  return ChunkPtr(std::move(chunk));
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, "", "", "out of memory for a chunk's index", "close other programs"};
}

std::vector<std::byte> encodeChunk(const WorldInfo& world, const Chunk& c) {
  const std::array<double, 3> corner = chunkCorner(world, c.level, c.cell);
  ByteWriter w;
  ChunkHeader head;
  head.level = static_cast<uint8_t>(c.level);
  head.geometry = c.geometry.empty() ? 0 : 1;
  head.children = static_cast<uint16_t>(c.children.size());
  head.tiles = static_cast<uint32_t>(c.tiles.size());
  for (const TileInfo& t : c.tiles) head.nodes += t.nodes;
  head.first_number = c.first_number;
  ChunkHeader::fields(w, head);
  for (const TileInfo& t : c.tiles) {
    TileRecord x;
    x.nodes = static_cast<uint16_t>(t.nodes);
    x.parent = c.isTop() ? uint16_t{0xffff} : static_cast<uint16_t>(t.parent_tile - c.parent->firstTile());
    if (c.level > 0) {
      const uint32_t k = c.childWith(t.first_child);
      x.child = static_cast<uint16_t>(k);
      x.first_child = static_cast<uint16_t>(t.first_child - c.firstTileOf(k));
      x.child_tiles = static_cast<uint16_t>(t.end_child - t.first_child);
    }
    x.strip = t.strip;
    x.entries = t.entries;
    x.bounds = lessCorner(t.bounds, corner);
    TileRecord::fields(w, x);
  }
  for (const GeometryInfo& g : c.geometry) GeometryRecord::fields(w, g);
  if (!c.isTop())
    for (uint32_t t = 0; t < c.tiles.size(); ++t) {
      uint8_t before = 0;
      for (const uint8_t index : c.parentIndexOf(t)) {
        w.u8(static_cast<uint8_t>(index - before));
        before = index;
      }
    }
  for (const ChildChunk& child : c.children) {
    w.u8(octantOf(child.cell)), w.reserved(3);
    ExtentRecord::fields(w, child.record);
    w.box(lessCorner(child.bounds, corner));
    writeCounts(w, child.counts);
  }
  return std::move(w.data());
}

Result<ChunkPtr> decodeRoot(std::span<const LevelInfo> levels, std::span<const std::byte> bytes) {
  auto root = std::make_shared<Chunk>();
  Chunk& c = *root;
  c.level = static_cast<uint32_t>(levels.size());
  c.first.resize(c.level + 1);
  const auto bad = [](const std::string& what) { return Error{ErrorCode::kInvalidFile, "", "chunks of the coarsest level", what, "restore the manifest from a copy, or bake again"}; };
  ByteReader r(bytes);
  std::vector<LevelCount> counts(c.level);
  while (r.ok() && r.remaining() > 0) {
    ChildChunk& child = c.children.emplace_back();
    for (int32_t& a : child.cell) {
      uint32_t bits = 0;
      r.u32(bits);
      a = static_cast<int32_t>(bits);
    }
    ExtentRecord::fields(r, child.record);
    r.box(child.bounds);
    readCounts(r, c.level, child.counts);
    if (!r.ok()) break;
    if (const char* fault = faultOf(child)) return bad(fault);
    for (uint32_t l = 0; l < c.level; ++l) counts[l] += child.counts[l];
  }
  if (!r.ok()) return bad("are cut off");
  for (uint32_t l = 0; l < c.level; ++l)
    if (counts[l] != LevelCount{levels[l].tiles, levels[l].nodes}) return bad("hold other tiles and nodes of level " + std::to_string(l) + " than the manifest says");
  return ChunkPtr(std::move(root));
}

std::vector<std::byte> encodeRoot(std::span<const ChildChunk> chunks) {
  ByteWriter w;
  for (const ChildChunk& child : chunks) {
    for (const int32_t a : child.cell) w.u32(static_cast<uint32_t>(a));
    ExtentRecord::fields(w, child.record);
    w.box(child.bounds);
    writeCounts(w, child.counts);
  }
  return std::move(w.data());
}

}  // namespace ff::formats
