#include <fmt/core.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <optional>
#include <queue>

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
          {"samples", n.quanta},
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

namespace {

std::string textOf(const ChunkCell& cell) { return fmt::format("{},{},{}", cell[0], cell[1], cell[2]); }
std::string textOf(const NodeName& node) { return fmt::format("{} {} {}", textOf(node.tile.chunk), node.tile.tile, node.index); }
json toJson(const NodeName& node) { return {{"level", node.level}, {"chunk", node.tile.chunk}, {"tile", node.tile.tile}, {"index", node.index}}; }
NodeName nameOf(const TileRef& tile, uint32_t index) { return {tile.id().level, tile.name(), index}; }

struct NamedStrip {
  TileRef tile;
  Strip strip;
  std::vector<TileRef> partners;  // by block
};

Result<NamedStrip> readStrip(const World& world, uint32_t level, const TileName& name) {
  auto tile = world.tile(level, name);
  if (!tile) return tile.error();
  NamedStrip out;
  out.tile = *tile;
  std::vector<std::byte> stored(tile->info().strip.stored_bytes);
  if (auto ok = world.readStored(tile->info().strip, stored); !ok) return ok.error();
  World::PartnerChunks chunks;
  if (auto ok = world.decodeStrip(*tile, stored, out.strip, &chunks); !ok) return ok.error();
  for (const auto& [chunk, end_block] : chunks)
    for (size_t b = out.partners.size(); b < end_block; ++b) out.partners.push_back({chunk, out.strip.blocks[b].partner_tile - chunk->firstTile()});
  return out;
}

Result<NamedStrip> readStrip(const World& world, const NodeName& node) {
  auto strip = readStrip(world, node.level, node.tile);
  if (strip && node.index >= strip->strip.nodes.size())
    return Error{ErrorCode::kUsage, world.path(), tileText(strip->tile), "has " + std::to_string(strip->strip.nodes.size()) + " nodes", "nodes count from 0"};
  return strip;
}

struct RowEntry {
  NodeName column;
  uint64_t number = 0;  // of the column within its level
  uint16_t count = 0;
};

std::vector<RowEntry> rowEntries(const NamedStrip& s, uint32_t row) {
  std::vector<RowEntry> entries;
  size_t e = 0;
  for (size_t b = 0; b < s.strip.blocks.size(); ++b) {
    const TileRef& partner = s.partners[b];
    for (const size_t end = e + s.strip.blocks[b].entries; e < end; ++e)
      if (s.strip.rows[e] == row)
        entries.push_back({nameOf(partner, s.strip.columns[e]), partner.info().first_node + s.strip.columns[e], s.strip.counts[e]});
  }
  return entries;
}

// The children of a node, which lie in one tile; level >= 1.
Result<std::vector<NodeName>> childrenOf(const World& world, const TileRef& tile, uint32_t index) {
  const auto below = world.childTiles(tile);
  if (!below) return below.error();
  std::vector<NodeName> children;
  for (uint32_t t = below->first; t < below->end && children.empty(); ++t) {
    const TileRef child{below->chunk, t};
    const auto parents = child.parentIndex();
    for (uint32_t i = 0; i < parents.size(); ++i)
      if (parents[i] == index) children.push_back(nameOf(child, i));
  }
  return children;
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
    list.push_back({{"group", lamp.group}, {"name", groupName(world, lamp.group)}, {"weight", ff::tools::toJson(lamp.weight)}});
  return list;
}

void printNode(std::FILE* to, const World& world, const Node& n) {
  fmt::print(to, "{:<14}{:.6g}\n", "area_m2", n.area_m2);
  printVec(to, "centroid", n.centroid);
  printVec(to, "normal", n.normal);
  printVec(to, "albedo", n.albedo);
  printVec(to, "emission", n.emission);
  if (n.lamp_group != kNoLampGroup) fmt::print(to, "{:<14}{} \"{}\"\n", "lamp_group", n.lamp_group, groupName(world, n.lamp_group));
  fmt::print(to, "{:<14}{} = sky {} + absorbed {} + entries {}\n", "samples", n.quanta, n.sky, n.absorbed,
             n.quanta - n.sky - n.absorbed);
  fmt::print(to, "{:<14}{:.6g}\n", "row_total", n.row_total);
  fmt::print(to, "{:<14}{:.6g}\n", "sky_fraction", n.sky_fraction);
  printVec(to, "sky_direction", n.sky_direction);
  fmt::print(to, "{:<14}{:.3g}\n", "sky_quadratic", fmt::join(n.sky_quadratic, " "));
}

}  // namespace

