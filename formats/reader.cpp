#include "formats/reader.h"

#include <algorithm>
#include <new>

#include "formats/checksum.h"
#include "formats/geometry.h"
#include "formats/manifest.h"
#include "formats/shard.h"
#include "formats/strip_codec.h"

namespace ff::formats {

struct World::State {
  std::string path;
  Manifest manifest;
  std::vector<ShardInfo> shards;
  std::vector<std::unique_ptr<StoredFile>> files;  // of `shards`
  std::vector<std::string> shard_paths;
  // By level, then by tile.
  std::vector<std::vector<TileInfo>> tiles;
  std::vector<std::vector<uint64_t>> checksums;
  // By level: the tile of node 256 k; a tile has at most 256 nodes, so tileOf() has few tiles to look at.
  std::vector<std::vector<uint32_t>> tile_of_every_256th;
  // By level, then by node: number of the family (formats/parent_links.h) of its children; empty at level 0.
  std::vector<std::vector<uint32_t>> family_of_children;
  // Geometry by level-0 tile; empty without geometry.
  std::vector<ShardEntry> geometry;
};

namespace {

constexpr const char* kRemedy = "restore the world's files from one copy, or bake again";

Error inFile(Error e, const std::string& path) {
  if (e.file.empty()) e.file = path;
  return e;
}

// Tiles come from the coarsest level to level 0, ascending, without gaps: FORMAT.md section 3.4.
Result<void> takeEntries(std::vector<ShardEntry> entries, const Manifest& m, const std::string& path,
                         std::vector<std::vector<TileInfo>>& tiles, std::vector<std::vector<uint64_t>>& checksums,
                         size_t& level) {
  for (ShardEntry& e : entries) {
    const TileInfo& t = e.info;
    const auto bad = [&](const char* what) {
      return Error{ErrorCode::kInvalidFile, path,
                   "strip " + std::to_string(t.id.level) + ":" + std::to_string(t.id.tile) + " at offset " +
                       std::to_string(t.offset),
                   what, kRemedy};
    };
    while (level > 0 && tiles[level].size() == m.levels[level].tiles) --level;
    if (t.id.level != level || t.id.tile != tiles[level].size() || t.id.tile >= m.levels[level].tiles)
      return bad("is not the strip that should follow");
    const uint32_t first = tiles[level].empty() ? 0 : tiles[level].back().first_node + tiles[level].back().nodes;
    if (t.first_node != first || t.nodes < 1 || t.nodes > kTileNodes || t.nodes > m.levels[level].nodes - first)
      return bad("nodes do not follow those of the tile before");
    if (level < m.links.size() && !m.links[level].families.startsParent(first)) return bad("siblings lie in two tiles");
    tiles[level].push_back(t);
    checksums[level].push_back(e.checksum);
  }
  return {};
}

// The levels' totals in the manifest against the strips that are there.
Result<void> checkTotals(const Manifest& m, const std::vector<std::vector<TileInfo>>& tiles, const std::string& path) {
  for (size_t l = 0; l < m.levels.size(); ++l) {
    LevelInfo sum;
    for (const TileInfo& t : tiles[l]) {
      sum.nodes += t.nodes;
      sum.entries += t.entries;
      sum.stored_bytes += t.stored_bytes + kIndexRecordBytes;
    }
    if (tiles[l].size() != m.levels[l].tiles || sum.nodes != m.levels[l].nodes || sum.entries != m.levels[l].entries ||
        sum.stored_bytes != m.levels[l].stored_bytes)
      return Error{ErrorCode::kInvalidFile, path, "level " + std::to_string(l),
                   "shards do not hold what the manifest promises", kRemedy};
  }
  return {};
}

// By node of level + 1: the family of its children. Errors: places that are not each node's, once, in the order of FORMAT.md section 2.6.
Result<std::vector<uint32_t>> familiesByParent(const LevelLinks& links, std::span<const TileInfo> tiles,
                                               std::span<const TileInfo> above, const std::string& path) {
  constexpr uint32_t kNone = 0xffffffffu;
  std::vector<uint32_t> family_of(links.places.size(), kNone);
  for (const TileInfo& tile : tiles) {
    const TileInfo& parents = above[links.tiles.parent(tile.id.tile)];
    const uint32_t first = links.families.parent(tile.first_node), last = links.families.parent(tile.first_node + tile.nodes - 1);
    for (uint32_t family = first; family <= last; ++family) {
      const uint32_t place = links.places[family];
      if (place >= parents.nodes || (family > first && place <= links.places[family - 1]) ||
          family_of[parents.first_node + place] != kNone)
        return Error{ErrorCode::kInvalidFile, path,
                     "parents of tile " + std::to_string(tile.id.level) + ":" + std::to_string(tile.id.tile),
                     "are not nodes of the tile above, each once and ascending", kRemedy};
      family_of[parents.first_node + place] = family;
    }
  }
  return family_of;
}

std::vector<uint32_t> tileDirectory(std::span<const TileInfo> tiles, uint32_t nodes) {
  std::vector<uint32_t> directory;
  directory.reserve(nodes / kTileNodes + 1);
  uint32_t tile = 0;
  for (uint64_t node = 0; node < nodes; node += kTileNodes) {
    while (tiles[tile].first_node + uint64_t{tiles[tile].nodes} <= node) ++tile;
    directory.push_back(tile);
  }
  return directory;
}

}  // namespace

Result<World> World::open(const std::string& path, const StoragePtr& storage) try {
  auto bytes = readWholeFile(*storage, path);
  if (!bytes) return bytes.error();
  auto manifest = parseManifest(*bytes);
  if (!manifest) return inFile(manifest.error(), path);
  auto state = std::make_unique<State>();
  State& s = *state;
  s.path = path;
  s.manifest = std::move(*manifest);
  const Manifest& m = s.manifest;
  const std::string folder = path.substr(0, path.size() - fileNameOf(path).size());
  s.tiles.resize(m.levels.size());
  s.checksums.resize(m.levels.size());
  size_t level = m.levels.size() - 1;
  for (uint32_t i = 0; i < m.shards.size(); ++i) {
    const ShardRecord& record = m.shards[i];
    const std::string shard_path = folder + record.name;
    auto shard = openShard(*storage, shard_path, record, i);
    if (!shard) return shard.error();
    if (record.kind == kKindRows) {
      if (auto ok = takeEntries(std::move(shard->entries), m, shard_path, s.tiles, s.checksums, level); !ok)
        return ok.error();
    } else {
      for (ShardEntry& e : shard->entries) {
        if (e.info.id.level != 0 || e.info.id.tile != s.geometry.size())
          return Error{ErrorCode::kInvalidFile, shard_path, "offset " + std::to_string(e.info.offset),
                       "is not the geometry that should follow", kRemedy};
        s.geometry.push_back(e);
      }
    }
    s.shards.push_back({record.name, record.bytes, record.kind == kKindGeometry, shard->file->descriptor()});
    s.files.push_back(std::move(shard->file));
    s.shard_paths.push_back(shard_path);
  }
  if (auto ok = checkTotals(m, s.tiles, path); !ok) return ok.error();
  if (!s.geometry.empty() && s.geometry.size() != s.tiles[0].size())
    return Error{ErrorCode::kInvalidFile, path, "", "geometry does not cover every tile", kRemedy};
  s.family_of_children.resize(m.levels.size());
  for (size_t l = 0; l < m.links.size(); ++l) {
    auto families = familiesByParent(m.links[l], s.tiles[l], s.tiles[l + 1], path);
    if (!families) return families.error();
    s.family_of_children[l + 1] = std::move(*families);
  }
  for (size_t l = 0; l < m.levels.size(); ++l)
    s.tile_of_every_256th.push_back(tileDirectory(s.tiles[l], m.levels[l].nodes));
  return World(std::move(state));
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, path, "", "out of memory while opening the world", "close other programs"};
}

