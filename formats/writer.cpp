#include "formats/writer.h"

#include <zstd.h>

#include <algorithm>

#include "formats/checksum.h"
#include "formats/geometry.h"
#include "formats/manifest.h"
#include "formats/shard_writer.h"

namespace ff::formats {

struct WorldWriter::State {
  StoragePtr storage;
  std::vector<std::string> warnings;
  std::string path, stem;  // stem: path without .ffm
  uint64_t shard_bytes = 0;
  std::vector<std::unique_ptr<ShardWriter>> shards;  // in the order of the manifest's table
  ShardWriter* open_shard[2] = {};                   // by kind; null: none is open
  std::vector<LevelInfo> levels;                     // sized by the first strip, which is of the coarsest level
  std::vector<std::vector<uint32_t>> tile_starts;    // by level: first node of each tile, then the number of nodes
  uint32_t level = 0;                                // of the last strip
  uint32_t geometry_tiles = 0;
  uint32_t quanta = 0;                               // samples of the row that has most
  bool failed = false;                               // after an error nothing more is accepted

  Result<void> addTo(uint32_t kind, const TileInfo& info, std::vector<std::byte> bytes);
  Result<void> closeShard(uint32_t kind);
  void removeUnnamed();
};

namespace {

constexpr int kZstdLevel = 3;

Error misuse(const std::string& what) { return {ErrorCode::kPhysics, "", "world writer", what, ""}; }

// What model.h promises of parents as bits and places (FORMAT.md section 2.6); refuses what it does not. starts, starts_above: first node of
// each tile of the level and of the one above, then the number of nodes.
Result<void> writeLinks(std::span<const uint32_t> parents, std::span<const uint32_t> starts, std::span<const uint32_t> starts_above,
                        ByteWriter& out) {
  if (parents.size() != starts.back()) return misuse("parent links are not one per node");
  std::vector<uint64_t> tile_words((starts.size() + 62) / 64), family_words((parents.size() + 63) / 64);
  std::vector<uint8_t> places, taken(starts_above.back());
  size_t above = 0;  // tile
  for (size_t t = 0; t + 1 < starts.size(); ++t) {
    const bool next = t > 0 && parents[starts[t]] >= starts_above[above + 1];
    above += next;
    if (t == 0 || next) tile_words[t / 64] |= uint64_t{1} << (t % 64);
    for (uint32_t i = starts[t]; i < starts[t + 1]; ++i) {
      if (parents[i] < starts_above[above] || above + 1 == starts_above.size() || parents[i] >= starts_above[above + 1])
        return misuse("parents of a tile's nodes do not lie in one tile, or tiles not in the order of these");
      if (i > starts[t] && parents[i] == parents[i - 1]) continue;
      if (i > starts[t] && parents[i] < parents[i - 1]) return misuse("parents do not ascend within a tile");
      if (taken[parents[i]]++ != 0) return misuse("siblings are not consecutive or lie in two tiles");
      family_words[i / 64] |= uint64_t{1} << (i % 64);
      places.push_back(static_cast<uint8_t>(parents[i] - starts_above[above]));
    }
  }
  if (places.size() != taken.size()) return misuse("parent links do not name every node of the level above");
  for (const uint64_t w : tile_words) out.u64(w);
  for (const uint64_t w : family_words) out.u64(w);
  for (const uint8_t place : places) out.u8(place);
  return {};
}

Result<std::vector<std::byte>> compress(std::span<const std::byte> in) {
  std::vector<std::byte> out(ZSTD_compressBound(in.size()));
  const size_t n = ZSTD_compress(out.data(), out.size(), in.data(), in.size(), kZstdLevel);
  if (ZSTD_isError(n)) return Error{ErrorCode::kIo, "", "", "out of memory for compression", "close other programs"};
  out.resize(n);
  return out;
}

struct SectionBytes {
  uint32_t kind = 0;
  uint64_t raw_bytes = 0;
  std::vector<std::byte> bytes;
};

std::vector<std::byte> manifestBytes(const std::vector<SectionBytes>& sections) {
  ByteWriter table;
  uint64_t offset = kManifestHeaderBytes + sections.size() * kSectionRecordBytes;
  for (const SectionBytes& s : sections) {
    SectionRecord r;
    r.kind = s.kind;
    r.offset = offset;
    r.stored_bytes = s.bytes.size();
    r.raw_bytes = s.raw_bytes;
    r.checksum = hashBytes(s.bytes);
    SectionRecord::fields(table, r);
    offset += s.bytes.size();
  }
  ManifestHeader header;
  header.sections = static_cast<uint32_t>(sections.size());
  header.file_bytes = offset;
  header.table_checksum = hashBytes(table.data());
  std::vector<std::byte> out = recordBytes(header);
  storeLittle(out.data() + kManifestHeaderBytes - 8, hashBytes(std::span(out).first(kManifestHeaderBytes - 8)));
  out.insert(out.end(), table.data().begin(), table.data().end());
  for (const SectionBytes& s : sections) out.insert(out.end(), s.bytes.begin(), s.bytes.end());
  return out;
}

}  // namespace

Result<void> WorldWriter::State::closeShard(uint32_t kind) {
  if (open_shard[kind] == nullptr) return {};
  auto ok = open_shard[kind]->finish();
  open_shard[kind] = nullptr;
  return ok;
}

Result<void> WorldWriter::State::addTo(uint32_t kind, const TileInfo& info, std::vector<std::byte> bytes) {
  if (open_shard[kind] == nullptr) {
    auto shard = ShardWriter::create(storage, stem, kind, static_cast<uint32_t>(shards.size()));
    if (!shard) return shard.error();
    shards.push_back(std::move(*shard));
    open_shard[kind] = shards.back().get();
  }
  if (auto ok = open_shard[kind]->add(info, std::move(bytes)); !ok) return ok;
  return open_shard[kind]->bytes() >= shard_bytes ? closeShard(kind) : Result<void>{};
}

Result<WorldWriter> WorldWriter::create(const std::string& path, uint64_t shard_bytes, StoragePtr storage) {
  auto state = std::make_unique<State>();
  state->storage = std::move(storage);
  state->path = path;
  const std::string suffix = ".ffm";
  if (path.size() <= suffix.size() || !path.ends_with(suffix) || path[path.size() - suffix.size() - 1] == '/')
    return Error{ErrorCode::kUsage, path, "", "a world's name ends in .ffm", "name the output NAME.ffm"};
  state->stem = path.substr(0, path.size() - suffix.size());
  state->shard_bytes = shard_bytes;
  // Says at once, not after hours, that the folder cannot be written.
  if (auto ok = state->storage->checkWritable(folderOf(path)); !ok) return ok.error();
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
    s.tile_starts.assign(s.level + 1, {0});
  }
  if (info.id.level + 1 == s.level && s.levels[s.level].tiles > 0) s.level = info.id.level;
  if (info.id.level != s.level || info.id.tile != s.levels[s.level].tiles)
    return misuse("strip " + std::to_string(info.id.level) + ":" + std::to_string(info.id.tile) +
                  " comes out of order");
  LevelInfo& level = s.levels[s.level];
  if (info.first_node != level.nodes) return misuse("first_node is not the number of nodes before the tile");
  ++level.tiles;
  level.nodes += info.nodes;
  s.tile_starts[s.level].push_back(level.nodes);
  level.entries += info.entries;
  s.quanta = std::max(s.quanta, strip.quanta);
  level.stored_bytes += info.stored_bytes + kIndexRecordBytes;
  if (auto ok = s.addTo(kKindRows, info, std::move(strip.bytes)); !ok) return ok;
  s.failed = false;
  return {};
}

