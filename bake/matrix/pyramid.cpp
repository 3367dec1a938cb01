#include "bake/matrix/pyramid.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <compare>
#include <functional>
#include <map>
#include <numeric>
#include <tuple>

#include "bake/sorting.h"

namespace ff::bake {
namespace {

// That nodes of a level go by.
uint8_t brightnessAt(int level, uint8_t brightness) { return level <= kBrightLevels ? brightness : uint8_t{0}; }

formats::ChunkCell chunkOf(const Patch& patch, int level) {
  formats::ChunkCell chunk;
  for (size_t a = 0; a < 3; ++a) chunk[a] = patch.cell[a] >> (level + formats::kChunkLog);
  return chunk;
}

struct SortKey {
  uint64_t top;     // cell of the coarsest level
  uint32_t group;   // lamp group, orientation, openness, whether lamps light it
  uint32_t patch;
  uint64_t key;     // cell of the patch
  uint8_t brightness;
  // A cluster's patches follow each other on every level.
  friend bool operator<(const SortKey& a, const SortKey& b) {
    const uint64_t place_a = hilbertAncestor(a.key, kBrightLevels), place_b = hilbertAncestor(b.key, kBrightLevels);
    return std::tie(a.top, a.group, place_a, a.brightness, a.key, a.patch) < std::tie(b.top, b.group, place_b, b.brightness, b.key, b.patch);
  }
};

size_t countClusters(std::span<const Patch> patches, std::span<const uint32_t> group, std::span<const uint8_t> brightness, int level) {
  PagedVector<std::tuple<uint64_t, uint32_t, uint8_t>> clusters(patches.size());
  for (size_t i = 0; i < patches.size(); ++i)
    clusters[i] = {hilbertAncestor(patches[i].key, level), group[i], brightnessAt(level, brightness[i])};
  tbb::parallel_sort(clusters.begin(), clusters.end());
  return static_cast<size_t>(std::unique(clusters.begin(), clusters.end()) - clusters.begin());
}

// By patch, the octave of what lamps light it with; 1: below the mean of what is lit in its chunk, 0: not lit. An octave of the mean is stable: an edit that
// changes the mean a little moves nothing, and no other chunk counts.
PagedVector<uint8_t> brightnessOf(std::span<const Patch> patches, std::span<const float> lamp_light) {
  struct Lit {
    double power = 0, area_m2 = 0;
  };
  std::map<formats::ChunkCell, Lit> chunks;
  PagedVector<uint8_t> brightness(patches.size());
  for (size_t i = 0; i < lamp_light.size(); ++i) {
    if (lamp_light[i] <= 0) continue;
    Lit& lit = chunks[chunkOf(patches[i], 0)];
    const auto area_m2 = static_cast<double>(patches[i].area_m2);
    lit.power += area_m2 * static_cast<double>(lamp_light[i]);
    lit.area_m2 += area_m2;
  }
  for (size_t i = 0; i < lamp_light.size(); ++i) {
    if (lamp_light[i] <= 0) continue;
    const Lit& lit = chunks[chunkOf(patches[i], 0)];
    const int above = std::ilogb(lamp_light[i]) - std::ilogb(lit.power / lit.area_m2);
    brightness[i] = static_cast<uint8_t>(std::clamp(above + 2, 1, 255));
  }
  return brightness;
}

// Of a tile on levels where nodes are of one brightness, as Family::places counts: so few that kTileNodes seldom ends one, since rows of chunks far away name tiles and the patches
// below, and shadows must not change where they end. Against no such limit 0.7 % more bytes, and 1.3 times the tiles on level 1 (town of 60k).
constexpr uint32_t kTilePlaces = formats::kTileNodes / 2;

// Kinds of what a node sees: the lowest part of SortKey::group.
constexpr uint32_t kSeen = kOpennesses * 2;

// A node's place among the others of its tile.
struct Place {
  uint32_t faces;  // lamp group and orientation
  uint64_t key;    // of its cell
  uint32_t among;  // those of its cell that face the same way: a patch's number, what a cluster sees
  uint32_t node;   // in the order of clustering
  friend auto operator<=>(const Place&, const Place&) = default;
};

// The children of one node, or a node of the coarsest level: what a tile takes whole.
struct Family {
  uint64_t cell;          // Hilbert key of the cell that they share
  uint32_t group;
  uint32_t first, nodes;  // in the order of clustering
  uint32_t places = 0;    // of the nodes of all families that share cell and faces, whatever they see: of the first of these
};

// Cuts families into tiles: see pyramid.h.
class TileCutter {
 public:
  // family_log: edge of a family's cell, in cells of the level, as a power of 2. place_of: of a node, by its number in the order of clustering.
  // most_places: of a tile.
  TileCutter(int family_log, uint32_t most_places, std::function<Place(uint32_t)> place_of, PagedVector<uint32_t>& order, std::vector<uint32_t>& tile_start)
      : family_log_(family_log), most_places_(most_places), place_of_(std::move(place_of)), order_(order), tile_start_(tile_start) {}