Result<void> inspectRow(const World& world, const NodeName& node, const InspectOutput& out) {
  const auto strip = readStrip(world, node);
  if (!strip) return strip.error();
  const Node& n = strip->strip.nodes[node.index];
  const std::vector<RowEntry> entries = rowEntries(*strip, node.index);
  const bool top = strip->tile.chunk->isTop();
  std::vector<NodeName> children;
  if (node.level > 0) {
    auto found = childrenOf(world, strip->tile, node.index);
    if (!found) return found.error();
    children = std::move(*found);
  }
  const auto parent = [&] { return nameOf(strip->tile.parent(), strip->tile.parentIndex()[node.index]); };
  if (out.json) {
    json j = toJson(n);
    j["name"] = toJson(node);
    j["parent"] = top ? json() : toJson(parent());
    if (node.level > 0) j["children"] = json::array();
    for (const NodeName& child : children) j["children"].push_back(toJson(child));
    j["lamps"] = lampsJson(world, lampsOf(strip->strip, node.index));
    j["entries"] = json::array();
    for (const RowEntry& e : entries)
      j["entries"].push_back({{"column", toJson(e.column)}, {"count", e.count}, {"form_factor", static_cast<double>(e.count) / n.quanta}});
    fmt::print(out.to, "{}\n", j.dump());
    return {};
  }
  fmt::print(out.to, "node {} of {}\n", node.index, tileText(strip->tile));
  printNode(out.to, world, n);
  if (!top) fmt::print(out.to, "{:<14}{} {}\n", "parent", node.level + 1, textOf(parent()));
  if (!children.empty()) {  // all of one tile
    fmt::print(out.to, "{:<14}{} {} {}", "children", node.level - 1, textOf(children[0].tile.chunk), children[0].tile.tile);
    for (const NodeName& child : children) fmt::print(out.to, " {}", child.index);
    fmt::print(out.to, "\n");
  }
  for (const LampLight& lamp : lampsOf(strip->strip, node.index))
    fmt::print(out.to, "{:<14}{} \"{}\": {:.6g} {:.6g} {:.6g} of its emission arrives\n", "lamp", lamp.group,
               groupName(world, lamp.group), lamp.weight.x, lamp.weight.y, lamp.weight.z);
  fmt::print(out.to, "\n{:>12} {:>5} {:>5} {:>6} {:>12}\n", "chunk", "tile", "index", "count", "form factor");
  for (const RowEntry& e : entries)
    fmt::print(out.to, "{:>12} {:>5} {:>5} {:>6} {:>12.6f}\n", textOf(e.column.tile.chunk), e.column.tile.tile, e.column.index, e.count,
               static_cast<double>(e.count) / n.quanta);
  return {};
}

