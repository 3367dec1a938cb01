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

namespace ff::bake {
namespace {

constexpr size_t kChunk = 64;  // cluster rows gathered by one task

struct SortKey {
  uint64_t top;     // cell of the coarsest level
  uint32_t group;   // lamp group, orientation, openness, whether lamps light it
  uint64_t key;     // cell of the patch
  uint32_t patch;
  friend bool operator<(const SortKey& a, const SortKey& b) {
    return std::tie(a.top, a.group, a.key, a.patch) < std::tie(b.top, b.group, b.key, b.patch);
  }
};

size_t countClusters(std::span<const Patch> patches, std::span<const uint32_t> group, int level) {
  std::vector<std::pair<uint64_t, uint32_t>> clusters(patches.size());
  for (size_t i = 0; i < patches.size(); ++i) clusters[i] = {hilbertAncestor(patches[i].key, level), group[i]};
  tbb::parallel_sort(clusters.begin(), clusters.end());
  return static_cast<size_t>(std::unique(clusters.begin(), clusters.end()) - clusters.begin());
}

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
};

// Cuts families into tiles: see pyramid.h.
class TileCutter {
 public:
  // family_log: edge of a family's cell, in cells of the level, as a power of 2. place_of: of a node, by its number in the order of clustering.
  TileCutter(int family_log, std::function<Place(uint32_t)> place_of, std::vector<uint32_t>& order, std::vector<uint32_t>& tile_start)
      : family_log_(family_log), place_of_(std::move(place_of)), order_(order), tile_start_(tile_start) {}

  // The families below one tile, in any order. Appends their nodes, and where tiles end.
  void cut(std::span<Family> families) {
    std::sort(families.begin(), families.end(), [](const Family& a, const Family& b) {
      return std::tie(a.cell, a.group, a.first) < std::tie(b.cell, b.group, b.first);
    });
    int edge_log = family_log_;
    while (cube(families.front(), edge_log) != cube(families.back(), edge_log)) ++edge_log;
    cut(families, edge_log);
  }

 private:
  uint64_t cube(const Family& family, int edge_log) const { return hilbertAncestor(family.cell, edge_log - family_log_); }
  static uint32_t nodesOf(std::span<const Family> families) {
    uint32_t nodes = 0;
    for (const Family& f : families) nodes += f.nodes;
    return nodes;
  }

