#include "bake/cleanup/slivers.h"

#include <algorithm>

#include "bake/cleanup/scene_names.h"
#include "bake/point.h"
#include "bake/rays/surface_sampling.h"

namespace ff::bake {
namespace {

constexpr double kThinnestSliver = 3e-6;  // height, of the largest coordinate: as far as rays start off a surface

bool isSliver(const Scene& scene, uint32_t t) {
  const auto& v = scene.triangles[t].v;
  const Point a = pointOf(scene.positions[v[0]]), b = pointOf(scene.positions[v[1]]), c = pointOf(scene.positions[v[2]]);
  const double longest = std::max({length(b - a), length(c - b), length(a - c)});
  return length(cross(b - a, c - a)) < kThinnestSliver * static_cast<double>(largestCoordinate(scene, t)) * longest;
}

}  // namespace

std::optional<Finding> findSlivers(const Scene& scene) {
  PlaceSums places(scene);
  uint64_t slivers = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    if (!isSliver(scene, t)) continue;
    ++slivers;
    places.add(t);
  }
  const uint64_t bad = slivers + scene.without_area, all = scene.triangles.size() + scene.without_area;
  if (!(static_cast<double>(bad) > kFewSlivers * static_cast<double>(all))) return {};
  Finding finding{"slivers", "", bad, "triangles", static_cast<double>(bad) / static_cast<double>(all), "triangles"};
  if (slivers > 0) finding.what = counted(slivers, "triangle") + (slivers == 1 ? " is" : " are") + " too thin for a normal";
  if (scene.without_area > 0)
    finding.what += (slivers > 0 ? ", " : "") + counted(scene.without_area, "triangle") + (scene.without_area == 1 ? " has" : " have") + " no area and " +
                    (scene.without_area == 1 ? "is" : "are") + " left out";
  places.putInto(finding);
  for (const FoundPlace& place : scene.without_area_at)
    if (finding.places.size() < kMaxPlaces) finding.places.push_back(place);
  return finding;
}

}  // namespace ff::bake
