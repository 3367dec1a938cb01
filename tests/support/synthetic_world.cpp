#include "tests/support/synthetic_world.h"

#include <algorithm>
#include <array>
#include <map>
#include <random>

namespace ff::stream {
namespace {

using formats::Node;
using formats::Strip;

uint32_t evenBits(uint32_t code) {
  uint32_t bits = 0;
  for (uint32_t b = 0; b < 16; ++b) bits |= (code >> (2 * b) & 1) << b;
  return bits;
}

struct Random {
  std::mt19937_64 engine;
  uint32_t below(uint32_t n) { return static_cast<uint32_t>(engine() % n); }
  float uniform(float lo, float hi) { return lo + (hi - lo) * static_cast<float>(engine() >> 40) / 16777216.0f; }
  bool chance(double p) { return static_cast<double>(engine() >> 11) < p * 9007199254740992.0; }
};

using Row = std::map<uint32_t, uint32_t>;  // column node -> count

constexpr size_t kLampGroups = 3;
using LampIrradiance = std::array<Vec3, kLampGroups>;  // of a node from each group, W/m2

struct Level {
  std::vector<uint32_t> codes;  // Morton codes of the cells
  std::vector<Node> nodes;
  std::vector<Row> rows;
  std::vector<LampIrradiance> lamps;
  std::vector<Box> boxes;
};

Level makePatches(const SyntheticSettings& s, Random& random) {
  Level level;
  for (uint32_t code = 0; code < s.side * s.side; ++code) {
    if (random.chance(s.hole_share)) continue;
    const auto x = static_cast<float>(evenBits(code)), z = static_cast<float>(evenBits(code >> 1));
    Node node;
    node.area_m2 = s.equal_areas ? 1.0f : random.uniform(0.1f, 1.0f);
    node.centroid = {x + 0.5f, 0, z + 0.5f};
    node.normal = {0, 1, 0};
    for (int c = 0; c < 3; ++c) node.albedo[c] = s.albedo >= 0 ? s.albedo : random.uniform(0.05f, 0.9f);
    if (random.chance(0.1)) node.emission = {random.uniform(0, 10), random.uniform(0, 10), random.uniform(0, 10)};
    node.lamp_group = static_cast<uint16_t>((code >> 2 * (s.levels - 1)) % kLampGroups);  // one beneath each top-level node
    if (node.lamp_group == s.without_lamps) node.emission = {};
    node.quanta = s.quanta;
    node.sky_direction = {0.1f, 0.7f, -0.2f};
    node.sky_quadratic = {0.5f, -0.25f, 0, 1, 0.125f};
    level.codes.push_back(code);
    level.nodes.push_back(node);
    level.boxes.push_back({{x, -0.5f, z}, {x + 1, 0.5f, z + 1}});
  }
  const auto count = static_cast<uint32_t>(level.nodes.size());
  for (uint32_t i = 0; i < count; ++i) {
    Row& row = level.rows.emplace_back();
    for (uint32_t q = 0; q < s.quanta; ++q) {
      if (random.chance(s.sky_share)) {
        ++level.nodes[i].sky;
        continue;
      }
      const uint32_t near = (i + count + random.below(41) - 20) % count;
      const uint32_t column = random.chance(s.far_share) ? random.below(count) : near;
      ++row[column == i ? (i + 1) % count : column];
    }
    level.nodes[i].sky_fraction = static_cast<float>(level.nodes[i].sky) / static_cast<float>(s.quanta);
  }
  // What the rows would have brought of the emission.
  for (uint32_t i = 0; i < count; ++i) {
    LampIrradiance& lamps = level.lamps.emplace_back();
    for (const auto& [column, n] : level.rows[i]) {
      const Node& from = level.nodes[column];
      lamps[from.lamp_group] += from.emission * (static_cast<float>(n) / static_cast<float>(s.quanta));
    }
  }
  return level;
}

Level aggregate(const Level& below, std::vector<uint32_t>& parents) {
  Level level;
  parents.clear();
  for (const uint32_t code : below.codes) {
    if (level.codes.empty() || level.codes.back() != code >> 2) level.codes.push_back(code >> 2);
    parents.push_back(static_cast<uint32_t>(level.codes.size() - 1));
  }
  level.nodes.resize(level.codes.size());
  level.rows.resize(level.codes.size());
  level.boxes.resize(level.codes.size());
  level.lamps.resize(level.codes.size());
  for (size_t i = 0; i < below.nodes.size(); ++i) {
    const Node& from = below.nodes[i];
    Node& to = level.nodes[parents[i]];
    to.area_m2 += from.area_m2;
    to.centroid += from.centroid * from.area_m2;
    to.albedo += from.albedo * from.area_m2;
    to.emission += from.emission * from.area_m2;
    to.quanta += from.quanta;
    to.sky += from.sky;
    to.normal = from.normal;
    to.sky_direction = from.sky_direction;
    to.sky_quadratic = from.sky_quadratic;
    to.sky_fraction += from.sky_fraction * from.area_m2;
    to.lamp_group = from.lamp_group;
    for (size_t g = 0; g < kLampGroups; ++g) level.lamps[parents[i]][g] += below.lamps[i][g] * from.area_m2;
    level.boxes[parents[i]].add(below.boxes[i]);
    for (const auto& [column, n] : below.rows[i]) level.rows[parents[i]][parents[column]] += n;
  }
  for (size_t i = 0; i < level.nodes.size(); ++i) {
    Node& node = level.nodes[i];
    for (Vec3* mean : {&node.centroid, &node.albedo, &node.emission}) *mean = *mean / node.area_m2;
    for (Vec3& mean : level.lamps[i]) mean = mean / node.area_m2;
    node.sky_fraction = std::min(1.0f, node.sky_fraction / node.area_m2);
  }
  return level;
}

// Tiles of up to tile_nodes of the level below one whose tiles are known, and the order of its nodes: every tile's odd parents have their children
// in other tiles than the even ones, and a family's second half comes after the first half of the next family. Returns where tiles start.
std::vector<uint32_t> cutTiles(const std::vector<uint32_t>& parents, const std::vector<uint32_t>& starts_above, uint32_t tile_nodes,
                               std::vector<uint32_t>& order) {
  std::vector<uint32_t> starts{0}, first(starts_above.back()), children(starts_above.back());
  for (size_t i = parents.size(); i-- > 0; ++children[parents[i]]) first[parents[i]] = static_cast<uint32_t>(i);
  std::vector<uint32_t> second_half;  // of the family before
  const auto flush = [&] {
    order.insert(order.end(), second_half.begin(), second_half.end());
    second_half.clear();
  };
  const auto close = [&] {
    flush();
    if (order.size() > starts.back()) starts.push_back(static_cast<uint32_t>(order.size()));
  };
  for (size_t t = 0; t + 1 < starts_above.size(); ++t)
    for (const uint32_t odd : {0u, 1u}) {
      for (uint32_t p = starts_above[t]; p < starts_above[t + 1]; ++p) {
        if (p % 2 != odd) continue;
        if (order.size() + second_half.size() + children[p] - starts.back() > tile_nodes) close();
        const uint32_t middle = first[p] + (children[p] + 1) / 2, end = first[p] + children[p];
        for (uint32_t i = first[p]; i < middle; ++i) order.push_back(i);
        flush();
        for (uint32_t i = middle; i < end; ++i) second_half.push_back(i);
      }
      close();
    }
  return starts;
}

// Gives the level's nodes new numbers: order holds the old ones. parents: of the level below; own_parents: of this one.
void reorder(const std::vector<uint32_t>& order, Level& level, std::vector<uint32_t>* own_parents, std::vector<uint32_t>* parents) {
  std::vector<uint32_t> number(order.size());
  for (uint32_t i = 0; i < order.size(); ++i) number[order[i]] = i;
  const Level old = level;
  const std::vector<uint32_t> old_parents = own_parents ? *own_parents : std::vector<uint32_t>();
  for (size_t i = 0; i < order.size(); ++i) {
    level.codes[i] = old.codes[order[i]];
    level.nodes[i] = old.nodes[order[i]];
    level.lamps[i] = old.lamps[order[i]];
    level.boxes[i] = old.boxes[order[i]];
    level.rows[i].clear();
    for (const auto& [column, n] : old.rows[order[i]]) level.rows[i][number[column]] = n;
    if (own_parents) (*own_parents)[i] = old_parents[order[i]];
  }
  if (parents)
    for (uint32_t& p : *parents) p = number[p];
}

void addStrips(const Level& level, uint32_t number, const std::vector<uint32_t>& starts, formats::RandomWorld& world) {
  std::vector<Strip> strips;
  std::vector<Box> bounds;
  for (uint32_t tile = 0; tile + 1 < starts.size(); ++tile) {
    Strip strip;
    strip.id = {number, tile};
    strip.first_node = starts[tile];
    Box box;
    std::map<std::array<uint32_t, 3>, uint32_t> entries;  // (partner, row, column) -> count
    for (uint32_t i = starts[tile]; i < starts[tile + 1]; ++i) {
      Node node = level.nodes[i];
      strip.nodes.push_back(node);
      for (uint16_t g = 0; g < kLampGroups; ++g) {
        formats::LampLight lamp{static_cast<uint8_t>(i - starts[tile]), g, {}};
        for (int c = 0; c < 3; ++c) {
          const float most = world.info.lamp_groups[g].emission[c];
          lamp.weight[c] = most > 0 ? std::min(1.0f, level.lamps[i][g][c] / most) : 0.0f;
        }
        if (!(lamp.weight == Vec3{})) strip.lamps.push_back(lamp);
      }
      box.add(level.boxes[i]);
      for (const auto& [column, n] : level.rows[i]) {
        const auto after = std::upper_bound(starts.begin(), starts.end(), column);
        const auto partner = static_cast<uint32_t>(after - starts.begin() - 1);
        entries[{partner, i - starts[tile], column - starts[partner]}] += n;
      }
    }
    for (const auto& [key, n] : entries) {
      if (strip.blocks.empty() || strip.blocks.back().partner_tile != key[0]) strip.blocks.push_back({key[0], 0});
      ++strip.blocks.back().entries;
      strip.rows.push_back(static_cast<uint8_t>(key[1]));
      strip.columns.push_back(static_cast<uint8_t>(key[2]));
      strip.counts.push_back(static_cast<uint16_t>(n));
    }
    world.info.bounds.add(box);
    strips.push_back(std::move(strip));
    bounds.push_back(box);
  }
  world.strips.push_back(std::move(strips));
  world.bounds.push_back(std::move(bounds));
}

}  // namespace

formats::RandomWorld makeSyntheticWorld(const SyntheticSettings& settings) {
  Random random{std::mt19937_64(settings.seed)};
  formats::RandomWorld world;
  Level level = makePatches(settings, random);
  for (size_t g = 0; g < kLampGroups; ++g) world.info.lamp_groups.push_back({"lamp " + std::to_string(g), {}, 0, 0});
  for (const Node& node : level.nodes) {
    if (node.emission == Vec3{}) continue;
    formats::LampGroup& group = world.info.lamp_groups[node.lamp_group];
    group.emission = max(group.emission, node.emission);
    group.area_m2 += static_cast<double>(node.area_m2);
    ++group.patches;
  }
  std::vector<Level> levels;
  levels.push_back(std::move(level));
  world.parents.resize(settings.levels - 1);
  while (levels.size() < settings.levels) levels.push_back(aggregate(levels.back(), world.parents[levels.size() - 1]));
  std::vector<std::vector<uint32_t>> starts(settings.levels);
  const auto top = static_cast<uint32_t>(levels.back().nodes.size());
  for (uint32_t i = 0; i < top; i += settings.tile_nodes) starts.back().push_back(i);
  starts.back().push_back(top);
  for (uint32_t l = settings.levels - 1; l-- > 0;) {
    std::vector<uint32_t> order;
    starts[l] = cutTiles(world.parents[l], starts[l + 1], settings.tile_nodes, order);
    reorder(order, levels[l], &world.parents[l], l > 0 ? &world.parents[l - 1] : nullptr);
  }
  for (uint32_t l = 0; l < settings.levels; ++l) addStrips(levels[l], l, starts[l], world);
  world.info.cell_m = 1;
  world.info.rays = world.info.fewest_rays = settings.quanta;
  // A row of the top has the sum of its patches' samples.
  uint32_t most = 0;
  for (const Node& node : levels.back().nodes) most = std::max(most, node.quanta);
  world.info.quanta = std::max(settings.quanta, (most + formats::kMaxRowFactor - 1) / formats::kMaxRowFactor);
  world.info.seed = settings.seed;
  world.info.generator = "synthetic_world";
  world.info.scene = "synthetic";
  world.info.area_m2 = static_cast<double>(settings.side) * settings.side;
  return world;
}

}  // namespace ff::stream
