#include <algorithm>
#include <numeric>
#include <unordered_map>

#include "tools/view_scene.h"

namespace ff::view {
namespace {

constexpr float kSameWay = 0.5f;    // cosine: within 60 degrees
constexpr float kTentCells = 1.5f;

struct CellHash {
  size_t operator()(const std::array<int32_t, 3>& c) const {
    return static_cast<size_t>(static_cast<uint32_t>(c[0])) * 73856093u ^
           static_cast<size_t>(static_cast<uint32_t>(c[1])) * 19349663u ^
           static_cast<size_t>(static_cast<uint32_t>(c[2])) * 83492791u;
  }
};

// Numbers places so that corners closer than `tolerance` to a place's first corner share it. Stored positions are
// quantised per tile, so one point of the world may be read with slightly different coordinates from two tiles.
std::vector<uint32_t> weldPlaces(const std::vector<Vec3>& corners, float tolerance, std::vector<Vec3>* places) {
  std::unordered_map<std::array<int32_t, 3>, std::vector<uint32_t>, CellHash> grid;
  const float cell = 4 * tolerance;
  std::vector<uint32_t> place_of(corners.size());
  for (size_t i = 0; i < corners.size(); ++i) {
    const Vec3 p = corners[i];
    std::array<int32_t, 3> lo{}, hi{}, own{};
    for (int a = 0; a < 3; ++a) {
      const auto at = static_cast<size_t>(a);
      lo[at] = static_cast<int32_t>(std::floor((p[a] - tolerance) / cell));
      hi[at] = static_cast<int32_t>(std::floor((p[a] + tolerance) / cell));
      own[at] = static_cast<int32_t>(std::floor(p[a] / cell));
    }
    uint32_t found = 0xffffffffu;
    float nearest = tolerance;
    for (int32_t x = lo[0]; x <= hi[0]; ++x)
      for (int32_t y = lo[1]; y <= hi[1]; ++y)
        for (int32_t z = lo[2]; z <= hi[2]; ++z) {
          const auto it = grid.find({x, y, z});
          if (it == grid.end()) continue;
          for (const uint32_t place : it->second) {
            const float d = length((*places)[place] - p);
            if (d > nearest) continue;
            nearest = d;
            found = place;
          }
        }
    if (found == 0xffffffffu) {
      found = static_cast<uint32_t>(places->size());
      places->push_back(p);
      grid[own].push_back(found);
    }
    place_of[i] = found;
  }
  return place_of;
}

// Compressed lists of sorted, unique numbers.
struct Lists {
  std::vector<uint32_t> start{0}, items;
  std::span<const uint32_t> of(uint32_t i) const { return {items.data() + start[i], items.data() + start[i + 1]}; }
};

Lists makeLists(std::vector<std::pair<uint32_t, uint32_t>> pairs, size_t count) {
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  Lists lists;
  lists.start.assign(count + 1, 0);
  lists.items.reserve(pairs.size());
  for (const auto& [owner, item] : pairs) {
    ++lists.start[owner + 1];
    lists.items.push_back(item);
  }
  std::partial_sum(lists.start.begin(), lists.start.end(), lists.start.begin());
  return lists;
}

VertexPatches lightOf(const ViewScene& scene, const Lists& touching, const Lists& neighbours, uint32_t vertex, Vec3 at,
                      Vec3 normal) {
  std::vector<std::pair<float, uint32_t>> weights;  // found by a linear search: a few dozen at most
  const auto add = [&](uint32_t patch, bool touches) {
    for (const auto& [w, p] : weights)
      if (p == patch) return;
    const formats::Node& n = scene.patches[patch];
    if (!touches && dot(n.normal, normal) <= kSameWay) return;
    const float tent = 1 - length(at - n.centroid) / (kTentCells * scene.cell_m);
    if (tent > 0) weights.emplace_back(tent * n.area_m2, patch);
  };
  for (const uint32_t patch : touching.of(vertex)) add(patch, true);
  for (const uint32_t patch : touching.of(vertex))
    for (const uint32_t other : neighbours.of(patch)) add(other, false);
  if (weights.empty())  // a patch whose centroid is far from its rim
    for (const uint32_t patch : touching.of(vertex)) weights.emplace_back(scene.patches[patch].area_m2, patch);
  std::sort(weights.begin(), weights.end(), [](const auto& a, const auto& b) {
    return a.first != b.first ? a.first > b.first : a.second < b.second;
  });
  VertexPatches v;
  const size_t n = std::min(weights.size(), v.patch.size());
  float sum = 0;
  for (size_t i = 0; i < n; ++i) sum += weights[i].first;
  for (size_t i = 0; i < n; ++i) {
    v.patch[i] = weights[i].second;
    v.weight[i] = sum > 0 ? weights[i].first / sum : 1.0f / static_cast<float>(n);
  }
  return v;
}

}  // namespace

Weld weldScene(const ViewScene& scene) {
  // 16-bit positions over a tile err by bounds / 131070 in each axis, and a tile may be as large as the world.
  const float extent = std::max({scene.bounds.hi.x - scene.bounds.lo.x, scene.bounds.hi.y - scene.bounds.lo.y,
                                 scene.bounds.hi.z - scene.bounds.lo.z});
  const float tolerance = std::clamp(extent * 2e-5f, 1e-3f * scene.cell_m, 1e-2f * scene.cell_m);
  std::vector<Vec3> places;
  const std::vector<uint32_t> place_of = weldPlaces(scene.corners, tolerance, &places);

  // Split each place into classes of faces that point the same way; the first face of a class stands for it.
  Weld weld;
  weld.corner_vertex.resize(scene.corners.size());
  std::vector<std::vector<uint32_t>> vertices_at(places.size());
  std::vector<Vec3> class_normal, area_normal;
  for (size_t t = 0; t < scene.triangles(); ++t) {
    const Vec3 doubled =  // of the welded corners: two corners may have become one
        cross(places[place_of[3 * t + 1]] - places[place_of[3 * t]], places[place_of[3 * t + 2]] - places[place_of[3 * t]]);
    Vec3 n = normalized(doubled);
    if (n == Vec3{}) n = scene.patches[scene.triangle_patch[t]].normal;
    for (size_t c = 3 * t; c < 3 * t + 3; ++c) {
      auto& here = vertices_at[place_of[c]];
      auto it = std::find_if(here.begin(), here.end(), [&](uint32_t v) { return dot(class_normal[v], n) > kSameWay; });
      if (it == here.end()) {
        here.push_back(static_cast<uint32_t>(weld.position.size()));
        it = here.end() - 1;
        weld.position.push_back(places[place_of[c]]);
        class_normal.push_back(n);
        area_normal.push_back({});
      }
      weld.corner_vertex[c] = *it;
      area_normal[*it] += doubled;
    }
  }
  const size_t vertices = weld.position.size();
  weld.normal.resize(vertices);
  for (size_t v = 0; v < vertices; ++v) {
    weld.normal[v] = normalized(area_normal[v]);
    if (weld.normal[v] == Vec3{}) weld.normal[v] = class_normal[v];
  }

  std::vector<std::pair<uint32_t, uint32_t>> pairs;
  pairs.reserve(scene.corners.size());
  for (size_t c = 0; c < scene.corners.size(); ++c)
    pairs.emplace_back(weld.corner_vertex[c], scene.triangle_patch[c / 3]);
  const Lists touching = makeLists(std::move(pairs), vertices);
  pairs = {};
  for (uint32_t v = 0; v < vertices; ++v)
    for (const uint32_t a : touching.of(v))
      for (const uint32_t b : touching.of(v))
        if (a != b) pairs.emplace_back(a, b);
  const Lists neighbours = makeLists(std::move(pairs), scene.patches.size());
  weld.light_from.resize(vertices);
  for (uint32_t v = 0; v < vertices; ++v)
    weld.light_from[v] = lightOf(scene, touching, neighbours, v, weld.position[v], weld.normal[v]);
  return weld;
}

}  // namespace ff::view
