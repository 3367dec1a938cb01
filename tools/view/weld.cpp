#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "tools/view/scene.h"
#include "tools/view/walls.h"

namespace ff::view {
namespace {

constexpr float kSameWay = 0.5f;    // cosine: within 60 degrees
constexpr float kTentCells = 1.5f;

// Numbers places so that corners closer than `tolerance` to a place's first corner share it. Stored positions are
// quantised per tile, so one point of the world may be read with slightly different coordinates from two tiles.
std::vector<uint32_t> weldPlaces(const std::vector<Vec3>& corners, float tolerance, std::vector<Vec3>* places) {
  std::unordered_map<GridCell, std::vector<uint32_t>, GridCellHash> grid;
  const float cell = 4 * tolerance;
  std::vector<uint32_t> place_of(corners.size());
  for (size_t i = 0; i < corners.size(); ++i) {
    const Vec3 p = corners[i];
    GridCell lo{}, hi{}, own{};
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

// The edge of the grid that each patch was cut by, m: where patches are finer or coarser, cell_m by a power of two. As long as the
// longest side of its box or of one that touches it, for patches may be smaller than their cell.
std::vector<float> gridOf(const ViewScene& scene, const std::vector<bool>& sealed, const Lists& neighbours) {
  constexpr float kSlack = 0.25f;  // crumbs reach over the border of a cell
  std::vector<Box> box(scene.patches.size());
  for (size_t c = 0; c < scene.corners.size(); ++c)
    if (!sealed[c / 3]) box[scene.triangle_patch[c / 3]].add(scene.corners[c]);
  const auto longest = [&](uint32_t p) {
    const Vec3 size = box[p].hi - box[p].lo;
    return std::max({size.x, size.y, size.z});
  };
  std::vector<float> grid(scene.patches.size(), scene.cell_m);
  for (uint32_t p = 0; p < grid.size(); ++p) {
    float size = longest(p);
    for (const uint32_t q : neighbours.of(p)) size = std::max(size, longest(q));
    if (size > 0) grid[p] *= std::exp2(std::clamp(std::floor(std::log2(size / scene.cell_m) + kSlack), -4.0f, 4.0f));
  }
  return grid;
}

VertexPatches lightOf(const ViewScene& scene, const Lists& touching, const Lists& neighbours, std::span<const float> grid,
                      uint32_t vertex, Vec3 at, Vec3 normal) {
  std::vector<std::pair<float, uint32_t>> weights;  // found by a linear search: a few dozen at most
  const auto add = [&](uint32_t patch, bool touches) {
    for (const auto& [w, p] : weights)
      if (p == patch) return;
    const formats::Node& n = scene.patches[patch];
    if (!touches && dot(n.normal, normal) <= kSameWay) return;
    const float tent = 1 - length(at - n.centroid) / (kTentCells * grid[patch]);
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

Lists makeLists(std::vector<std::pair<uint32_t, uint32_t>> pairs, size_t owners) {
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  Lists lists;
  lists.start.assign(owners + 1, 0);
  lists.items.reserve(pairs.size());
  for (const auto& [owner, item] : pairs) {
    ++lists.start[owner + 1];
    lists.items.push_back(item);
  }
  std::partial_sum(lists.start.begin(), lists.start.end(), lists.start.begin());
  return lists;
}

Weld weldScene(const ViewScene& scene) {
  // 16-bit positions over a tile err by bounds / 131070 in each axis, and a tile may be as large as the world.
  const float extent = std::max({scene.bounds.hi.x - scene.bounds.lo.x, scene.bounds.hi.y - scene.bounds.lo.y,
                                 scene.bounds.hi.z - scene.bounds.lo.z});
  const float tolerance = std::clamp(extent * 2e-5f, 1e-3f * scene.cell_m, 1e-2f * scene.cell_m);
  std::vector<Vec3> places;
  const std::vector<uint32_t> place_of = weldPlaces(scene.corners, tolerance, &places);

  std::vector<Vec3> corners(scene.corners.size());  // welded: two of a triangle may have become one
  std::vector<Vec3> doubled(scene.triangles());     // normals, as long as twice the area
  for (size_t c = 0; c < corners.size(); ++c) corners[c] = places[place_of[c]];
  for (size_t t = 0; t < doubled.size(); ++t) doubled[t] = cross(corners[3 * t + 1] - corners[3 * t], corners[3 * t + 2] - corners[3 * t]);
  const auto facing = [&](size_t t) {
    const Vec3 n = normalized(doubled[t]);
    return n == Vec3{} ? scene.patches[scene.triangle_patch[t]].normal : n;
  };

  // A crumb may point another way than the patch that it joined, whose light it has.
  const auto areAlike = [&](size_t t, size_t u) {
    const uint32_t p = scene.triangle_patch[t], q = scene.triangle_patch[u];
    return dot(facing(t), facing(u)) > kSameWay && (p == q || dot(scene.patches[p].normal, scene.patches[q].normal) > kSameWay);
  };

  // Split each place into classes of faces that point the same way; the first face of a class stands for it. Then split the
  // classes into those that see each other past what stands on them.
  std::vector<std::pair<uint32_t, uint32_t>> corners_at;
  corners_at.reserve(corners.size());
  const std::vector<bool> sealed = scene.whichAreSealed();
  for (uint32_t c = 0; c < corners.size(); ++c)
    if (!sealed[c / 3]) corners_at.emplace_back(place_of[c], c);
  const Lists at = makeLists(std::move(corners_at), places.size());
  const Walls walls(corners, scene.triangle_patch, scene.cell_m, tolerance);
  Weld weld;
  weld.corner_vertex.resize(corners.size());
  std::vector<Vec3> class_normal, area_normal;
  std::vector<std::vector<uint32_t>> classes;  // corners
  for (uint32_t place = 0; place < places.size(); ++place) {
    classes.clear();
    for (const uint32_t c : at.of(place)) {
      auto it = std::find_if(classes.begin(), classes.end(), [&](const auto& k) { return areAlike(k[0] / 3, c / 3); });
      if (it == classes.end()) it = classes.insert(it, {{}});
      it->push_back(c);
    }
    for (const auto& alike : classes)
      for (const auto& together : walls.split(alike)) {
        for (const uint32_t c : together) weld.corner_vertex[c] = static_cast<uint32_t>(weld.position.size());
        weld.position.push_back(places[place]);
        class_normal.push_back(facing(together[0] / 3));
        area_normal.push_back({});
        for (const uint32_t c : together) area_normal.back() += doubled[c / 3];
      }
  }
  const size_t vertices = weld.position.size();  // of what light gets to
  weld.normal.resize(vertices);
  for (size_t v = 0; v < vertices; ++v) {
    weld.normal[v] = normalized(area_normal[v]);
    if (weld.normal[v] == Vec3{}) weld.normal[v] = class_normal[v];
  }

  std::vector<std::pair<uint32_t, uint32_t>> pairs;
  pairs.reserve(scene.corners.size());
  for (size_t c = 0; c < scene.corners.size(); ++c)
    if (!sealed[c / 3]) pairs.emplace_back(weld.corner_vertex[c], scene.triangle_patch[c / 3]);
  const Lists touching = makeLists(std::move(pairs), vertices);
  pairs = {};
  for (uint32_t v = 0; v < vertices; ++v)
    for (const uint32_t a : touching.of(v))
      for (const uint32_t b : touching.of(v))
        if (a != b) pairs.emplace_back(a, b);
  weld.neighbours = makeLists(std::move(pairs), scene.patches.size());
  const std::vector<float> grid = gridOf(scene, sealed, weld.neighbours);
  weld.light_from.resize(vertices);
  for (uint32_t v = 0; v < vertices; ++v)
    weld.light_from[v] = lightOf(scene, touching, weld.neighbours, grid, v, weld.position[v], weld.normal[v]);
  for (const uint32_t t : scene.sealed)
    for (uint32_t c = 3 * t; c < 3 * t + 3; ++c) {
      weld.corner_vertex[c] = static_cast<uint32_t>(weld.position.size());
      weld.position.push_back(places[place_of[c]]);
      weld.normal.push_back(facing(t));
      weld.light_from.push_back({{scene.triangle_patch[t]}, {1}});
    }
  return weld;
}

}  // namespace ff::view