Result<void> inspectTile(const World& world, uint32_t level, const TileName& name, const InspectOutput& out) {
  const auto read = readStrip(world, level, name);
  if (!read) return read.error();
  const Strip* const strip = &read->strip;
  const TileInfo& info = read->tile.info();
  const Extent& extent = info.strip;
  if (out.json) {
    json nodes = json::array(), blocks = json::array();
    for (uint32_t i = 0; i < strip->nodes.size(); ++i) {
      nodes.push_back(toJson(strip->nodes[i]));
      nodes.back()["lamps"] = lampsJson(world, lampsOf(*strip, i));
    }
    for (size_t b = 0; b < strip->blocks.size(); ++b)
      blocks.push_back({{"chunk", read->partners[b].name().chunk}, {"tile", read->partners[b].name().tile}, {"entries", strip->blocks[b].entries}});
    fmt::print(out.to, "{}\n",
               json{{"level", level},
                    {"chunk", name.chunk},
                    {"tile", name.tile},
                    {"shard", world.shards()[extent.shard].name},
                    {"offset", extent.offset},
                    {"stored_bytes", extent.stored_bytes},
                    {"raw_bytes", extent.raw_bytes},
                    {"entries", info.entries},
                    {"bounds", toJson(info.bounds)},
                    {"nodes", nodes},
                    {"blocks", blocks}}
                   .dump());
    return {};
  }
  fmt::print(out.to, "{}, in {} at offset {}: {} bytes stored, {} raw\n", tileText(read->tile), world.shards()[extent.shard].name, extent.offset,
             extent.stored_bytes, extent.raw_bytes);
  fmt::print(out.to, "{} nodes, {} entries in {} blocks\n", info.nodes, info.entries, strip->blocks.size());
  printVec(out.to, "bounds lo", info.bounds.lo);
  printVec(out.to, "bounds hi", info.bounds.hi);
  fmt::print(out.to, "\n{:>5} {:>10} {:>28} {:>21} {:>21} {:>7} {:>6} {:>8} {:>8} {:>6} {:>6}\n", "index", "area_m2", "centroid", "normal",
             "albedo", "samples", "sky", "absorbed", "sky %", "total", "lamps");
  for (size_t i = 0; i < strip->nodes.size(); ++i) {
    const Node& n = strip->nodes[i];
    fmt::print(out.to, "{:>5} {:>10.4g} {:>28} {:>21} {:>21} {:>7} {:>6} {:>8} {:>8.3f} {:>6.3f} {:>6}\n", i, n.area_m2,
               fmt::format("{:.2f} {:.2f} {:.2f}", n.centroid.x, n.centroid.y, n.centroid.z),
               fmt::format("{:.2f} {:.2f} {:.2f}", n.normal.x, n.normal.y, n.normal.z),
               fmt::format("{:.3f} {:.3f} {:.3f}", n.albedo.x, n.albedo.y, n.albedo.z), n.quanta, n.sky, n.absorbed,
               100 * n.sky_fraction, n.row_total, lampsOf(*strip, static_cast<uint32_t>(i)).size());
  }
  return {};
}

