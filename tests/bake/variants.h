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

#include "bake/cleanup/scene_cleanup.h"
#include "tests/support/analytic_scenes.h"

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

// Mean irradiance by place, to 2 m of the scene as modelled, and by where the surface faces: of lamps, bounces and a sky that gives 1.
using Light = std::map<std::tuple<int, int, int, int>, std::pair<double, double>>;  // area, area times irradiance
constexpr double kOffBorder = 0.01;  // places' borders lie beside planes of whole metres, where rounding would choose

// scene: as it is after varied(). at: where its origin as modelled lies, m as modelled.
inline Light lightIn(const Scene& scene, const Variant& v, std::vector<std::string>& notes, const CleanupSettings& settings = {},
                     float cell_m = 0.5f, uint32_t rays = 512, Vec3 at = {}) {
  auto clean = cleanUp(scene, settings);
  EXPECT_TRUE(clean);
  notes.clear();
  for (const Finding& finding : clean->findings) notes.push_back(lineOf(finding));
  const CastScene c = cast(clean->scene ? *clean->scene : scene, cell_m * v.scale, rays);
  const size_t n = c.set.patches.size();
  std::vector<double> direct(n), e;
  for (size_t i = 0; i < n; ++i) {
    direct[i] = static_cast<double>(c.rows.sky_fraction[i]);
    for (const LampIrradiance& lamp : c.rows.lamps[i]) direct[i] += lamp.rgb[0];
    direct[i] /= static_cast<double>(exposedFraction(c.rows, i));
  }
  e = direct;
  for (int bounce = 0; bounce < 40; ++bounce)
    for (size_t i = 0; i < n; ++i) {
      double reflected = 0;
      for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k)
        reflected += c.rows.count[k] * static_cast<double>(c.set.patches[c.rows.column[k]].albedo.x) * e[c.rows.column[k]];
      e[i] = direct[i] + reflected / std::max(1u, c.rows.rays[i] - c.rows.buried[i]);
    }
  Light light;
  for (size_t i = 0; i < n; ++i) {
    const Patch& p = c.set.patches[i];
    const std::array<double, 3> centroid{static_cast<double>(p.centroid.x) + scene.origin[0], static_cast<double>(p.centroid.y) + scene.origin[1],
                                         static_cast<double>(p.centroid.z) + scene.origin[2]};
    const auto place = [&](Vec3 axis, float from) {
      const double along = static_cast<double>(axis.x) * centroid[0] + static_cast<double>(axis.y) * centroid[1] + static_cast<double>(axis.z) * centroid[2];
      return static_cast<int>(std::floor((along / static_cast<double>(v.scale) - static_cast<double>(from)) / 2 + kOffBorder));
    };
    const Vec3 normal{dot(p.normal, v.x), dot(p.normal, v.y), dot(p.normal, v.z)};
    const int axis = std::abs(normal.y) > 0.9f ? 1 : std::abs(normal.x) > 0.9f ? 0 : 2;
    const double area = static_cast<double>(p.area_m2) * static_cast<double>(exposedFraction(c.rows, i)) / static_cast<double>(v.scale * v.scale);
    auto& bin = light[{place(v.x, at.x), place(v.y, at.y), place(v.z, at.z), 2 * axis + (normal[axis] < 0)}];
    bin.first += area;
    bin.second += area * e[i];
  }
  return light;
}

inline Light lightOf(const Scene& whole, const Variant& v, std::vector<std::string>& notes, const CleanupSettings& settings = {}) {
  return lightIn(varied(whole, v), v, notes, settings);
}

// Where the twin has surface, `odd` has as much of it and the same light. Places hold a dozen patches or more of 512 rays, or four of
// 256: their noise is about 1 %, patches that lie across two places add as much; of what is dim, which few rays find, noise is a larger share.
inline void expectSameLight(const Light& odd, const Light& twin, const char* variant) {
  constexpr double kDim = 0.5;  // of the mean
  double area = 0, twin_area = 0, sum = 0, twin_sum = 0, worst = 0;
  for (const auto& [place, t] : twin) {
    twin_area += t.first;
    twin_sum += t.second;
  }
  for (const auto& [place, t] : twin) {
    const auto at = odd.find(place);
    const auto o = at == odd.end() ? std::pair(0.0, 0.0) : at->second;
    area += o.first;
    sum += o.second;
    if (t.first < 2 || !(o.first > 0)) continue;
    const double want = t.second / t.first;
    worst = std::max(worst, std::abs(o.second / o.first - want) / std::max(want, kDim * twin_sum / twin_area));
  }
  EXPECT_NEAR(area / twin_area, 1, 0.01) << variant;
  EXPECT_NEAR(sum / twin_sum, 1, 0.015) << variant;
  EXPECT_LT(worst, 0.08) << variant;
}

}  // namespace ff::bake::test