Result<void> WorldWriter::addGeometry(const TileGeometry& geometry) {
  State& s = *state_;
  if (s.failed) return misuse("an earlier call failed");
  s.failed = true;
  if (geometry.tile != s.geometry_tiles)
    return misuse("geometry of tile " + std::to_string(geometry.tile) + " comes out of order");
  auto payload = encodeGeometry(geometry);
  if (!payload) return payload.error();
  StripHeader header;
  header.magic = kGeometryMagic;
  header.tile = geometry.tile;
  header.entries = static_cast<uint32_t>(geometry.patch.size());
  header.blocks = geometry.sealed;
  header.payload_bytes = static_cast<uint32_t>(payload->size());
  header.bounds = {};
  for (const Vec3& p : geometry.positions) header.bounds.add(p);
  if (header.bounds.empty()) header.bounds = Box{{0, 0, 0}, {0, 0, 0}};
  for (uint8_t patch : geometry.patch)
    header.nodes = std::max<uint16_t>(header.nodes, static_cast<uint16_t>(patch + 1));
  std::vector<std::byte> bytes = recordBytes(header);
  bytes.insert(bytes.end(), payload->begin(), payload->end());
  storeLittle(bytes.data() + kStripChecksumOffset, hashStripContent(bytes));
  TileInfo info;
  info.id = {0, geometry.tile};
  info.stored_bytes = static_cast<uint32_t>(bytes.size());
  info.nodes = header.nodes;
  info.entries = header.entries;
  info.bounds = header.bounds;
  if (auto ok = s.addTo(kKindGeometry, info, std::move(bytes)); !ok) return ok;
  ++s.geometry_tiles;
  s.failed = false;
  return {};
}