  // The families below one tile, in any order. Appends their nodes, and where tiles end.
  void cut(std::span<Family> families) {
    std::sort(families.begin(), families.end(), [](const Family& a, const Family& b) {
      return std::tie(a.cell, a.group, a.first) < std::tie(b.cell, b.group, b.first);
    });
    if (most_places_ < formats::kTileNodes) countPlaces(families);  // else they are no limit: a node is at one place
    int edge_log = family_log_;
    while (cube(families.front(), edge_log) != cube(families.back(), edge_log)) ++edge_log;
    cut(families, edge_log);
  }

 private:
  uint64_t cube(const Family& family, int edge_log) const { return hilbertAncestor(family.cell, edge_log - family_log_); }
  // Sets Family::places; families are sorted.
  void countPlaces(std::span<Family> families) {
    for (size_t k = 0; k < families.size();) {
      const auto placeOf = [&](size_t family) { return std::pair(families[family].cell, place_of_(families[family].first).faces); };
      keys_.clear();
      size_t end = k;
      for (; end < families.size() && placeOf(end) == placeOf(k); ++end)
        for (uint32_t i = 0; i < families[end].nodes; ++i) keys_.push_back(place_of_(families[end].first + i).key);
      std::sort(keys_.begin(), keys_.end());
      families[k].places = static_cast<uint32_t>(std::unique(keys_.begin(), keys_.end()) - keys_.begin());
      k = end;
    }
  }
  struct Size {
    uint32_t nodes = 0, places = 0;
    Size operator+(const Size& more) const { return {nodes + more.nodes, places + more.places}; }
  };
  static Size sizeOf(std::span<const Family> families) {
    Size size;
    for (const Family& f : families) size = size + Size{f.nodes, f.places};
    return size;
  }
  bool fits(const Size& size) const { return size.nodes <= formats::kTileNodes && size.places <= most_places_; }

  // Families of one cube, by cell.
  void cut(std::span<Family> families, int edge_log) {
    const bool wide = edge_log > kTileEdgeLog;
    if (!wide && fits(sizeOf(families))) return close(families);
    size_t open = 0;  // first family of the tile that is not closed yet
    Size size;
    for (size_t k = 0; k < families.size();) {
      size_t end = k + 1;  // a single cell is cut between families
      if (edge_log > family_log_)
        while (end < families.size() && cube(families[end], edge_log - 1) == cube(families[k], edge_log - 1)) ++end;
      const auto part = families.subspan(k, end - k);
      const Size more = sizeOf(part);
      const bool alone = wide || !fits(more);
      if (alone || !fits(size + more)) {
        close(families.subspan(open, k - open));
        open = k;
        size = {};
      }
      size = size + more;
      if (alone) {
        cut(part, edge_log - 1);
        open = end;
        size = {};
      }
      k = end;
    }
    close(families.subspan(open));
  }

  // All classes of the place are one tile.
  void close(std::span<const Family> families) {
    if (families.empty()) return;
    places_.clear();
    for (const Family& f : families)
      for (uint32_t i = 0; i < f.nodes; ++i) places_.push_back(place_of_(f.first + i));
    std::sort(places_.begin(), places_.end());
    for (const Place& place : places_) order_.push_back(place.node);
    tile_start_.push_back(static_cast<uint32_t>(order_.size()));
  }