Result<void> inspectPair(const World& world, const NodeName& i, const NodeName& j, const InspectOutput& out) {
  const auto strip_i = readStrip(world, i);
  if (!strip_i) return strip_i.error();
  const auto strip_j = readStrip(world, j);
  if (!strip_j) return strip_j.error();
  const auto numberOf = [](const NamedStrip& s, const NodeName& node) { return s.strip.first_node + node.index; };
  const auto countOf = [](const NamedStrip& strip, uint32_t row, uint64_t column) -> uint32_t {
    for (const RowEntry& e : rowEntries(strip, row))
      if (e.number == column) return e.count;
    return 0;
  };
  const uint32_t level = i.level;
  const Node &a = strip_i->strip.nodes[i.index], &b = strip_j->strip.nodes[j.index];
  const uint32_t n_ij = countOf(*strip_i, i.index, numberOf(*strip_j, j)), n_ji = countOf(*strip_j, j.index, numberOf(*strip_i, i));
  const auto endOf = [](const Node& n, uint32_t count) {
    return PairEnd{static_cast<double>(n.area_m2), static_cast<double>(n.row_total), n.quanta, count};
  };
  const PairCheck p = checkPair(level, numberOf(*strip_i, i), numberOf(*strip_j, j), endOf(a, n_ij), endOf(b, n_ji));
  const double f_ij = a.quanta > 0 ? static_cast<double>(n_ij) / a.quanta : 0;
  const double f_ji = b.quanta > 0 ? static_cast<double>(n_ji) / b.quanta : 0;
  const double distance = static_cast<double>(length(a.centroid - b.centroid));
  if (out.json) {
    fmt::print(out.to, "{}\n",
               json{{"i", toJson(i)}, {"j", toJson(j)}, {"count_ij", n_ij}, {"count_ji", n_ji}, {"form_factor_ij", f_ij},
                    {"form_factor_ji", f_ji}, {"x_ij_m2", p.x_ij}, {"x_ji_m2", p.x_ji}, {"allowed_m2", p.bound},
                    {"of_allowed", p.ratio()}, {"distance_m", distance}}
                   .dump());
    return {};
  }
  fmt::print(out.to, "F {} <- {}   {:.6f}  ({} of {}), X = {:.6g} m2\n", textOf(i), textOf(j), f_ij, n_ij, a.quanta, p.x_ij);
  fmt::print(out.to, "F {} <- {}   {:.6f}  ({} of {}), X = {:.6g} m2\n", textOf(j), textOf(i), f_ji, n_ji, b.quanta, p.x_ji);
  fmt::print(out.to, "difference {:.6g} m2, {:.0f} % of what sampling allows; centroids {:.4g} m apart\n",
             std::abs(p.x_ij - p.x_ji), 100 * p.ratio(), distance);
  return {};
}

// The nearest patch: chunks and tiles are opened in the order of their distance, until none can be nearer than what was found.
Result<void> inspectLocate(const World& world, const std::array<double, 3>& at, const InspectOutput& out) {
  Vec3 point;
  for (size_t a = 0; a < 3; ++a) point[static_cast<int>(a)] = static_cast<float>(at[a] - world.info().origin[a]);
  struct Place {
    float distance;
    ChunkPtr chunk;  // of a tile; of a child that has not been read: its parent
    uint32_t number;
    bool child;
    bool operator<(const Place& other) const { return distance > other.distance; }
  };
  std::priority_queue<Place> places;
  const auto offerChildren = [&](const ChunkPtr& chunk) {
    for (uint32_t k = 0; k < chunk->children.size(); ++k) places.push({chunk->children[k].bounds.distance(point), chunk, k, true});
  };
  offerChildren(world.root());
  NodeName best;
  Node best_node;
  float best_distance = INFINITY;
  while (!places.empty() && places.top().distance < best_distance) {
    const Place place = places.top();
    places.pop();
    if (place.child) {
      auto chunk = world.child(place.chunk, place.number);
      if (!chunk) return chunk.error();
      offerChildren(*chunk);
      if ((*chunk)->level == 0)
        for (uint32_t t = 0; t < (*chunk)->tiles.size(); ++t) places.push({(*chunk)->tiles[t].bounds.distance(point), *chunk, t, false});
      continue;
    }
    const TileRef tile{place.chunk, place.number};
    const auto strip = world.strip(tile);
    if (!strip) return strip.error();
    for (uint32_t i = 0; i < strip->nodes.size(); ++i)
      if (const float d = length(strip->nodes[i].centroid - point); d < best_distance) {
        best_distance = d;
        best = nameOf(tile, i);
        best_node = strip->nodes[i];
      }
  }
  if (!std::isfinite(best_distance)) return Error{ErrorCode::kUsage, "", "locate", "coordinates are too large", "give metres, as in the bounds of info"};
  if (out.json) {
    json j{{"name", toJson(best)}, {"distance_m", best_distance}};
    j["patch"] = toJson(best_node);
    fmt::print(out.to, "{}\n", j.dump());
    return {};
  }
  fmt::print(out.to, "nearest patch {} {}: its centroid is {:.4g} m away (level, chunk, tile, index: as `row` takes it)\n", best.level, textOf(best), best_distance);
  printNode(out.to, world, best_node);
  return {};
}

}  // namespace ff::tools
