#include "bake/light/leaks.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "bake/cleanup/scene_names.h"
#include "bake/point.h"

namespace ff::bake {
namespace {

// Squared, m2. Christer Ericson. Real-Time Collision Detection. 2005, section 5.1.5.
double distanceSquared(const Point& p, const Point& a, const Point& b, const Point& c) {
  const Point ab = b - a, ac = c - a, ap = p - a;
  const auto from = [&](const Point& q) { return dot(p - q, p - q); };
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return from(a);
  const Point bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return from(b);
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return from(a + ab * (d1 / (d1 - d3)));
  const Point cp = p - c;
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return from(c);
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return from(a + ac * (d2 / (d2 - d6)));
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return from(b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))));
  return from(a + ab * (vb / (va + vb + vc)) + ac * (vc / (va + vb + vc)));
}

}  // namespace

void LeakSums::add(const Leak& leak) {
  std::array<int32_t, 3> cube;
  for (int k = 0; k < 3; ++k) cube[static_cast<size_t>(k)] = static_cast<int32_t>(std::floor(leak.at[k] / cube_m_));
  cubes_[cube].add(static_cast<double>(leak.m2), leak.at);
}

std::vector<Leak> LeakSums::heaviest(size_t most) const {
  std::vector<Leak> leaks;
  for (const auto& [cube, sum] : cubes_) leaks.push_back({sum.at, static_cast<float>(sum.sum)});
  std::stable_sort(leaks.begin(), leaks.end(), [](const Leak& a, const Leak& b) { return a.m2 > b.m2; });
  leaks.resize(std::min(leaks.size(), most));
  return leaks;
}

std::vector<FoundPlace> placesOf(const Scene& scene, std::span<const Leak> leaks, double whole_m2) {
  std::vector<FoundPlace> places;
  for (const Leak& leak : leaks) {
    const Point p = pointOf(leak.at);
    double nearest = std::numeric_limits<double>::infinity();
    uint32_t met = kNone;  // by where it is, since hits from the cache tell no numbers of triangles
    for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
      const auto& [v, material] = scene.triangles[t];
      if (scene.materials[material].double_sided) continue;
      const double d = distanceSquared(p, pointOf(scene.positions[v[0]]), pointOf(scene.positions[v[1]]), pointOf(scene.positions[v[2]]));
      if (d >= nearest) continue;
      nearest = d;
      met = t;
    }
    places.push_back({inWorld(scene, leak.at), met == kNone ? "" : placeOf(scene, met), static_cast<double>(leak.m2) / whole_m2});
  }
  return places;
}

}  // namespace ff::bake