  int family_log_;
  uint32_t most_places_;
  std::function<Place(uint32_t)> place_of_;
  std::vector<Place> places_;
  std::vector<uint64_t> keys_;
  PagedVector<uint32_t>& order_;
  std::vector<uint32_t>& tile_start_;
};

}  // namespace

uint32_t openness(double sky_fraction, uint32_t narrow) {
  if (sky_fraction >= 0.02) return sky_fraction < 0.3 ? 1 : 2;
  return narrow > 0 ? 2 + narrow : 0;
}

Hierarchy makeHierarchy(std::span<const Patch> patches, std::span<const float> sky_fraction,
                        std::span<const uint8_t> narrow, std::span<const float> lamp_light) {
  const auto n = static_cast<uint32_t>(patches.size());
  const PagedVector<uint8_t> brightness = brightnessOf(patches, lamp_light);
  PagedVector<uint32_t> group(n);
  for (uint32_t i = 0; i < n; ++i) {
    const uint32_t open = openness(static_cast<double>(sky_fraction[i]), narrow.empty() ? 0 : narrow[i]);
    const uint32_t lamp = patches[i].emits() ? 1u + patches[i].lamp_group : 0u;
    const uint32_t lit = !lamp_light.empty() && lamp_light[i] > 0;
    group[i] = (lamp * kOrientations + patches[i].orientation) * kSeen + open * 2 + lit;
  }
  int top = 0;
  size_t count = n;
  while (count > kTopNodes && top + 1 < static_cast<int>(formats::kMaxLevels)) count = countClusters(patches, group, brightness, ++top);

  PagedVector<SortKey> order(n);
  for (uint32_t i = 0; i < n; ++i) order[i] = {hilbertAncestor(patches[i].key, top), group[i], i, patches[i].key, brightness[i]};
  tbb::parallel_sort(order.begin(), order.end());
  // Clusters, in the order of clustering: a node's children are consecutive, as are a cluster's patches.
  struct Level {
    PagedVector<uint32_t> first;   // patch of each node
    PagedVector<uint32_t> parent;  // of each node
    PagedVector<uint32_t> child;   // first one of each node, then the number of nodes below
  };
  std::vector<Level> levels(static_cast<size_t>(top) + 1);
  levels[0].first.resize(n);
  std::iota(levels[0].first.begin(), levels[0].first.end(), 0u);
  for (int level = 1; level <= top; ++level) {
    Level &below = levels[static_cast<size_t>(level) - 1], &own = levels[static_cast<size_t>(level)];
    const PagedVector<uint32_t>& first = below.first;
    below.parent.resize(first.size());
    uint32_t siblings = 0;
    for (size_t k = 0; k < first.size(); ++k) {
      const SortKey &a = order[first[k]], &b = order[first[k > 0 ? k - 1 : 0]];
      const bool same = k > 0 && siblings < kMaxSiblings && a.group == b.group && brightnessAt(level, a.brightness) == brightnessAt(level, b.brightness) &&
                        hilbertAncestor(a.key, level) == hilbertAncestor(b.key, level);
      if (!same) {
        own.first.push_back(first[k]);
        own.child.push_back(static_cast<uint32_t>(k));
        siblings = 0;
      }
      ++siblings;
      below.parent[k] = static_cast<uint32_t>(own.first.size()) - 1;
    }
    own.child.push_back(static_cast<uint32_t>(first.size()));
  }

  const bool lamps = std::ranges::any_of(lamp_light, [](float light) { return light > 0; });
  // Tiles, from the coarsest level down: the children of a tile's nodes are tiles of their own.
  Hierarchy h;
  h.nodes.resize(levels.size());
  h.tile_start.resize(levels.size());
  h.names.resize(levels.size());
  h.parents.resize(levels.size() - 1);
  h.tile_parents.resize(levels.size() - 1);
  PagedVector<uint32_t> above, now;  // of each node in the final order: its number in the order of clustering
  std::vector<Family> families;
  for (int level = top; level >= 0; --level) {
    const auto l = static_cast<size_t>(level);
    const Level& own = levels[l];
    now.clear();
    h.nodes[l] = static_cast<uint32_t>(own.first.size());
    h.tile_start[l].assign(1, 0);
    const int family_log = level == top ? 0 : 1;
    const auto placeOf = [&](uint32_t node) {
      const SortKey& key = order[own.first[node]];
      return Place{key.group / kSeen, hilbertAncestor(key.key, level), level == 0 ? key.patch : key.group % kSeen << 8 | brightnessAt(level, key.brightness), node};
    };
    TileCutter cutter(family_log, lamps && level > 0 && level <= kBrightLevels ? kTilePlaces : formats::kTileNodes, placeOf, now, h.tile_start[l]);
    const auto familyOf = [&](uint32_t first, uint32_t nodes) {
      const SortKey& key = order[own.first[first]];
      return Family{hilbertAncestor(key.key, level + family_log), key.group, first, nodes};
    };
    if (level == top) {
      families.clear();
      for (uint32_t k = 0; k < h.nodes[l]; ++k) families.push_back(familyOf(k, 1));
      cutter.cut(families);
    } else {
      const PagedVector<uint32_t>& child = levels[l + 1].child;
      for (uint32_t t = 0; t + 1 < h.tile_start[l + 1].size(); ++t) {
        families.clear();
        for (uint32_t k = h.tile_start[l + 1][t]; k < h.tile_start[l + 1][t + 1]; ++k)
          families.push_back(familyOf(child[above[k]], child[above[k] + 1] - child[above[k]]));
        cutter.cut(families);
        h.tile_parents[l].resize(h.tile_start[l].size() - 1, t);
      }
      PagedVector<uint32_t> number(above.size());  // of each node above, in the final order
      for (uint32_t k = 0; k < above.size(); ++k) number[above[k]] = k;
      for (const uint32_t k : now) h.parents[l].push_back(number[own.parent[k]]);
    }
    std::map<formats::ChunkCell, uint32_t> numbers;  // of tiles so far
    for (uint32_t t = 0; t + 1 < h.tile_start[l].size(); ++t) {
      formats::TileName name;
      name.chunk = chunkOf(patches[order[own.first[now[h.tile_start[l][t]]]].patch], level);
      name.tile = numbers[name.chunk]++;
      h.names[l].push_back(name);
    }
    above.swap(now);
  }
  h.number.resize(n);
  for (uint32_t k = 0; k < n; ++k) h.number[order[above[k]].patch] = k;
  return h;
}

namespace {

void addLamps(const std::vector<LampIrradiance>& more, std::vector<LampIrradiance>& sum) {
  for (const LampIrradiance& lamp : more) {
    LampIrradiance& light = entryOf(sum, lamp.group);
    for (size_t c = 0; c < 3; ++c) light.rgb[c] += lamp.rgb[c];
  }
}

// A row in the making; of all nodes of the level, all zero between rows.
struct RowSums {
  explicit RowSums(uint32_t nodes) : exchange(nodes), seen(nodes) {}
  std::vector<NodeRow> children;  // of a tile
  PagedVector<double> exchange;
  PagedVector<uint8_t> seen;
  std::vector<uint32_t> touched, scratch;
};

// The node over `children`, in their order, of which there is at least one; parents: of the level below.
NodeRow gathered(std::span<const NodeRow* const> children, std::span<const uint32_t> parents, RowSums& s) {
  NodeRow node;
  double area = 0, absorbed = 0, sums[12] = {};
  SkySums sky;
  for (const NodeRow* child : children) {
    const formats::Node& c = child->node;
    const ExchangeRow& row = child->row;
    for (size_t k = 0; k < row.column.size(); ++k) {
      const uint32_t j = parents[row.column[k]];
      if (!s.seen[j]) {
        s.seen[j] = 1;
        s.touched.push_back(j);
      }
      s.exchange[j] += row.area_m2[k];
    }
    area += static_cast<double>(c.area_m2);
    sky.add(row.sky_means, row.sky_m2);
    absorbed += row.absorbed_m2;
    addLamps(row.lamps, node.row.lamps);
    const Vec3 fields[4] = {c.centroid, c.normal, c.albedo, c.emission};
    for (int f = 0; f < 4; ++f)
      for (int a = 0; a < 3; ++a) sums[3 * f + a] += static_cast<double>(c.area_m2) * static_cast<double>(fields[f][a]);
    node.bounds.add(child->bounds);
  }
  sortByKey(s.touched, s.scratch, std::identity());
  node.row.column.reserve(s.touched.size());
  node.row.area_m2.reserve(s.touched.size());
  for (const uint32_t j : s.touched) {
    node.row.column.push_back(j);
    node.row.area_m2.push_back(static_cast<double>(static_cast<float>(s.exchange[j])));  // as it is kept
    s.exchange[j] = 0;
    s.seen[j] = 0;
  }
  s.touched.clear();
  node.row.sky_m2 = sky.weight();
  node.row.sky_means = sky.means();
  node.row.absorbed_m2 = absorbed;
  const auto mean = [&](int f) {
    return Vec3{static_cast<float>(sums[3 * f] / area), static_cast<float>(sums[3 * f + 1] / area), static_cast<float>(sums[3 * f + 2] / area)};
  };
  node.node.area_m2 = static_cast<float>(area);
  node.node.centroid = mean(0);
  node.node.normal = normalized(mean(1));
  node.node.albedo = mean(2);
  node.node.emission = mean(3);
  node.node.lamp_group = children[0]->node.lamp_group;
  return node;
}

}  // namespace

PagedVector<LightValues> gatherClusters(const LevelRows& below, std::span<const LightValues> light, const Hierarchy& h, uint32_t level, LevelRows& own,
                                        WorkCount& done) {
  const PagedVector<uint32_t>& parents = h.parents[level - 1];
  const std::vector<uint32_t>&tiles = h.tile_start[level], &child_tiles = h.tile_start[level - 1];
  const std::vector<uint32_t>& tile_parents = h.tile_parents[level - 1];
  PagedVector<LightValues> own_light(h.nodes[level]);
  tbb::enumerable_thread_specific<RowSums> scratch([&] { return RowSums(h.nodes[level]); });
  tbb::parallel_for(0u, static_cast<uint32_t>(tiles.size()) - 1, [&](uint32_t t) {
    RowSums& sums = scratch.local();
    std::vector<NodeRow> rows(tiles[t + 1] - tiles[t]);
    const auto [first, last] = std::equal_range(tile_parents.begin(), tile_parents.end(), t);
    for (auto child_tile = static_cast<uint32_t>(first - tile_parents.begin()); child_tile < static_cast<uint32_t>(last - tile_parents.begin()); ++child_tile) {
      const uint32_t first_child = child_tiles[child_tile];
      std::vector<NodeRow>& children = sums.children;
      below.get(child_tile, children);
      std::vector<std::pair<uint32_t, uint32_t>> by_parent;  // parent, child; siblings lie in one tile
      for (uint32_t i = 0; i < children.size(); ++i) by_parent.emplace_back(parents[first_child + i], i);
      std::sort(by_parent.begin(), by_parent.end());
      std::vector<const NodeRow*> siblings;
      for (size_t k = 0; k < by_parent.size();) {
        const uint32_t parent = by_parent[k].first;
        siblings.clear();
        float area = 0;
        size_t end = k;
        for (; end < by_parent.size() && by_parent[end].first == parent; ++end) {
          siblings.push_back(&children[by_parent[end].second]);
          area += siblings.back()->node.area_m2;
        }
        NodeRow& row = rows[parent - tiles[t]] = gathered(siblings, parents, sums);
        for (; k < end; ++k) {
          const NodeRow& child = children[by_parent[k].second];
          const float share = child.node.area_m2 / area;
          for (size_t l = 0; l < kLights; ++l) {
            row.direct[l] += share * child.direct[l];
            own_light[parent][l] += share * light[first_child + by_parent[k].second][l];
          }
        }
      }
    }
    own.put(t, rows);
    done.add();
  });
  return own_light;
}

}  // namespace ff::bake