  // Families of one cube, by cell.
  void cut(std::span<Family> families, int edge_log) {
    const bool wide = edge_log > kTileEdgeLog;
    if (!wide && nodesOf(families) <= formats::kTileNodes) return close(families);
    size_t open = 0;  // first family of the tile that is not closed yet
    uint32_t nodes = 0;
    for (size_t k = 0; k < families.size();) {
      size_t end = k + 1;  // a single cell is cut between families
      if (edge_log > family_log_)
        while (end < families.size() && cube(families[end], edge_log - 1) == cube(families[k], edge_log - 1)) ++end;
      const auto part = families.subspan(k, end - k);
      const uint32_t more = nodesOf(part);
      const bool alone = wide || more > formats::kTileNodes;
      if (alone || nodes + more > formats::kTileNodes) {
        close(families.subspan(open, k - open));
        open = k;
        nodes = 0;
      }
      nodes += more;
      if (alone) {
        cut(part, edge_log - 1);
        open = end;
        nodes = 0;
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
  std::function<Place(uint32_t)> place_of_;
  std::vector<Place> places_;
  std::vector<uint32_t>& order_;
  std::vector<uint32_t>& tile_start_;
};

}  // namespace

uint32_t openness(double sky_fraction, uint32_t narrow) {
  if (sky_fraction >= 0.02) return sky_fraction < 0.3 ? 1 : 2;
  return narrow > 0 ? 2 + narrow : 0;
}

Hierarchy makeHierarchy(std::span<const Patch> patches, std::span<const float> sky_fraction,
                        std::span<const uint8_t> narrow, std::span<const uint8_t> lamp_lit) {
  const auto n = static_cast<uint32_t>(patches.size());
  std::vector<uint32_t> group(n);
  for (uint32_t i = 0; i < n; ++i) {
    const uint32_t open = openness(static_cast<double>(sky_fraction[i]), narrow.empty() ? 0 : narrow[i]);
    const uint32_t lamp = patches[i].emits() ? 1u + patches[i].lamp_group : 0u;
    const uint32_t lit = lamp_lit.empty() ? 0u : lamp_lit[i];
    group[i] = (lamp * kOrientations + patches[i].orientation) * kSeen + open * 2 + lit;
  }
  int top = 0;
  size_t count = n;
  while (count > kTopNodes && top + 1 < static_cast<int>(formats::kMaxLevels)) count = countClusters(patches, group, ++top);

  std::vector<SortKey> order(n);
  for (uint32_t i = 0; i < n; ++i) order[i] = {hilbertAncestor(patches[i].key, top), group[i], patches[i].key, i};
  tbb::parallel_sort(order.begin(), order.end());
  // Clusters, in the order of clustering: a node's children are consecutive, as are a cluster's patches.
  struct Level {
    std::vector<uint32_t> first;   // patch of each node
    std::vector<uint32_t> parent;  // of each node
    std::vector<uint32_t> child;   // first one of each node, then the number of nodes below
  };
  std::vector<Level> levels(static_cast<size_t>(top) + 1);
  levels[0].first.resize(n);
  std::iota(levels[0].first.begin(), levels[0].first.end(), 0u);
  for (int level = 1; level <= top; ++level) {
    Level &below = levels[static_cast<size_t>(level) - 1], &own = levels[static_cast<size_t>(level)];
    const std::vector<uint32_t>& first = below.first;
    below.parent.resize(first.size());
    uint32_t siblings = 0;
    for (size_t k = 0; k < first.size(); ++k) {
      const SortKey& a = order[first[k]];
      const bool same = k > 0 && siblings < kMaxSiblings && a.group == order[first[k - 1]].group &&
                        hilbertAncestor(a.key, level) == hilbertAncestor(order[first[k - 1]].key, level);
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

  // Tiles, from the coarsest level down: the children of a tile's nodes are tiles of their own.
  Hierarchy h;
  h.nodes.resize(levels.size());
  h.tile_start.resize(levels.size());
  h.names.resize(levels.size());
  h.parents.resize(levels.size() - 1);
  h.tile_parents.resize(levels.size() - 1);
  std::vector<uint32_t> above, now;  // of each node in the final order: its number in the order of clustering
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
      return Place{key.group / kSeen, hilbertAncestor(key.key, level), level == 0 ? key.patch : key.group % kSeen, node};
    };
    TileCutter cutter(family_log, placeOf, now, h.tile_start[l]);
    const auto familyOf = [&](uint32_t first, uint32_t nodes) {
      const SortKey& key = order[own.first[first]];
      return Family{hilbertAncestor(key.key, level + family_log), key.group, first, nodes};
    };
    if (level == top) {
      families.clear();
      for (uint32_t k = 0; k < h.nodes[l]; ++k) families.push_back(familyOf(k, 1));
      cutter.cut(families);
    } else {
      const std::vector<uint32_t>& child = levels[l + 1].child;
      for (uint32_t t = 0; t + 1 < h.tile_start[l + 1].size(); ++t) {
        families.clear();
        for (uint32_t k = h.tile_start[l + 1][t]; k < h.tile_start[l + 1][t + 1]; ++k)
          families.push_back(familyOf(child[above[k]], child[above[k] + 1] - child[above[k]]));
        cutter.cut(families);
        h.tile_parents[l].resize(h.tile_start[l].size() - 1, t);
      }
      std::vector<uint32_t> number(above.size());  // of each node above, in the final order
      for (uint32_t k = 0; k < above.size(); ++k) number[above[k]] = k;
      for (const uint32_t k : now) h.parents[l].push_back(number[own.parent[k]]);
    }
    std::map<formats::ChunkCell, uint32_t> numbers;  // of tiles so far
    for (uint32_t t = 0; t + 1 < h.tile_start[l].size(); ++t) {
      formats::TileName name;
      for (size_t a = 0; a < 3; ++a) name.chunk[a] = patches[order[own.first[now[h.tile_start[l][t]]]].patch].cell[a] >> (level + formats::kChunkLog);
      name.tile = numbers[name.chunk]++;
      h.names[l].push_back(name);
    }
    above.swap(now);
  }
  h.number.resize(n);
  for (uint32_t k = 0; k < n; ++k) h.number[order[above[k]].patch] = k;
  return h;
}

std::vector<NodeValues> patchValues(std::span<const Patch> patches, const Hierarchy& hierarchy) {
  std::vector<NodeValues> values(patches.size());
  for (size_t p = 0; p < patches.size(); ++p) {
    NodeValues& v = values[hierarchy.number[p]];
    v.node.area_m2 = patches[p].area_m2;
    v.node.centroid = patches[p].centroid;
    v.node.normal = patches[p].normal;
    v.node.albedo = patches[p].albedo;
    v.node.emission = patches[p].emission;
    v.node.lamp_group = patches[p].lamp_group;
    v.bounds = patches[p].bounds;
  }
  if (hierarchy.levels() > 1)
    for (size_t i = 0; i < values.size(); ++i) values[i].node.parent = hierarchy.parents[0][i];
  return values;
}

Children::Children(std::span<const uint32_t> parents, uint32_t nodes) : start_(nodes + 1, 0), child_(parents.size()) {
  for (const uint32_t p : parents) ++start_[p + 1];
  std::partial_sum(start_.begin(), start_.end(), start_.begin());
  std::vector<uint32_t> next(start_.begin(), start_.end() - 1);
  for (uint32_t i = 0; i < parents.size(); ++i) child_[next[parents[i]]++] = i;
}

std::vector<NodeValues> clusterValues(std::span<const NodeValues> below, const Hierarchy& hierarchy, uint32_t level) {
  std::vector<NodeValues> values(hierarchy.nodes[level]);
  const Children children(hierarchy.parents[level - 1], hierarchy.nodes[level]);
  for (uint32_t n = 0; n < values.size(); ++n) {
    double area = 0, sums[12] = {};
    NodeValues& v = values[n];
    for (const uint32_t child : children.of(n)) {
      const formats::Node& c = below[child].node;
      const Vec3 fields[4] = {c.centroid, c.normal, c.albedo, c.emission};
      area += static_cast<double>(c.area_m2);
      for (int f = 0; f < 4; ++f)
        for (int a = 0; a < 3; ++a) sums[3 * f + a] += static_cast<double>(c.area_m2) * static_cast<double>(fields[f][a]);
      v.bounds.add(below[child].bounds);
    }
    const auto mean = [&](int f) {
      return Vec3{static_cast<float>(sums[3 * f] / area), static_cast<float>(sums[3 * f + 1] / area),
                  static_cast<float>(sums[3 * f + 2] / area)};
    };
    v.node.area_m2 = static_cast<float>(area);
    v.node.centroid = mean(0);
    v.node.normal = normalized(mean(1));
    v.node.albedo = mean(2);
    v.node.emission = mean(3);
    v.node.lamp_group = below[children.of(n)[0]].node.lamp_group;
    if (level + 1 < hierarchy.levels()) v.node.parent = hierarchy.parents[level][n];
  }
  return values;
}

namespace {

void addLamps(const std::vector<LampIrradiance>& more, std::vector<LampIrradiance>& sum) {
  for (const LampIrradiance& lamp : more) {
    LampIrradiance& light = entryOf(sum, lamp.group);
    for (size_t c = 0; c < 3; ++c) light.rgb[c] += lamp.rgb[c];
  }
}

}  // namespace

ClusterExchange::ClusterExchange(const ExchangeLevel& below, std::span<const uint32_t> parents, uint32_t nodes)
    : areas_(nodes), start_(nodes + 1, 0), sky_m2_(nodes), absorbed_m2_(nodes), sky_means_(nodes), lamps_(nodes) {
  const Children children(parents, nodes);
  struct Scratch {
    std::vector<double> exchange;  // per node, zero between rows
    std::vector<uint8_t> seen;
    std::vector<uint32_t> touched;
    ExchangeRow row;
  };
  tbb::enumerable_thread_specific<Scratch> scratch(
      [&] { return Scratch{std::vector<double>(nodes), std::vector<uint8_t>(nodes), {}, {}}; });
  const size_t chunks = (nodes + kChunk - 1) / kChunk;
  std::vector<std::vector<std::pair<uint32_t, float>>> parts(chunks);
  tbb::parallel_for(size_t{0}, chunks, [&](size_t c) {
    Scratch& s = scratch.local();
    for (auto n = static_cast<uint32_t>(c * kChunk); n < std::min<size_t>(nodes, (c + 1) * kChunk); ++n) {
      double area = 0, absorbed = 0;
      SkySums sky;
      for (const uint32_t i : children.of(n)) {
        below.row(i, s.row);
        for (size_t k = 0; k < s.row.column.size(); ++k) {
          const uint32_t j = parents[s.row.column[k]];
          if (!s.seen[j]) {
            s.seen[j] = 1;
            s.touched.push_back(j);
          }
          s.exchange[j] += s.row.area_m2[k];
        }
        area += static_cast<double>(below.area(i));
        sky.add(s.row.sky_means, s.row.sky_m2);
        absorbed += s.row.absorbed_m2;
        addLamps(s.row.lamps, lamps_[n]);
      }
      std::sort(s.touched.begin(), s.touched.end());
      for (uint32_t j : s.touched) {
        parts[c].emplace_back(j, static_cast<float>(s.exchange[j]));
        s.exchange[j] = 0;
        s.seen[j] = 0;
      }
      start_[n + 1] = s.touched.size();
      s.touched.clear();
      areas_[n] = static_cast<float>(area);
      sky_m2_[n] = sky.weight();
      sky_means_[n] = sky.means();
      absorbed_m2_[n] = absorbed;
    }
  });
  for (size_t n = 0; n < nodes; ++n) start_[n + 1] += start_[n];
  column_.reserve(start_[nodes]);
  exchange_m2_.reserve(start_[nodes]);
  for (auto& part : parts) {
    for (const auto& [j, x] : part) {
      column_.push_back(j);
      exchange_m2_.push_back(x);
    }
    part = {};
  }
}

void ClusterExchange::row(uint32_t node, ExchangeRow& out) const {
  const auto a = static_cast<ptrdiff_t>(start_[node]), b = static_cast<ptrdiff_t>(start_[node + 1]);
  out.column.assign(column_.begin() + a, column_.begin() + b);
  out.area_m2.assign(exchange_m2_.begin() + a, exchange_m2_.begin() + b);
  out.sky_m2 = sky_m2_[node];
  out.absorbed_m2 = absorbed_m2_[node];
  out.sky_means = sky_means_[node];
  out.lamps = lamps_[node];
}

}  // namespace ff::bake
