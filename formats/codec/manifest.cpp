#include "formats/codec/manifest.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "formats/codec/checksum.h"

namespace ff::formats {
namespace {

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
    if (s.raw_bytes != s.stored_bytes) return broken(at, "section sizes disagree");
    sections[s.kind] = Section{s, bytes};
  }
  if (end != file.size()) return broken(end, "has bytes after the last section");
  for (uint32_t kind : {kSectionInfo, kSectionLevels, kSectionShards, kSectionRoot})
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
  if (!(info.cell_m > 0) || !std::isfinite(info.cell_m) || !std::isfinite(info.origin[0] + info.origin[1] + info.origin[2]) || !finite(info.bounds.lo) ||
      !finite(info.bounds.hi) || info.bounds.empty() || !std::isfinite(info.row_total_deviation) ||
      !(info.row_total_deviation >= 0) || !(info.target_error >= 0) || !(info.row_error >= 0) || !std::isfinite(info.target_error + info.row_error) || !std::isfinite(info.area_m2) || !std::isfinite(info.absorbed_fraction) ||
      info.quanta > kMaxQuanta || info.preview > 1)
    return broken(s.record.offset, "world information holds a value that cannot be");
  return {};
}

Result<void> readLevels(const Section& s, float cell_m, std::vector<LevelInfo>& levels) {
  const size_t n = s.bytes.size() / kLevelRecordBytes;
  if (n < 1 || n > kMaxLevels) return broken(s.record.offset, "has " + std::to_string(n) + " levels");
  ByteReader r(s.bytes);
  for (size_t l = 0; l < n; ++l) {
    LevelRecord x;
    LevelRecord::fields(r, x);
    if (x.tiles > kMaxLevelTiles)
      return Error{ErrorCode::kInvalidFile, "", "offset " + std::to_string(s.record.offset),
                   "level " + std::to_string(l) + " has " + std::to_string(x.tiles) + " tiles, this reader numbers " + std::to_string(kMaxLevelTiles) + " at most",
                   "use a newer Formfield, or larger patches"};
    if (x.tiles < 1 || x.tiles > x.nodes || x.nodes > kTileNodes * x.tiles) return broken(s.record.offset, "level holds a value that cannot be");
    levels.push_back({x.nodes, static_cast<uint32_t>(x.tiles), x.entries, x.stored_bytes, std::ldexp(cell_m, static_cast<int>(l))});
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
    if (shard.kind >= kShardKinds) return broken(at, "shard has an unknown kind");
    if (!isPlainFileName(shard.name)) return broken(at, "shard is not named by a plain file name");
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
  if (auto ok = readLevels(*(*sections)[kSectionLevels], m.info.cell_m, m.levels); !ok) return ok.error();
  if (auto ok = readShards(*(*sections)[kSectionShards], m.shards); !ok) return ok.error();
  auto root = decodeRoot(m.levels, (*sections)[kSectionRoot]->bytes);
  if (!root) return root.error();
  m.root = std::move(*root);
  if ((*sections)[kSectionLampGroups])
    if (auto ok = readLampGroups(*(*sections)[kSectionLampGroups], m.info.lamp_groups); !ok) return ok.error();
  if ((*sections)[kSectionLights])
    if (auto ok = readLights(*(*sections)[kSectionLights], m.info.lights); !ok) return ok.error();
  return m;
}

}  // namespace ff::formats
