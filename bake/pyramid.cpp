#include "bake/pyramid.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

namespace ff::bake {
namespace {

constexpr size_t kChunk = 64;  // cluster rows gathered by one task

struct SortKey {
  uint64_t top;     // cell of the coarsest level
  uint32_t group;   // lamp group, orientation and openness
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

// Tiles of at most kTileNodes; a new one starts where the next siblings would not fit.
std::vector<uint32_t> cutTiles(uint32_t nodes, std::span<const uint32_t> parents) {
  std::vector<uint32_t> start{0};
  uint32_t i = 0;
  while (i < nodes) {
    uint32_t next = i + 1;
    if (!parents.empty())
      while (next < nodes && parents[next] == parents[i]) ++next;
    if (next - start.back() > formats::kTileNodes) start.push_back(i);
    i = next;
  }
  start.push_back(nodes);
  return start;
}

}  // namespace

uint32_t openness(double sky_fraction, uint32_t narrow) {
  if (sky_fraction >= 0.02) return sky_fraction < 0.3 ? 1 : 2;
  return narrow > 0 ? 2 + narrow : 0;
}

Hierarchy makeHierarchy(std::span<const Patch> patches, std::span<const float> sky_fraction,
                        std::span<const uint8_t> narrow) {
  const auto n = static_cast<uint32_t>(patches.size());
  std::vector<uint32_t> group(n);
  for (uint32_t i = 0; i < n; ++i) {
    const uint32_t open = openness(static_cast<double>(sky_fraction[i]), narrow.empty() ? 0 : narrow[i]);
    const uint32_t lamp = patches[i].emits() ? 1u + patches[i].lamp_group : 0u;
    group[i] = (lamp * kOrientations + patches[i].orientation) * kOpennesses + open;
  }
  int top = 0;
  size_t count = n;
  while (count > kTopNodes && top + 1 < static_cast<int>(formats::kMaxLevels)) count = countClusters(patches, group, ++top);

  std::vector<SortKey> order(n);
  for (uint32_t i = 0; i < n; ++i) order[i] = {hilbertAncestor(patches[i].key, top), group[i], patches[i].key, i};
  tbb::parallel_sort(order.begin(), order.end());
  Hierarchy h;
  h.number.resize(n);
  for (uint32_t i = 0; i < n; ++i) h.number[order[i].patch] = i;

  std::vector<uint32_t> first(n);  // first patch of each node of the level
  std::iota(first.begin(), first.end(), 0u);
  h.nodes.push_back(n);
  for (int level = 1; level <= top; ++level) {
    std::vector<uint32_t> parents(first.size()), next;
    uint32_t siblings = 0;
    for (size_t k = 0; k < first.size(); ++k) {
      const SortKey& a = order[first[k]];
      const bool same = k > 0 && siblings < kMaxSiblings && a.group == order[first[k - 1]].group &&
                        hilbertAncestor(a.key, level) == hilbertAncestor(order[first[k - 1]].key, level);
      if (!same) {
        next.push_back(first[k]);
        siblings = 0;
      }
      ++siblings;
      parents[k] = static_cast<uint32_t>(next.size()) - 1;
    }
    h.parents.push_back(std::move(parents));
    h.nodes.push_back(static_cast<uint32_t>(next.size()));
    first = std::move(next);
  }
  for (uint32_t l = 0; l < h.levels(); ++l)
    h.tile_start.push_back(cutTiles(h.nodes[l], l + 1 < h.levels() ? std::span<const uint32_t>(h.parents[l])
                                                                   : std::span<const uint32_t>()));
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

std::vector<NodeValues> clusterValues(std::span<const NodeValues> children, const Hierarchy& hierarchy, uint32_t level) {
  std::vector<NodeValues> values(hierarchy.nodes[level]);
  const auto& parents = hierarchy.parents[level - 1];
  for (size_t first = 0; first < children.size();) {
    size_t last = first;
    double area = 0, sums[12] = {};
    NodeValues& v = values[parents[first]];
    for (; last < children.size() && parents[last] == parents[first]; ++last) {
      const formats::Node& c = children[last].node;
      const Vec3 fields[4] = {c.centroid, c.normal, c.albedo, c.emission};
      area += static_cast<double>(c.area_m2);
      for (int f = 0; f < 4; ++f)
        for (int a = 0; a < 3; ++a) sums[3 * f + a] += static_cast<double>(c.area_m2) * static_cast<double>(fields[f][a]);
      v.bounds.add(children[last].bounds);
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
    v.node.lamp_group = children[first].node.lamp_group;
    if (level + 1 < hierarchy.levels()) v.node.parent = hierarchy.parents[level][parents[first]];
    first = last;
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
  std::vector<uint32_t> first(nodes + 1, static_cast<uint32_t>(parents.size()));  // first child
  for (size_t i = parents.size(); i-- > 0;) first[parents[i]] = static_cast<uint32_t>(i);
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
      for (uint32_t i = first[n]; i < first[n + 1]; ++i) {
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