World::World(std::unique_ptr<State> state) : state_(std::move(state)) {}
World::World(World&&) noexcept = default;
World& World::operator=(World&&) noexcept = default;
World::~World() = default;

const std::string& World::path() const { return state_->path; }
const WorldInfo& World::info() const { return state_->manifest.info; }
std::span<const LevelInfo> World::levels() const { return state_->manifest.levels; }
std::span<const ShardInfo> World::shards() const { return state_->shards; }
std::span<const TileInfo> World::tiles(uint32_t level) const { return state_->tiles[level]; }

uint32_t World::tileOf(uint32_t level, uint32_t node) const {
  const std::vector<TileInfo>& tiles = state_->tiles[level];
  uint32_t tile = state_->tile_of_every_256th[level][node / kTileNodes];
  while (tiles[tile].first_node + tiles[tile].nodes <= node) ++tile;
  return tile;
}

uint32_t World::parent(uint32_t level, uint32_t node) const {
  if (level >= state_->manifest.links.size()) return kNoParent;
  return state_->tiles[level + 1][parentTile({level, tileOf(level, node)})].first_node + placeOfParent(level, node);
}

std::pair<uint32_t, uint32_t> World::children(uint32_t level, uint32_t node) const {
  return state_->manifest.links[level - 1].families.children(state_->family_of_children[level][node]);
}

