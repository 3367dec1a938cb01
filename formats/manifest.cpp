#include "formats/manifest.h"

#include <zstd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>

#include "formats/checksum.h"

namespace ff::formats {
namespace {

struct StreamFree {
  void operator()(ZSTD_DStream* s) const { ZSTD_freeDStream(s); }
};

Error broken(uint64_t offset, const std::string& message) {
  return {ErrorCode::kInvalidFile, "", "offset " + std::to_string(offset), message,
          "restore the manifest from a copy, or bake again"};
}

struct Section {
  SectionRecord record;
  std::span<const std::byte> bytes;
};

// The known sections by kind; unknown optional ones are dropped.
using Sections = std::array<std::optional<Section>, kSectionLast + 1>;

Result<Sections> readSections(std::span<const std::byte> file) {
  if (file.size() < kManifestHeaderBytes) return broken(0, "is too short for a manifest");
  ByteReader head(file.first(kManifestHeaderBytes));
  ManifestHeader h;
  ManifestHeader::fields(head, h);
  if (h.magic != kManifestMagic) return broken(0, "is not a Formfield manifest (does not begin with FFWORLD)");
  if (h.reader_version > kFormatVersion)
    return Error{ErrorCode::kInvalidFile, "", "offset 10",
                 "needs a reader of format version " + std::to_string(h.reader_version) + ", this one knows " +
                     std::to_string(kFormatVersion),
                 "use a newer Formfield"};
  if (hashBytes(file.first(kManifestHeaderBytes - 8)) != h.checksum) return broken(0, "header checksum mismatch");
  if (h.version < kFormatVersion || h.reader_version < kFormatVersion)
    return Error{ErrorCode::kInvalidFile, "", "offset 8",
                 "is of format version " + std::to_string(h.version) + ", which was never released", "bake it again"};
  if (head.reservedUsed()) return broken(0, "uses a reserved byte of the header");
  if (h.file_bytes != file.size())
    return broken(16, "says " + std::to_string(h.file_bytes) + " bytes, the file has " + std::to_string(file.size()));
  if (h.sections > (file.size() - kManifestHeaderBytes) / kSectionRecordBytes)
    return broken(12, "names more sections than fit");
  const auto table = file.subspan(kManifestHeaderBytes, h.sections * kSectionRecordBytes);
  if (hashBytes(table) != h.table_checksum) return broken(kManifestHeaderBytes, "section table checksum mismatch");

  Sections sections;
  ByteReader r(table);
  uint64_t end = kManifestHeaderBytes + table.size();
  for (uint32_t i = 0; i < h.sections; ++i) {
    const uint64_t at = kManifestHeaderBytes + r.position();
    SectionRecord s;
    SectionRecord::fields(r, s);
    if (r.reservedUsed()) return broken(at, "uses a reserved byte of the section table");
    if (s.offset != end || s.stored_bytes > file.size() - end) return broken(at, "section lies outside the file");
    end += s.stored_bytes;
    if ((s.kind == 0 || s.kind > kSectionLast) && (s.kind & kSectionOptional) == 0)
      return Error{ErrorCode::kInvalidFile, "", "offset " + std::to_string(at),
                   "has a section of unknown kind " + std::to_string(s.kind), "use a newer Formfield"};
    const auto bytes = file.subspan(s.offset, s.stored_bytes);
    if (hashBytes(bytes) != s.checksum) return broken(s.offset, "section checksum mismatch");
    if ((s.kind & kSectionOptional) != 0) continue;
    if (sections[s.kind]) return broken(at, "has a section twice");
    if (s.kind != kSectionGrid && s.raw_bytes != s.stored_bytes) return broken(at, "section sizes disagree");
    sections[s.kind] = Section{s, bytes};
  }
  if (end != file.size()) return broken(end, "has bytes after the last section");
  for (uint32_t kind : {kSectionInfo, kSectionLevels, kSectionShards, kSectionParents})
    if (!sections[kind]) return broken(kManifestHeaderBytes, "lacks section " + std::to_string(kind));
  return sections;
}

// After the last field of a section.
Result<void> finished(const ByteReader& r, const Section& s) {
  if (!r.ok() || r.remaining() != 0) return broken(s.record.offset, "section has the wrong length");
  if (r.reservedUsed()) return broken(s.record.offset, "section uses a reserved byte");
  return {};
}

constexpr float kWidestSpot = 1.5707964f;  // pi / 2

bool finite(Vec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

Result<void> readInfo(const Section& s, WorldInfo& info) {
  ByteReader r(s.bytes);
  WorldInfoRecord::fields(r, info);
  if (auto ok = finished(r, s); !ok) return ok;
  if (!(info.cell_m > 0) || !std::isfinite(info.cell_m) || !finite(info.grid_origin) || !finite(info.bounds.lo) ||
      !finite(info.bounds.hi) || info.bounds.empty() || !std::isfinite(info.row_total_deviation) ||
      !(info.row_total_deviation >= 0) || !std::isfinite(info.area_m2) || !std::isfinite(info.absorbed_fraction) ||
      info.quanta > kMaxQuanta)
    return broken(s.record.offset, "world information holds a value that cannot be");
  return {};
}

Result<void> readLevels(const Section& s, std::vector<LevelInfo>& levels) {
  const size_t n = s.bytes.size() / kLevelRecordBytes;
  if (n < 1 || n > kMaxLevels) return broken(s.record.offset, "has " + std::to_string(n) + " levels");
  ByteReader r(s.bytes);
  levels.resize(n);
  for (LevelInfo& level : levels) {
    LevelRecord::fields(r, level);
    if (level.nodes < 1 || level.tiles < 1 || level.tiles > level.nodes || !(level.cell_m > 0) ||
        !std::isfinite(level.cell_m))
      return broken(s.record.offset, "level holds a value that cannot be");
  }
  return finished(r, s);
}

Result<void> readLights(const Section& s, std::vector<Light>& lights) {
  ByteReader r(s.bytes);
  while (r.ok() && r.remaining() > 0) {
    const uint64_t at = s.record.offset + r.position();
    Light& light = lights.emplace_back();
    LightRecord::fields(r, light);
    if (!r.ok()) break;
    const Vec3& c = light.color_intensity;
    const float direction = light.kind == Light::kPoint ? 0.0f : 1.0f;
    const bool cone = light.kind != Light::kSpot ? light.inner_angle == 0 && light.outer_angle == 0
                                                 : light.inner_angle >= 0 && light.inner_angle < light.outer_angle &&
                                                       light.outer_angle <= kWidestSpot;
    if (light.kind > Light::kSpot || !finite(c) || !(c.x >= 0 && c.y >= 0 && c.z >= 0) || !finite(light.position) ||
        !(std::fabs(length(light.direction) - direction) <= 1e-3f) || !(light.range_m >= 0) ||
        !std::isfinite(light.range_m) || !cone)
      return broken(at, "light holds a value that cannot be");
  }
  return finished(r, s);
}

Result<void> readShards(const Section& s, std::vector<ShardRecord>& shards) {
  ByteReader r(s.bytes);
  while (r.ok() && r.remaining() > 0) {
    const uint64_t at = s.record.offset + r.position();
    ShardRecord& shard = shards.emplace_back();
    ShardRecord::fields(r, shard);
    if (!r.ok()) break;
    if (shard.kind > kKindGeometry) return broken(at, "shard has an unknown kind");
    if (!isPlainFileName(shard.name)) return broken(at, "shard is not named by a plain file name");
  }
  return finished(r, s);
}

Result<void> readLinks(const Section& s, std::span<const LevelInfo> levels, std::vector<LevelLinks>& links) {
  ByteReader r(s.bytes);
  for (size_t l = 0; l + 1 < levels.size(); ++l) {
    LevelLinks& level = links.emplace_back();
    const auto read = [&](uint32_t children, uint32_t parents, const char* what, ParentLinks& out) -> Result<void> {
      const size_t words = (size_t{children} + 63) / 64;
      const std::string name = "parent links of level " + std::to_string(l) + "'s " + what;
      if (r.remaining() / 8 < words) return broken(s.record.offset, name + " are cut off");
      std::vector<uint64_t> bits(words);
      for (uint64_t& w : bits) r.u64(w);
      if ((bits[0] & 1) == 0) return broken(s.record.offset, name + " do not begin with a parent");
      if (children % 64 != 0 && bits.back() >> (children % 64) != 0)
        return broken(s.record.offset, name + " go past the last one");
      out = ParentLinks(std::move(bits), children);
      if (out.parents() != parents)
        return broken(s.record.offset, name + " have " + std::to_string(out.parents()) + " parents, level " +
                                           std::to_string(l + 1) + " has " + std::to_string(parents));
      return {};
    };
    if (auto ok = read(levels[l].tiles, levels[l + 1].tiles, "tiles", level.tiles); !ok) return ok;
    if (auto ok = read(levels[l].nodes, levels[l + 1].nodes, "nodes", level.families); !ok) return ok;
    if (r.remaining() < levels[l + 1].nodes)
      return broken(s.record.offset, "places of the parents of level " + std::to_string(l) + " are cut off");
    level.places.resize(levels[l + 1].nodes);
    for (uint8_t& place : level.places) r.u8(place);
  }
  return finished(r, s);
}

Result<void> readLampGroups(const Section& s, std::vector<LampGroup>& groups) {
  ByteReader r(s.bytes);
  while (r.ok() && r.remaining() > 0) {
    const uint64_t at = s.record.offset + r.position();
    LampGroup& group = groups.emplace_back();
    LampGroupRecord::fields(r, group);
    if (!r.ok()) break;
    if (groups.size() > kNoLampGroup) return broken(at, "has more lamp groups than 16 bits can number");
    const Vec3& e = group.emission;
    if (!finite(e) || !(std::min({e.x, e.y, e.z}) >= 0) || std::max({e.x, e.y, e.z}) > kMaxEmission || !std::isfinite(group.area_m2))
      return broken(at, "lamp group holds a value that cannot be");
  }
  return finished(r, s);
}

// The size in the table is not believed: memory grows with what the frame yields, up to max_bytes.
Result<void> readGrid(const Section& s, uint64_t max_bytes, std::vector<GridLine>& grid, size_t& grid_bytes) {
  const uint64_t raw_bytes = s.record.raw_bytes;
  if (raw_bytes > max_bytes)
    return broken(s.record.offset, "spatial grid has " + std::to_string(raw_bytes) + " bytes, for the world's patches " +
                                       std::to_string(max_bytes) + " are allowed");
  std::unique_ptr<ZSTD_DStream, StreamFree> stream(ZSTD_createDStream());
  if (!stream) return Error{ErrorCode::kIo, "", "", "out of memory for decompression", ""};
  ZSTD_inBuffer in{s.bytes.data(), s.bytes.size(), 0};
  size_t done = 0, left = 1;
  while (left != 0) {
    if (done == grid.size() * sizeof(GridLine)) grid.resize(std::max<size_t>(4096, grid.size() * 2));
    const size_t room = static_cast<size_t>(std::min<uint64_t>(grid.size() * sizeof(GridLine) - done, raw_bytes - done));
    ZSTD_outBuffer out{grid.data()->bytes + done, room, 0};
    const size_t before = in.pos;
    left = ZSTD_decompressStream(stream.get(), &out, &in);
    done += out.pos;
    if (ZSTD_isError(left)) return broken(s.record.offset, std::string("spatial grid: zstd: ") + ZSTD_getErrorName(left));
    if (left != 0 && out.pos == 0 && in.pos == before) return broken(s.record.offset, "spatial grid has the wrong size");
  }
  if (done != raw_bytes || in.pos != in.size) return broken(s.record.offset, "spatial grid has the wrong size");
  grid.resize((done + sizeof(GridLine) - 1) / sizeof(GridLine));
  grid.shrink_to_fit();
  grid_bytes = done;
  return {};
}

}  // namespace

bool isPlainFileName(const std::string& name) {
  return !name.empty() && name != "." && name != ".." && name.find('/') == std::string::npos &&
         name.find('\0') == std::string::npos;
}

Result<Manifest> parseManifest(std::span<const std::byte> bytes) {
  auto sections = readSections(bytes);
  if (!sections) return sections.error();
  Manifest m;
  if (auto ok = readInfo(*(*sections)[kSectionInfo], m.info); !ok) return ok.error();
  if (auto ok = readLevels(*(*sections)[kSectionLevels], m.levels); !ok) return ok.error();
  if (auto ok = readShards(*(*sections)[kSectionShards], m.shards); !ok) return ok.error();
  if (auto ok = readLinks(*(*sections)[kSectionParents], m.levels, m.links); !ok) return ok.error();
  if ((*sections)[kSectionLampGroups])
    if (auto ok = readLampGroups(*(*sections)[kSectionLampGroups], m.info.lamp_groups); !ok) return ok.error();
  if ((*sections)[kSectionGrid])
    if (auto ok = readGrid(*(*sections)[kSectionGrid], maxGridBytes(m.links.empty() ? 0 : m.levels[0].nodes), m.grid, m.grid_bytes); !ok) return ok.error();
  if ((*sections)[kSectionLights])
    if (auto ok = readLights(*(*sections)[kSectionLights], m.info.lights); !ok) return ok.error();
  return m;
}

}  // namespace ff::formats
