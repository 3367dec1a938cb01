#include <fmt/core.h>
#include <fmt/ranges.h>
#include <nanovdb/NanoVDB.h>

#include <algorithm>
#include <cmath>

#include "tools/inspect/inspect.h"
#include "tools/inspect/world_check.h"

namespace ff::tools {

using namespace ff::formats;
using nlohmann::json;

json toJson(Vec3 v) { return {v.x, v.y, v.z}; }
json toJson(const Box& box) { return {{"lo", toJson(box.lo)}, {"hi", toJson(box.hi)}}; }

json toJson(const Node& n) {
  return {{"area_m2", n.area_m2},
          {"centroid", toJson(n.centroid)},
          {"normal", toJson(n.normal)},
          {"albedo", toJson(n.albedo)},
          {"emission", toJson(n.emission)},
          {"parent", n.parent == kNoParent ? json() : json(n.parent)},
          {"quanta", n.quanta},
          {"sky", n.sky},
          {"absorbed", n.absorbed},
          {"row_total", n.row_total},
          {"sky_fraction", n.sky_fraction},
          {"sky_direction", toJson(n.sky_direction)},
          {"sky_quadratic", n.sky_quadratic},
          {"lamp_group", n.lamp_group == kNoLampGroup ? json() : json(n.lamp_group)}};
}

std::string groupName(const World& world, uint16_t group) {
  const auto& groups = world.info().lamp_groups;
  return group < groups.size() ? groups[group].name : "?";
}

std::string hexText(std::span<const uint8_t> bytes) {
  std::string s;
  for (const uint8_t b : bytes) s += fmt::format("{:02x}", b);
  return s;
}

Result<void> checkLevel(const World& world, uint32_t level) {
  if (level < world.levels().size()) return {};
  return Error{ErrorCode::kUsage, world.path(), "level " + std::to_string(level),
               "the world has " + std::to_string(world.levels().size()) + " levels", "levels count from 0"};
}

Result<void> checkNode(const World& world, uint32_t level, uint32_t node) {
  if (auto ok = checkLevel(world, level); !ok) return ok;
  if (node < world.levels()[level].nodes) return {};
  return Error{ErrorCode::kUsage, world.path(), "node " + std::to_string(node),
               "level " + std::to_string(level) + " has " + std::to_string(world.levels()[level].nodes) + " nodes",
               "nodes count from 0"};
}

Result<Strip> stripOfNode(const World& world, uint32_t level, uint32_t node) {
  if (auto ok = checkNode(world, level, node); !ok) return ok.error();
  return world.strip({level, world.tileOf(level, node)});
}

namespace {

struct RowEntry {
  uint32_t column = 0;  // node number
  uint16_t count = 0;
};

std::vector<RowEntry> rowEntries(const World& world, const Strip& strip, uint32_t row) {
  std::vector<RowEntry> entries;
  size_t e = 0;
  for (const Block& block : strip.blocks)
    for (const size_t end = e + block.entries; e < end; ++e)
      if (strip.rows[e] == row)
        entries.push_back({world.tiles(strip.id.level)[block.partner_tile].first_node + strip.columns[e], strip.counts[e]});
  return entries;
}

void printVec(std::FILE* to, const char* name, Vec3 v) { fmt::print(to, "{:<14}{:.6g} {:.6g} {:.6g}\n", name, v.x, v.y, v.z); }

// Of one row of a strip.
std::vector<LampLight> lampsOf(const Strip& strip, uint32_t row) {
  std::vector<LampLight> lamps;
  for (const LampLight& lamp : strip.lamps)
    if (lamp.row == row) lamps.push_back(lamp);
  return lamps;
}

json lampsJson(const World& world, std::span<const LampLight> lamps) {
  json list = json::array();
  for (const LampLight& lamp : lamps)
    list.push_back({{"group", lamp.group}, {"name", groupName(world, lamp.group)}, {"weight", toJson(lamp.weight)}});
  return list;
}

void printNode(std::FILE* to, const World& world, const Node& n) {
  fmt::print(to, "{:<14}{:.6g}\n", "area_m2", n.area_m2);
  printVec(to, "centroid", n.centroid);
  printVec(to, "normal", n.normal);
  printVec(to, "albedo", n.albedo);
  printVec(to, "emission", n.emission);
  if (n.lamp_group != kNoLampGroup) fmt::print(to, "{:<14}{} \"{}\"\n", "lamp_group", n.lamp_group, groupName(world, n.lamp_group));
  if (n.parent != kNoParent) fmt::print(to, "{:<14}{}\n", "parent", n.parent);
  fmt::print(to, "{:<14}{} = sky {} + absorbed {} + entries {}\n", "quanta", n.quanta, n.sky, n.absorbed,
             n.quanta - n.sky - n.absorbed);
  fmt::print(to, "{:<14}{:.6g}\n", "row_total", n.row_total);
  fmt::print(to, "{:<14}{:.6g}\n", "sky_fraction", n.sky_fraction);
  printVec(to, "sky_direction", n.sky_direction);
  fmt::print(to, "{:<14}{:.3g}\n", "sky_quadratic", fmt::join(n.sky_quadratic, " "));
}

}  // namespace

Result<void> inspectRow(const World& world, uint32_t level, uint32_t node, const InspectOutput& out) {
  auto strip = stripOfNode(world, level, node);
  if (!strip) return strip.error();
  const uint32_t index = node - strip->first_node;
  const Node& n = strip->nodes[index];
  const std::vector<RowEntry> entries = rowEntries(world, *strip, index);
  if (out.json) {
    json j = toJson(n);
    j["level"] = level;
    j["node"] = node;
    j["tile"] = strip->id.tile;
    if (level > 0) j["children"] = {world.children(level, node).first, world.children(level, node).second};
    j["lamps"] = lampsJson(world, lampsOf(*strip, index));
    j["entries"] = json::array();
    for (const RowEntry& e : entries)
      j["entries"].push_back({{"column", e.column}, {"count", e.count}, {"form_factor", static_cast<double>(e.count) / n.quanta}});
    fmt::print(out.to, "{}\n", j.dump());
    return {};
  }
  fmt::print(out.to, "node {} of level {}, in tile {}\n", node, level, strip->id.tile);
  printNode(out.to, world, n);
  if (level > 0) {
    const auto [first, last] = world.children(level, node);
    fmt::print(out.to, "{:<14}{} to {} of level {}\n", "children", first, last - 1, level - 1);
  }
  for (const LampLight& lamp : lampsOf(*strip, index))
    fmt::print(out.to, "{:<14}{} \"{}\": {:.6g} {:.6g} {:.6g} of its emission arrives\n", "lamp", lamp.group,
               groupName(world, lamp.group), lamp.weight.x, lamp.weight.y, lamp.weight.z);
  fmt::print(out.to, "\n{:>10} {:>6} {:>12} {:>8}\n", "column", "count", "form factor", "tile");
  for (const RowEntry& e : entries)
    fmt::print(out.to, "{:>10} {:>6} {:>12.6f} {:>8}\n", e.column, e.count, static_cast<double>(e.count) / n.quanta,
               world.tileOf(level, e.column));
  return {};
}

Result<void> inspectTile(const World& world, TileId id, const InspectOutput& out) {
  if (auto ok = checkLevel(world, id.level); !ok) return ok;
  if (id.tile >= world.tiles(id.level).size())
    return Error{ErrorCode::kUsage, world.path(), "tile " + std::to_string(id.tile),
                 "level " + std::to_string(id.level) + " has " + std::to_string(world.tiles(id.level).size()) + " tiles",
                 "tiles count from 0"};
  const TileInfo& info = world.tiles(id.level)[id.tile];
  auto strip = world.strip(id);
  if (!strip) return strip.error();
  if (out.json) {
    json nodes = json::array(), blocks = json::array();
    for (uint32_t i = 0; i < strip->nodes.size(); ++i) {
      nodes.push_back(toJson(strip->nodes[i]));
      nodes.back()["lamps"] = lampsJson(world, lampsOf(*strip, i));
    }
    for (const Block& b : strip->blocks) blocks.push_back({{"partner_tile", b.partner_tile}, {"entries", b.entries}});
    fmt::print(out.to, "{}\n",
               json{{"level", id.level},
                    {"tile", id.tile},
                    {"shard", world.shards()[info.shard].name},
                    {"offset", info.offset},
                    {"stored_bytes", info.stored_bytes},
                    {"raw_bytes", info.raw_bytes},
                    {"first_node", info.first_node},
                    {"entries", info.entries},
                    {"bounds", toJson(info.bounds)},
                    {"nodes", nodes},
                    {"blocks", blocks}}
                   .dump());
    return {};
  }
  fmt::print(out.to, "tile {}:{} in {} at offset {}: {} bytes stored, {} raw\n", id.level, id.tile,
             world.shards()[info.shard].name, info.offset, info.stored_bytes, info.raw_bytes);
  fmt::print(out.to, "nodes {} to {}, {} entries in {} blocks\n", info.first_node, info.first_node + info.nodes - 1,
             info.entries, strip->blocks.size());
  printVec(out.to, "bounds lo", info.bounds.lo);
  printVec(out.to, "bounds hi", info.bounds.hi);
  fmt::print(out.to, "\n{:>9} {:>10} {:>28} {:>21} {:>21} {:>6} {:>6} {:>8} {:>8} {:>6} {:>6}\n", "node", "area_m2", "centroid", "normal",
             "albedo", "quanta", "sky", "absorbed", "sky %", "total", "lamps");
  for (size_t i = 0; i < strip->nodes.size(); ++i) {
    const Node& n = strip->nodes[i];
    fmt::print(out.to, "{:>9} {:>10.4g} {:>28} {:>21} {:>21} {:>6} {:>6} {:>8} {:>8.3f} {:>6.3f} {:>6}\n", strip->first_node + i, n.area_m2,
               fmt::format("{:.2f} {:.2f} {:.2f}", n.centroid.x, n.centroid.y, n.centroid.z),
               fmt::format("{:.2f} {:.2f} {:.2f}", n.normal.x, n.normal.y, n.normal.z),
               fmt::format("{:.3f} {:.3f} {:.3f}", n.albedo.x, n.albedo.y, n.albedo.z), n.quanta, n.sky, n.absorbed,
               100 * n.sky_fraction, n.row_total, lampsOf(*strip, static_cast<uint32_t>(i)).size());
  }
  return {};
}

Result<void> inspectPair(const World& world, uint32_t level, uint32_t i, uint32_t j, const InspectOutput& out) {
  auto strip_i = stripOfNode(world, level, i);
  if (!strip_i) return strip_i.error();
  auto strip_j = stripOfNode(world, level, j);
  if (!strip_j) return strip_j.error();
  const auto countOf = [&](const Strip& strip, uint32_t row, uint32_t column) -> uint32_t {
    for (const RowEntry& e : rowEntries(world, strip, row - strip.first_node))
      if (e.column == column) return e.count;
    return 0;
  };
  const Node &a = strip_i->nodes[i - strip_i->first_node], &b = strip_j->nodes[j - strip_j->first_node];
  const uint32_t n_ij = countOf(*strip_i, i, j), n_ji = countOf(*strip_j, j, i);
  const auto endOf = [](const Node& n, uint32_t count) {
    return PairEnd{static_cast<double>(n.area_m2), static_cast<double>(n.row_total), n.quanta, count};
  };
  const PairCheck p = checkPair(level, i, j, endOf(a, n_ij), endOf(b, n_ji));
  const double f_ij = a.quanta > 0 ? static_cast<double>(n_ij) / a.quanta : 0;
  const double f_ji = b.quanta > 0 ? static_cast<double>(n_ji) / b.quanta : 0;
  const double distance = static_cast<double>(length(a.centroid - b.centroid));
  if (out.json) {
    fmt::print(out.to, "{}\n",
               json{{"level", level}, {"i", i}, {"j", j}, {"count_ij", n_ij}, {"count_ji", n_ji}, {"form_factor_ij", f_ij},
                    {"form_factor_ji", f_ji}, {"x_ij_m2", p.x_ij}, {"x_ji_m2", p.x_ji}, {"allowed_m2", p.bound},
                    {"of_allowed", p.ratio()}, {"distance_m", distance}}
                   .dump());
    return {};
  }
  fmt::print(out.to, "F {} <- {}   {:.6f}  ({} of {}), X = {:.6g} m2\n", i, j, f_ij, n_ij, a.quanta, p.x_ij);
  fmt::print(out.to, "F {} <- {}   {:.6f}  ({} of {}), X = {:.6g} m2\n", j, i, f_ji, n_ji, b.quanta, p.x_ji);
  fmt::print(out.to, "difference {:.6g} m2, {:.0f} % of what sampling allows; centroids {:.4g} m apart\n",
             std::abs(p.x_ij - p.x_ji), 100 * p.ratio(), distance);
  return {};
}

namespace {

// 1 + tile of the cell; 0 if there is none, or no usable grid.
int32_t gridValue(const World& world, const std::array<int32_t, 3>& cell) {
  const auto bytes = world.spatialGrid();
  if (bytes.size() < sizeof(nanovdb::GridData)) return 0;
  const auto* grid = reinterpret_cast<const nanovdb::NanoGrid<int32_t>*>(bytes.data());
  if (!grid->isValid() || grid->gridType() != nanovdb::GridType::Int32 || grid->gridSize() > bytes.size()) return 0;
  return grid->getAccessor().getValue(nanovdb::Coord(cell[0], cell[1], cell[2]));
}

}  // namespace

Result<void> inspectLocate(const World& world, Vec3 point, const InspectOutput& out) {
  const WorldInfo& info = world.info();
  std::array<int32_t, 3> cell{};
  for (int c = 0; c < 3; ++c) {
    const float v = std::floor((point[c] - info.grid_origin[c]) / info.cell_m);
    if (!(std::abs(v) < 2e9f))
      return Error{ErrorCode::kUsage, "", "locate", "coordinates are too large", "give metres, as in the bounds of info"};
    cell[static_cast<size_t>(c)] = static_cast<int32_t>(v);
  }
  const int32_t value = gridValue(world, cell);
  const auto tiles = world.tiles(0);
  // A cell's patches follow each other, so they may go on in the next tile. Where the cell is empty, all tiles are
  // candidates, nearest first.
  std::vector<uint32_t> candidates;
  if (value > 0 && static_cast<uint32_t>(value) <= tiles.size()) {
    candidates.push_back(static_cast<uint32_t>(value) - 1);
    if (static_cast<uint32_t>(value) < tiles.size()) candidates.push_back(static_cast<uint32_t>(value));
  } else {
    for (uint32_t t = 0; t < tiles.size(); ++t) candidates.push_back(t);
    std::stable_sort(candidates.begin(), candidates.end(), [&](uint32_t a, uint32_t b) {
      return tiles[a].bounds.distance(point) < tiles[b].bounds.distance(point);
    });
  }
  uint32_t best = 0;
  Node best_node;
  float best_distance = INFINITY;
  for (const uint32_t t : candidates) {
    if (tiles[t].bounds.distance(point) > best_distance) continue;
    auto strip = world.strip({0, t});
    if (!strip) return strip.error();
    for (uint32_t i = 0; i < strip->nodes.size(); ++i)
      if (const float d = length(strip->nodes[i].centroid - point); d < best_distance) {
        best_distance = d;
        best = strip->first_node + i;
        best_node = strip->nodes[i];
      }
  }
  if (out.json) {
    json j{{"cell", cell}, {"cell_holds_patches", value > 0}, {"tile", world.tileOf(0, best)}, {"node", best},
           {"distance_m", best_distance}};
    j["patch"] = toJson(best_node);
    fmt::print(out.to, "{}\n", j.dump());
    return {};
  }
  fmt::print(out.to, "cell {} {} {}{}\n", cell[0], cell[1], cell[2], value > 0 ? "" : " (holds no patches)");
  fmt::print(out.to, "nearest patch {} in tile 0:{}, centroid {:.4g} m away\n", best, world.tileOf(0, best), best_distance);
  printNode(out.to, world, best_node);
  return {};
}

}  // namespace ff::tools
