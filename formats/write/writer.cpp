#include "formats/write/writer.h"

#include <algorithm>
#include <map>

#include "formats/codec/checksum.h"
#include "formats/codec/chunk.h"
#include "formats/codec/geometry.h"
#include "formats/codec/manifest.h"
#include "formats/write/encode.h"
#include "formats/write/shard_writer.h"

namespace ff::formats {

struct WorldWriter::State {
  std::unique_ptr<Claim> claim;  // given up when all else is gone
  StoragePtr storage;
  std::vector<std::string> warnings;
  std::string path, stem;  // stem: path without .ffm
  uint64_t shard_bytes = 0;
  std::vector<std::unique_ptr<ShardWriter>> shards;  // in the order of the manifest's table
  ShardWriter* open_shard[kShardKinds] = {};         // by kind; null: none is open
  std::vector<LevelInfo> levels;                     // sized by the first strip, which is of the coarsest level
  std::vector<std::vector<TileInfo>> tiles;          // by level
  std::vector<std::vector<TileName>> names;          // likewise
  std::map<ChunkCell, uint32_t> numbers;             // of tiles that a chunk of the present level has so far
  std::vector<GeometryInfo> geometry;                // by level-0 tile
  uint32_t level = 0;                                // of the last strip
  uint32_t quanta = 0;                               // samples of the row that has most
  bool failed = false;                               // after an error nothing more is accepted

