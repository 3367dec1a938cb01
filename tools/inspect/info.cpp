#include <fmt/core.h>
#include <nlohmann/json.hpp>

#include <bit>

#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "tools/inspect/inspect.h"

namespace ff::tools {

using namespace ff::formats;
using nlohmann::json;

namespace {

uint64_t shardBytes(const World& world, uint32_t kind) {
  uint64_t bytes = 0;
  for (const ShardInfo& s : world.shards())
    if (s.kind == kind) bytes += s.bytes;
  return bytes;
}

double ratio(double a, double b) { return b > 0 ? a / b : 0; }

json levelJson(const World& world, uint32_t l) {
  const LevelInfo& level = world.levels()[l];
  return {{"level", l},
          {"nodes", level.nodes},
          {"tiles", level.tiles},
          {"entries", level.entries},
          {"entries_per_row", ratio(static_cast<double>(level.entries), static_cast<double>(level.nodes))},
          {"stored_bytes", level.stored_bytes},
          {"bytes_per_node", ratio(static_cast<double>(level.stored_bytes), static_cast<double>(level.nodes))},
          {"cell_m", level.cell_m}};
}

double pyramidRatio(const World& world) {
  double all = 0;
  for (const LevelInfo& l : world.levels()) all += static_cast<double>(l.stored_bytes);
  return ratio(all, static_cast<double>(world.levels()[0].stored_bytes));
}

constexpr const char* kShardNames[] = {"rows", "geometry", "index"};
constexpr const char* kLightKinds[] = {"directional", "point", "spot"};

json lightJson(const Light& light) {
  json j = {{"name", light.name},
            {"kind", kLightKinds[light.kind]},
            {"color_intensity", toJson(light.color_intensity)},
            {"range_m", light.range_m}};
  if (light.kind != Light::kDirectional) j["position"] = toJson(light.position);
  if (light.kind != Light::kPoint) j["direction"] = toJson(light.direction);
  if (light.kind == Light::kSpot) j["inner_angle"] = light.inner_angle, j["outer_angle"] = light.outer_angle;
  return j;
}

void printLights(std::span<const Light> lights, std::FILE* to) {
  for (const Light& l : lights) {
    const Vec3 c = l.color_intensity, p = l.position, d = l.direction;
    fmt::print(to, "light        \"{}\": {}, {:g} {:g} {:g} {}", l.name, kLightKinds[l.kind], c.x, c.y, c.z,
               l.kind == Light::kDirectional ? "W/m2" : "W/sr");
    if (l.kind != Light::kDirectional) fmt::print(to, ", at {:g} {:g} {:g}", p.x, p.y, p.z);
    if (l.kind != Light::kPoint) fmt::print(to, ", towards {:g} {:g} {:g}", d.x, d.y, d.z);
    if (l.kind == Light::kSpot) fmt::print(to, ", cone {:g} to {:g} rad", l.inner_angle, l.outer_angle);
    if (l.range_m > 0) fmt::print(to, ", within {:g} m", l.range_m);
    fmt::print(to, "\n");
  }
}

json lampGroupsJson(std::span<const LampGroup> groups) {
  json list = json::array();
  for (const LampGroup& g : groups)
    list.push_back({{"name", g.name}, {"emission", toJson(g.emission)}, {"area_m2", g.area_m2}, {"patches", g.patches}});
  return list;
}

void printLampGroups(std::span<const LampGroup> groups, std::FILE* to) {
  for (size_t g = 0; g < groups.size(); ++g)
    fmt::print(to, "lamp group   {} \"{}\": {:g} {:g} {:g} W/m2, {:.4g} m2 in {} patches\n", g, groups[g].name, groups[g].emission.x,
               groups[g].emission.y, groups[g].emission.z, groups[g].area_m2, groups[g].patches);
}

void printLevels(const World& world, std::FILE* to) {
  fmt::print(to, "{:>5} {:>12} {:>10} {:>14} {:>8} {:>15} {:>10} {:>8}\n", "level", "nodes", "tiles", "entries", "per row",
             "stored_bytes", "per node", "cell_m");
  for (uint32_t l = 0; l < world.levels().size(); ++l) {
    const LevelInfo& v = world.levels()[l];
    fmt::print(to, "{:>5} {:>12} {:>10} {:>14} {:>8.1f} {:>15} {:>10.1f} {:>8g}\n", l, v.nodes, v.tiles, v.entries,
               ratio(static_cast<double>(v.entries), static_cast<double>(v.nodes)), v.stored_bytes,
               ratio(static_cast<double>(v.stored_bytes), static_cast<double>(v.nodes)), v.cell_m);
  }
  fmt::print(to, "pyramid over level 0: {:.3f}\n", pyramidRatio(world));
}

}  // namespace

Result<void> inspectInfo(const World& world, const InspectOutput& out) {
  const WorldInfo& info = world.info();
  if (out.json) {
    json levels = json::array(), shards = json::array();
    for (uint32_t l = 0; l < world.levels().size(); ++l) levels.push_back(levelJson(world, l));
    for (const ShardInfo& s : world.shards())
      shards.push_back({{"name", s.name}, {"bytes", s.bytes}, {"kind", kShardNames[s.kind]}});
    json lights = json::array();
    for (const Light& light : info.lights) lights.push_back(lightJson(light));
    fmt::print(out.to, "{}\n",
               json{{"path", world.path()},
                    {"generator", info.generator},
                    {"scene", info.scene},
                    {"cell_m", info.cell_m},
                    {"origin", info.origin},
                    {"bounds", toJson(info.bounds)},
                    {"rays", info.rays},
                    {"fewest_rays", info.fewest_rays},
                    {"target_error", info.target_error},
                    {"row_error", info.row_error},
                    {"preview", info.preview != 0},
                    {"samples", info.quanta},
                    {"seed", info.seed},
                    {"bake_key", hexText(info.bake_key)},
                    {"row_total_deviation", info.row_total_deviation},
                    {"area_m2", info.area_m2},
                    {"triangles", info.triangles},
                    {"absorbed_fraction", info.absorbed_fraction},
                    {"pyramid_over_level0", pyramidRatio(world)},
                    {"lamp_groups", lampGroupsJson(info.lamp_groups)},
                    {"lights", lights},
                    {"levels", levels},
                    {"shards", shards}}
                   .dump());
    return {};
  }
  const Vec3 e = info.bounds.hi - info.bounds.lo;
  fmt::print(out.to, "world        {}\n", world.path());
  fmt::print(out.to, "scene        {}, {} triangles, {:.6g} m2\n", info.scene, info.triangles, info.area_m2);
  fmt::print(out.to, "baked        by {}, key {}\n", info.generator, hexText(info.bake_key));
  if (info.preview) fmt::print(out.to, "             as a preview: few large patches, few rays; bake it without --preview to ship it\n");
  fmt::print(out.to, "bounds       {:g} {:g} {:g} to {:g} {:g} {:g} ({:.4g} x {:.4g} x {:.4g} m)\n", info.bounds.lo.x,
             info.bounds.lo.y, info.bounds.lo.z, info.bounds.hi.x, info.bounds.hi.y, info.bounds.hi.z, e.x, e.y, e.z);
  fmt::print(out.to, "settings     cell {:g} m, {} rays a patch, {} samples a row, seed {}\n", info.cell_m, info.rays, info.quanta,
             info.seed);
  if (info.target_error > 0)
    fmt::print(out.to, "             rays were cast for an error of {:.2g} %, at least {} a patch\n", 100 * static_cast<double>(info.target_error), info.fewest_rays);
  fmt::print(out.to, "measured     absorbed {:.4f} %, row totals within {:.2f} %, error of rows from rays {:.2f} %\n",
             100 * info.absorbed_fraction, 100 * static_cast<double>(info.row_total_deviation), 100 * static_cast<double>(info.row_error));
  printLampGroups(info.lamp_groups, out.to);
  printLights(info.lights, out.to);
  if (info.origin != std::array<double, 3>{})
    fmt::print(out.to, "origin       {} {} {} m in the scene's file: coordinates here count from there\n", info.origin[0], info.origin[1], info.origin[2]);
  fmt::print(out.to, "files        {} shards, rows {} bytes, geometry {} bytes, index {} bytes\n\n", world.shards().size(),
             shardBytes(world, kKindRows), shardBytes(world, kKindGeometry), shardBytes(world, kKindIndex));
  printLevels(world, out.to);
  return {};
}

Result<void> inspectStats(const WholeWorld& world, const InspectOutput& out) {
  struct LevelStats {
    std::vector<uint64_t> rows_by_entries = std::vector<uint64_t>(18);  // bin k: 2^(k-1) .. 2^k - 1 entries; bin 0: none
    std::vector<uint64_t> entries_by_count = std::vector<uint64_t>(17);  // bin k: counts 2^k .. 2^(k+1) - 1
    uint64_t blocks = 0;
    double area = 0, sky = 0, absorbed = 0;  // m2, and area-weighted fractions until divided
  };
  std::vector<LevelStats> all(world.levels().size());
  for (uint32_t l = 0; l < all.size(); ++l)
    for (const TileInfo& tile : world.tiles(l)) {
      auto strip = world.strip(tile.id);
      if (!strip) return strip.error();
      LevelStats& s = all[l];
      std::vector<uint32_t> entries(strip->nodes.size());
      for (const uint8_t row : strip->rows) ++entries[row];
      for (const uint32_t n : entries) ++s.rows_by_entries[static_cast<size_t>(std::bit_width(n))];
      for (const uint16_t n : strip->counts) ++s.entries_by_count[static_cast<size_t>(std::bit_width(n)) - 1];
      s.blocks += strip->blocks.size();
      for (const Node& n : strip->nodes) {
        const double a = static_cast<double>(n.area_m2), q = n.quanta > 0 ? n.quanta : 1;
        s.area += a;
        s.sky += a * static_cast<double>(n.sky_fraction);
        s.absorbed += a * n.absorbed / q;
      }
    }
  const auto patches = static_cast<double>(world.levels()[0].nodes);
  double strip_bytes = 0;
  for (const TileInfo& tile : world.tiles(0)) strip_bytes += tile.strip.stored_bytes;
  const double strips = strip_bytes / patches, index = static_cast<double>(world.levels()[0].stored_bytes) / patches - strips;
  const double geometry = static_cast<double>(shardBytes(world, kKindGeometry)) / patches;
  double upper = -static_cast<double>(world.levels()[0].stored_bytes);
  for (const LevelInfo& l : world.levels()) upper += static_cast<double>(l.stored_bytes);
  upper /= patches;

  const auto trimmed = [](std::vector<uint64_t> bins) {
    while (!bins.empty() && bins.back() == 0) bins.pop_back();
    return bins;
  };
  if (out.json) {
    json levels = json::array();
    for (uint32_t l = 0; l < all.size(); ++l) {
      json j = levelJson(world, l);
      j["rows_by_entries_log2"] = trimmed(all[l].rows_by_entries);
      j["entries_by_count_log2"] = trimmed(all[l].entries_by_count);
      j["blocks"] = all[l].blocks;
      j["area_m2"] = all[l].area;
      j["sky_fraction"] = all[l].sky / all[l].area;
      j["absorbed_fraction"] = all[l].absorbed / all[l].area;
      levels.push_back(std::move(j));
    }
    fmt::print(out.to, "{}\n",
               json{{"bytes_per_patch",
                     {{"level0_strips", strips}, {"level0_index", index}, {"coarser_levels", upper}, {"geometry", geometry}}},
                    {"pyramid_over_level0", pyramidRatio(world)},
                    {"levels", levels}}
                   .dump());
    return {};
  }
  printLevels(world, out.to);
  fmt::print(out.to, "\nbytes a patch: level-0 strips {:.1f} + index {:.2f}; coarser levels {:.1f}; drawing geometry {:.1f}\n",
             strips, index, upper, geometry);
  for (uint32_t l = 0; l < all.size(); ++l) {
    const LevelStats& s = all[l];
    fmt::print(out.to, "\nlevel {}: {:.6g} m2, sky {:.2f} %, absorbed {:.4f} %, {:.1f} entries a block\n", l, s.area,
               100 * s.sky / s.area, 100 * s.absorbed / s.area,
               ratio(static_cast<double>(world.levels()[l].entries), static_cast<double>(s.blocks)));
    fmt::print(out.to, "  rows by entries:  ");
    const auto rows = trimmed(s.rows_by_entries), counts = trimmed(s.entries_by_count);
    for (size_t k = 0; k < rows.size(); ++k)
      if (rows[k] > 0) fmt::print(out.to, " {}+: {}", k == 0 ? 0 : 1 << (k - 1), rows[k]);
    fmt::print(out.to, "\n  entries by count: ");
    for (size_t k = 0; k < counts.size(); ++k)
      if (counts[k] > 0) fmt::print(out.to, " {}+: {}", 1 << k, counts[k]);
    fmt::print(out.to, "\n");
  }
  return {};
}

}  // namespace ff::tools
