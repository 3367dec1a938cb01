// Scenes as others might have modelled them, and the light in them beside that of a clean twin.
#pragma once
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "bake/scene_cleanup.h"
#include "tests/bake/analytic_scenes.h"

namespace ff::bake::test {

// A scene as others might have modelled it: turned, in other units, mirrored, its triangles in another order.
struct Variant {
  const char* name;
  Vec3 x, y, z;  // where the axes point
  float scale;
  bool shuffled;
  bool turned() const { return std::abs(x.x) < 0.99f; }
};

inline const Variant kVariants[] = {
    {"as it is", {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, 1, false},
    {"shuffled", {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, 1, true},
    {"turned by 30 degrees", {0.8660254f, 0, -0.5f}, {0, 1, 0}, {0.5f, 0, 0.8660254f}, 1, false},
    {"tilted", {0.8f, 0.6f, 0}, {-0.48f, 0.64f, 0.6f}, {0.36f, -0.48f, 0.8f}, 1, true},
    {"centimetres", {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, 100, true},
    {"mirrored", {-1, 0, 0}, {0, 1, 0}, {0, 0, 1}, 1, false},
};

inline Scene varied(const Scene& scene, const Variant& v) {
  Scene out = scene;
  for (Vec3& p : out.positions) p = (v.x * p.x + v.y * p.y + v.z * p.z) * v.scale;
  if (dot(cross(v.x, v.y), v.z) < 0)
    for (Triangle& t : out.triangles) std::swap(t.v[1], t.v[2]);
  if (v.shuffled) std::reverse(out.triangles.begin(), out.triangles.end());
  return out;
}

// Mean irradiance by place, to 2 m of the scene as modelled, and by where the surface faces: emission, bounces and a sky that gives 1.
using Light = std::map<std::tuple<int, int, int, int>, std::pair<double, double>>;  // area, area times irradiance

inline Light lightOf(const Scene& whole, const Variant& v, std::vector<std::string>& notes, CleanupSettings settings = {}) {
  const Scene odd = varied(whole, v);
  auto clean = cleanUp(odd, settings);
  EXPECT_TRUE(clean);
  notes = clean->notes;
  const CastScene c = cast(clean->scene ? *clean->scene : odd, 0.5f * v.scale, 512);
  const size_t n = c.set.patches.size();
  std::vector<double> e(n), b(n);
  for (int bounce = 0; bounce < 40; ++bounce) {
    for (size_t i = 0; i < n; ++i) b[i] = static_cast<double>(c.set.patches[i].emission.x) + static_cast<double>(c.set.patches[i].albedo.x) * e[i];
    for (size_t i = 0; i < n; ++i) {
      e[i] = c.rows.sky[i];
      for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k) e[i] += c.rows.count[k] * b[c.rows.column[k]];
      e[i] /= std::max(1u, c.rows.rays[i] - c.rows.buried[i]);
    }
  }
  Light light;
  for (size_t i = 0; i < n; ++i) {
    const Patch& p = c.set.patches[i];
    const auto back = [&](Vec3 q) { return Vec3{dot(q, v.x), dot(q, v.y), dot(q, v.z)}; };
    const Vec3 at = back(p.centroid) / v.scale, normal = back(p.normal);
    const int axis = std::abs(normal.y) > 0.9f ? 1 : std::abs(normal.x) > 0.9f ? 0 : 2;
    const double area = static_cast<double>(p.area_m2) * exposedFraction(c.rows, i) / static_cast<double>(v.scale * v.scale);
    auto& bin = light[{static_cast<int>(std::floor(at.x / 2)), static_cast<int>(std::floor(at.y / 2)),
                       static_cast<int>(std::floor(at.z / 2)), 2 * axis + (normal[axis] < 0)}];
    bin.first += area;
    bin.second += area * e[i];
  }
  return light;
}

// Where the twin has surface, `odd` has as much of it and the same light. Bins hold a dozen patches or more of 512 rays: their
// noise is about 1 %, patches that lie across two bins add as much.
inline void expectSameLight(const Light& odd, const Light& twin, const char* variant) {
  double area = 0, twin_area = 0, sum = 0, twin_sum = 0, worst = 0;
  for (const auto& [place, t] : twin) {
    const auto at = odd.find(place);
    const auto o = at == odd.end() ? std::pair(0.0, 0.0) : at->second;
    area += o.first;
    twin_area += t.first;
    sum += o.second;
    twin_sum += t.second;
    if (t.first > 2 && t.second > 0.02 && o.first > 0) worst = std::max(worst, std::abs(o.second / o.first / (t.second / t.first) - 1));
  }
  EXPECT_NEAR(area / twin_area, 1, 0.01) << variant;
  EXPECT_NEAR(sum / twin_sum, 1, 0.015) << variant;
  EXPECT_LT(worst, 0.08) << variant;
}

}  // namespace ff::bake::test