  Result<Extent> addTo(uint32_t kind, std::span<const std::byte> bytes, uint32_t raw_bytes);
  Result<void> closeShard(uint32_t kind);
  Result<void> linkTiles(std::span<const std::span<const uint32_t>> parents);
  Result<std::vector<std::vector<std::shared_ptr<Chunk>>>> makeChunks(std::span<const std::span<const uint32_t>> parents);
  Result<std::vector<ChildChunk>> writeChunks(const WorldInfo& info, std::span<const std::span<const uint32_t>> parents);
  void removeUnnamed();
};

namespace {

// Of a file system, bytes; NAME.geometry.0123456789abcdef.ffs is the longest name.
constexpr size_t kLongestName = 255, kLongestPath = 4095, kLongestEnding = 30;

Error misuse(const std::string& what) { return {ErrorCode::kPhysics, "", "world writer", what, ""}; }

}  // namespace

Result<void> WorldWriter::State::closeShard(uint32_t kind) {
  if (open_shard[kind] == nullptr) return {};
  auto ok = open_shard[kind]->finish();
  open_shard[kind] = nullptr;
  return ok;
}

Result<Extent> WorldWriter::State::addTo(uint32_t kind, std::span<const std::byte> bytes, uint32_t raw_bytes) {
  if (open_shard[kind] == nullptr) {
    auto shard = ShardWriter::create(storage, stem, kind, static_cast<uint32_t>(shards.size()));
    if (!shard) return shard.error();
    shards.push_back(std::move(*shard));
    open_shard[kind] = shards.back().get();
  }
  auto extent = open_shard[kind]->add(bytes, raw_bytes);
  if (extent && open_shard[kind]->bytes() >= shard_bytes)
    if (auto ok = closeShard(kind); !ok) return ok.error();
  return extent;
}

Result<WorldWriter> WorldWriter::create(const std::string& path, uint64_t shard_bytes, StoragePtr storage) {
  auto state = std::make_unique<State>();
  state->storage = std::move(storage);
  state->path = path;
  const std::string suffix = ".ffm";
  if (path.size() <= suffix.size() || !path.ends_with(suffix) || path[path.size() - suffix.size() - 1] == '/')
    return Error{ErrorCode::kUsage, path, "", "a world's name ends in .ffm", "name the output NAME.ffm"};
  state->stem = path.substr(0, path.size() - suffix.size());
  if (fileNameOf(state->stem).size() + kLongestEnding > kLongestName || state->stem.size() + kLongestEnding > kLongestPath)
    return Error{ErrorCode::kUsage, path, "", "the name is too long for the files that go beside it", "name the output in fewer letters"};
  state->shard_bytes = shard_bytes;
  // Says at once, not after hours, that the folder cannot be written.
  if (auto ok = state->storage->checkWritable(folderOf(path)); !ok) return ok.error();
  if (const auto there = state->storage->exists(path); !there) return there.error();
  else if (*there)
    if (auto file = state->storage->open(path); !file) return file.error();  // a folder, for one
  auto claim = state->storage->claim(path);
  if (!claim) return claim.error();
  state->claim = std::move(*claim);
  return WorldWriter(std::move(state));
}

WorldWriter::WorldWriter(std::unique_ptr<State> state) : state_(std::move(state)) {}
WorldWriter::WorldWriter(WorldWriter&&) noexcept = default;
WorldWriter& WorldWriter::operator=(WorldWriter&&) noexcept = default;
WorldWriter::~WorldWriter() = default;

Result<void> WorldWriter::addStrip(EncodedStrip strip) {
  State& s = *state_;
  const TileInfo& info = strip.info;
  if (s.failed) return misuse("an earlier call failed");
  s.failed = true;
  if (s.levels.empty()) {
    if (info.id.level >= kMaxLevels) return misuse("level is too high");
    s.level = info.id.level;
    s.levels.resize(s.level + 1);
    s.tiles.resize(s.level + 1);
    s.names.resize(s.level + 1);
  }
  if (info.id.level + 1 == s.level && s.levels[s.level].tiles > 0) {
    s.level = info.id.level;
    s.numbers.clear();
  }
  if (info.id.level != s.level || info.id.tile != s.levels[s.level].tiles)
    return misuse("strip " + std::to_string(info.id.level) + ":" + std::to_string(info.id.tile) +
                  " comes out of order");
  LevelInfo& level = s.levels[s.level];
  if (info.first_node != level.nodes) return misuse("first_node is not the number of nodes before the tile");
  std::vector<TileName>& names = s.names[s.level];
  if (strip.name.tile != s.numbers[strip.name.chunk]++ || strip.name.tile >= kMaxChunkTiles)
    return misuse("strip " + std::to_string(info.id.level) + ":" + std::to_string(info.id.tile) + " is not the next tile of its chunk, or the chunk is full");
  auto extent = s.addTo(kKindRows, strip.bytes, info.strip.raw_bytes);
  if (!extent) return extent.error();
  ++level.tiles;
  level.nodes += info.nodes;
  level.entries += info.entries;
  level.stored_bytes += info.strip.stored_bytes;
  s.quanta = std::max(s.quanta, strip.quanta);
  s.tiles[s.level].push_back(info);
  s.tiles[s.level].back().strip = *extent;
  names.push_back(strip.name);
  s.failed = false;
  return {};
}

Result<void> WorldWriter::addGeometry(const TileGeometry& geometry, const WorldInfo& world) {
  State& s = *state_;
  if (s.failed) return misuse("an earlier call failed");
  s.failed = true;
  if (s.names.empty() || geometry.tile != s.geometry.size() || geometry.tile >= s.names[0].size())
    return misuse("geometry of tile " + std::to_string(geometry.tile) + " comes out of order");
  TileGeometry local = geometry;
  const std::array<double, 3> corner = chunkCorner(world, 0, s.names[0][geometry.tile].chunk);
  for (Vec3& p : local.positions) p = lessCorner(p, corner);
  auto payload = encodeGeometry(local);
  if (!payload) return payload.error();
  StripHeader header;
  header.magic = kGeometryMagic;
  header.entries = static_cast<uint32_t>(geometry.patch.size());
  header.blocks = geometry.sealed;
  header.payload_bytes = static_cast<uint32_t>(payload->size());
  for (uint8_t patch : geometry.patch)
    header.nodes = std::max<uint16_t>(header.nodes, static_cast<uint16_t>(patch + 1));
  std::vector<std::byte> bytes = recordBytes(header);
  bytes.insert(bytes.end(), payload->begin(), payload->end());
  auto extent = s.addTo(kKindGeometry, bytes, 0);
  if (!extent) return extent.error();
  s.geometry.push_back({*extent, header.entries});
  s.failed = false;
  return {};
}

// Each tile's parent and child tiles, and what model.h promises of them.
Result<void> WorldWriter::State::linkTiles(std::span<const std::span<const uint32_t>> parents) {
  for (size_t l = 0; l + 1 < levels.size(); ++l) {
    std::vector<TileInfo>& above = tiles[l + 1];
    if (parents[l].size() != levels[l].nodes) return misuse("parent links are not one per node");
    std::vector<uint32_t> child_tile(levels[l + 1].nodes, kNoParent);  // by parent
    size_t p = 0, families = 0;
    for (TileInfo& tile : tiles[l]) {
      const std::span<const uint32_t> own = parents[l].subspan(tile.first_node, tile.nodes);
      if (own[0] >= above[p].first_node + above[p].nodes && p + 1 < above.size()) ++p;
      TileInfo& parent = above[p];
      for (size_t i = 0; i < own.size(); ++i) {
        if (own[i] < parent.first_node || own[i] - parent.first_node >= parent.nodes)
          return misuse("parents of a tile's nodes do not lie in one tile, or tiles not in the order of these");
        if (child_tile[own[i]] == tile.id.tile) continue;
        if (child_tile[own[i]] != kNoParent) return misuse("siblings lie in two tiles");
        child_tile[own[i]] = tile.id.tile;
        ++families;
      }
      tile.parent_tile = static_cast<uint32_t>(p);
      if (parent.end_child == 0) parent.first_child = tile.id.tile;
      parent.end_child = tile.id.tile + 1;
    }
    if (families != child_tile.size()) return misuse("parent links do not name every node of the level above");
  }
  return {};
}

// By level; without children.
Result<std::vector<std::vector<std::shared_ptr<Chunk>>>> WorldWriter::State::makeChunks(std::span<const std::span<const uint32_t>> parents) {
  std::vector<std::vector<std::shared_ptr<Chunk>>> chunks(levels.size());
  auto root = std::make_shared<Chunk>();
  root->level = static_cast<uint32_t>(levels.size());
  root->first.resize(levels.size() + 1);
  std::vector<size_t> chunk_of, chunk_of_above;  // by tile
  for (size_t l = levels.size(); l-- > 0;) {
    const bool top = l + 1 == levels.size();
    chunk_of.clear();
    for (size_t t = 0; t < tiles[l].size(); ++t) {
      const TileInfo& tile = tiles[l][t];
      const size_t above = top ? 0 : chunk_of_above[tile.parent_tile];
      // Tiles of one cell that lie beneath two chunks, or apart in the order of tiles, have a record each.
      if (t == 0 || names[l][t].chunk != names[l][t - 1].chunk || (!top && chunk_of_above[tiles[l][t - 1].parent_tile] != above)) {
        auto chunk = std::make_shared<Chunk>();
        chunk->level = static_cast<uint32_t>(l);
        chunk->cell = names[l][t].chunk;
        chunk->first_number = names[l][t].tile;
        chunk->parent = top ? root : chunks[l + 1][above];
        chunk->first.resize(l + 1);
        chunk->first[l] = {tile.id.tile, tile.first_node};
        if (l > 0) chunk->first[l - 1].tiles = tile.first_child;
        if (!top && parentCell(chunk->cell) != chunk->parent->cell) return misuse(chunkText(chunk->level, chunk->cell) + " does not lie in the chunk of its tiles' parents");
        chunks[l].push_back(std::move(chunk));
      }
      Chunk& chunk = *chunks[l].back();
      chunk.tiles.push_back(tile);
      if (l == 0 && !geometry.empty()) chunk.geometry.push_back(geometry[t]);
      if (!top)
        for (uint32_t i = 0; i < tile.nodes; ++i)
          chunk.parent_index.push_back(static_cast<uint8_t>(parents[l][tile.first_node + i] - tiles[l + 1][tile.parent_tile].first_node));
      chunk_of.push_back(chunks[l].size() - 1);
    }
    if (!top)
      for (const TileInfo& tile : tiles[l + 1])
        if (chunk_of[tile.first_child] != chunk_of[tile.end_child - 1]) return misuse("the child tiles of a tile lie in two chunks");
    chunk_of_above.swap(chunk_of);
  }
  return chunks;
}

// From level 0 up, as a chunk's record names those of its children. Returns the root's children.
Result<std::vector<ChildChunk>> WorldWriter::State::writeChunks(const WorldInfo& info, std::span<const std::span<const uint32_t>> parents) {
  auto chunks = makeChunks(parents);
  if (!chunks) return chunks.error();
  std::vector<ChildChunk> root;
  for (size_t l = 0; l < levels.size(); ++l) {
    size_t above = 0;  // chunk of level l + 1
    for (const std::shared_ptr<Chunk>& chunk : (*chunks)[l]) {
      ChildChunk self;
      self.cell = chunk->cell;
      self.counts.resize(l + 1);
      for (const ChildChunk& child : chunk->children)
        for (size_t k = 0; k < l; ++k) self.counts[k] += child.counts[k];
      self.counts[l].tiles = chunk->tiles.size();
      for (const TileInfo& tile : chunk->tiles) {
        self.counts[l].nodes += tile.nodes;
        self.bounds.add(tile.bounds);
      }
      const std::vector<std::byte> raw = encodeChunk(info, *chunk);
      if (raw.size() > kMaxChunkRawBytes) return misuse(chunkText(chunk->level, chunk->cell) + " is too large");
      auto stored = compressChunk(raw);
      if (!stored) return stored.error();
      auto extent = addTo(kKindIndex, *stored, static_cast<uint32_t>(raw.size()));
      if (!extent) return extent.error();
      self.record = *extent;
      levels[l].stored_bytes += stored->size();
      if (l + 1 == levels.size()) {
        root.push_back(std::move(self));
        continue;
      }
      while ((*chunks)[l + 1][above] != chunk->parent) ++above;
      (*chunks)[l + 1][above]->children.push_back(std::move(self));
    }
    if (l > 0) (*chunks)[l - 1].clear();
  }
  return root;
}

Result<void> WorldWriter::finish(const WorldInfo& info, std::span<const std::span<const uint32_t>> parents) {
  State& s = *state_;
  if (s.failed) return misuse("an earlier call failed");
  s.failed = true;
  if (s.levels.empty() || s.level != 0 || s.levels[0].tiles == 0) return misuse("a world needs strips down to level 0");
  if (!s.geometry.empty() && s.geometry.size() != s.levels[0].tiles) return misuse("geometry does not cover every tile");
  if (parents.size() + 1 != s.levels.size()) return misuse("parents do not fit the number of levels");
  if (s.quanta > maxRowQuanta(info.quanta))
    return misuse("a row has " + std::to_string(s.quanta) + " samples, in a world of " + std::to_string(info.quanta) +
                  " a row has " + std::to_string(maxRowQuanta(info.quanta)) + " at most");
  if (auto ok = s.linkTiles(parents); !ok) return ok;
  const auto root = s.writeChunks(info, parents);
  if (!root) return root.error();
  for (uint32_t kind = 0; kind < kShardKinds; ++kind)
    if (auto ok = s.closeShard(kind); !ok) return ok;

  std::vector<SectionBytes> sections;
  const auto addSection = [&](uint32_t kind, std::vector<std::byte> bytes) { sections.push_back({kind, std::move(bytes)}); };
  ByteWriter info_bytes, level_bytes, shard_bytes;
  WorldInfoRecord::fields(info_bytes, info);
  addSection(kSectionInfo, std::move(info_bytes.data()));
  for (const LevelInfo& level : s.levels) {
    const LevelRecord record{level.nodes, level.tiles, level.entries, level.stored_bytes};
    LevelRecord::fields(level_bytes, record);
  }
  addSection(kSectionLevels, std::move(level_bytes.data()));
  for (const auto& shard : s.shards) ShardRecord::fields(shard_bytes, shard->record());
  addSection(kSectionShards, std::move(shard_bytes.data()));
  addSection(kSectionRoot, encodeRoot(*root));
  if (!info.lamp_groups.empty()) {
    ByteWriter group_bytes;
    for (const LampGroup& group : info.lamp_groups) LampGroupRecord::fields(group_bytes, group);
    addSection(kSectionLampGroups, std::move(group_bytes.data()));
  }
  if (!info.lights.empty()) {
    ByteWriter light_bytes;
    for (const Light& light : info.lights) LightRecord::fields(light_bytes, light);
    addSection(kSectionLights, std::move(light_bytes.data()));
  }
  // What we are about to promise must be readable: the same checks as the reader's, before any name changes.
  const std::vector<std::byte> manifest = encodeManifest(sections);
  if (auto parsed = parseManifest(manifest); !parsed) return parsed.error();

  for (const auto& shard : s.shards)
    if (auto ok = shard->rename(); !ok) return ok;
  const auto synced = s.storage->syncFolder(folderOf(s.path));
  if (!synced) return synced.error();
  if (!*synced) s.warnings.push_back(folderOf(s.path) + ": this file system cannot sync a folder; after a power cut within seconds the world may be the old one");
  if (auto ok = writeWholeFile(*s.storage, s.path, manifest); !ok) return ok;
  s.removeUnnamed();
  return {};
}

// Shards of the world that was there before, and what killed bakes left.
void WorldWriter::State::removeUnnamed() {
  const std::string folder = folderOf(path);
  const auto files = storage->list(folder);
  if (!files) return warnings.push_back(files.error().line());
  for (const std::string& file : *files) {
    const auto named = [&](const auto& shard) { return shard->record().name == file; };
    if (!isPartOfWorld(fileNameOf(stem), file) || std::any_of(shards.begin(), shards.end(), named)) continue;
    if (auto ok = storage->remove(folder + file); !ok) warnings.push_back(ok.error().line());
  }
}

std::span<const std::string> WorldWriter::warnings() const { return state_->warnings; }

}  // namespace ff::formats