uint32_t World::parentTile(TileId id) const { return state_->manifest.links[id.level].tiles.parent(id.tile); }

std::pair<uint32_t, uint32_t> World::childTiles(uint32_t level, uint32_t first, uint32_t end) const {
  const ParentLinks& links = state_->manifest.links[level - 1].tiles;
  const auto of_first = links.children(first);
  return {of_first.first, end - first == 1 ? of_first.second : links.children(end - 1).second};
}

uint32_t World::placeOfParent(uint32_t level, uint32_t node) const {
  const LevelLinks& links = state_->manifest.links[level];
  return links.places[links.families.parent(node)];
}

Result<void> World::decodeStrip(TileId id, std::span<const std::byte> stored, Strip& out) const {
  const State& s = *state_;
  if (id.level >= s.tiles.size() || id.tile >= s.tiles[id.level].size())
    return Error{ErrorCode::kUsage, s.path, "", 
                 "has no tile " + std::to_string(id.level) + ":" + std::to_string(id.tile), "see ffinspect info"};
  const TileInfo& info = s.tiles[id.level][id.tile];
  auto ok = decodeStripBytes(info, s.checksums[id.level][id.tile], s.tiles[id.level], s.manifest.info.quanta, stored, out);
  if (!ok) return inFile(ok.error(), s.shard_paths[info.shard]);
  if (id.level < s.manifest.links.size()) {
    const uint32_t first = s.tiles[id.level + 1][parentTile(id)].first_node;
    for (uint32_t i = 0; i < info.nodes; ++i) out.nodes[i].parent = first + placeOfParent(id.level, info.first_node + i);
  }
  return {};
}

Result<void> World::readStored(TileId id, std::span<std::byte> out, const ReadOptions& options) const {
  const TileInfo& info = state_->tiles[id.level][id.tile];
  FF_CHECK_EQ(out.size(), size_t{info.stored_bytes});
  return state_->files[info.shard]->read(info.offset, out, options);
}

Result<Strip> World::strip(TileId id) const {
  const State& s = *state_;
  Strip out;
  if (id.level >= s.tiles.size() || id.tile >= s.tiles[id.level].size()) {
    auto refused = decodeStrip(id, {}, out);  // words the refusal
    return refused.error();
  }
  std::vector<std::byte> stored(s.tiles[id.level][id.tile].stored_bytes);
  if (auto ok = readStored(id, stored); !ok) return ok.error();
  if (auto ok = decodeStrip(id, stored, out); !ok) return ok.error();
  return out;
}

bool World::hasGeometry() const { return !state_->geometry.empty(); }

Result<TileGeometry> World::geometry(uint32_t tile) const {
  const State& s = *state_;
  if (s.geometry.empty())
    return Error{ErrorCode::kInvalidFile, s.path, "", "has no drawing geometry", "bake it with drawing geometry"};
  if (tile >= s.geometry.size())
    return Error{ErrorCode::kUsage, s.path, "", "has no tile 0:" + std::to_string(tile), "see ffinspect info"};
  const ShardEntry& entry = s.geometry[tile];
  const std::string& path = s.shard_paths[entry.info.shard];
  std::vector<std::byte> stored(entry.info.stored_bytes);
  if (auto ok = s.files[entry.info.shard]->read(entry.info.offset, stored); !ok) return ok.error();
  TileGeometry out;
  out.tile = tile;
  const auto header = readGeometryHeader(entry, stored);
  if (!header) return inFile(header.error(), path);
  const auto payload = std::span<const std::byte>(stored).subspan(kStripHeaderBytes);
  if (auto ok = decodeGeometry(payload, entry.info.entries, s.tiles[0][tile].nodes, out); !ok) {
    Error e = inFile(ok.error(), path);
    e.place = geometryPlace(entry);
    return e;
  }
  out.sealed = header->blocks;
  return out;
}

std::span<const std::byte> World::spatialGrid() const {
  const Manifest& m = state_->manifest;
  return {m.grid.empty() ? nullptr : m.grid.data()->bytes, m.grid_bytes};
}

}  // namespace ff::formats