Result<void> WorldWriter::finish(const WorldInfo& info, std::span<const std::vector<uint32_t>> parents,
                                 std::span<const float> cell_m, std::span<const std::byte> spatial_grid) {
  State& s = *state_;
  if (s.failed) return misuse("an earlier call failed");
  s.failed = true;
  if (s.levels.empty() || s.level != 0 || s.levels[0].tiles == 0) return misuse("a world needs strips down to level 0");
  if (s.geometry_tiles != 0 && s.geometry_tiles != s.levels[0].tiles) return misuse("geometry does not cover every tile");
  if (parents.size() + 1 != s.levels.size() || cell_m.size() != s.levels.size())
    return misuse("parents or cell sizes do not fit the number of levels");
  if (s.quanta > maxRowQuanta(info.quanta))
    return misuse("a row has " + std::to_string(s.quanta) + " samples, in a world of " + std::to_string(info.quanta) +
                  " a row has " + std::to_string(maxRowQuanta(info.quanta)) + " at most");

  std::vector<SectionBytes> sections;
  const auto addSection = [&](uint32_t kind, ByteWriter& w) {
    sections.push_back({kind, w.data().size(), std::move(w.data())});
  };
  ByteWriter info_bytes, level_bytes, shard_bytes, parent_bytes;
  WorldInfoRecord::fields(info_bytes, info);
  addSection(kSectionInfo, info_bytes);
  for (size_t l = 0; l < s.levels.size(); ++l) {
    s.levels[l].cell_m = cell_m[l];
    LevelRecord::fields(level_bytes, s.levels[l]);
  }
  addSection(kSectionLevels, level_bytes);
  for (size_t l = 0; l < parents.size(); ++l) {
    if (auto ok = writeLinks(parents[l], s.tile_starts[l], s.tile_starts[l + 1], parent_bytes); !ok) return ok;
  }
  for (uint32_t kind : {kKindRows, kKindGeometry})
    if (auto ok = s.closeShard(kind); !ok) return ok;
  for (const auto& shard : s.shards) ShardRecord::fields(shard_bytes, shard->record());
  addSection(kSectionShards, shard_bytes);
  addSection(kSectionParents, parent_bytes);
  if (!info.lamp_groups.empty()) {
    ByteWriter group_bytes;
    for (const LampGroup& group : info.lamp_groups) LampGroupRecord::fields(group_bytes, group);
    addSection(kSectionLampGroups, group_bytes);
  }
  if (spatial_grid.size() > maxGridBytes(parents.empty() ? 0 : s.levels[0].nodes)) {
    s.warnings.push_back(s.path + ": left out the spatial grid, which would take " + std::to_string(spatial_grid.size()) +
                         " bytes: its patches are far apart; ffinspect locate takes longer");
  } else if (!spatial_grid.empty()) {
    auto grid = compress(spatial_grid);
    if (!grid) return grid.error();
    sections.push_back({kSectionGrid, spatial_grid.size(), std::move(*grid)});
  }
  if (!info.lights.empty()) {
    ByteWriter light_bytes;
    for (const Light& light : info.lights) LightRecord::fields(light_bytes, light);
    addSection(kSectionLights, light_bytes);
  }
  // What we are about to promise must be readable: the same checks as the reader's, before any name changes.
  const std::vector<std::byte> manifest = manifestBytes(sections);
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
