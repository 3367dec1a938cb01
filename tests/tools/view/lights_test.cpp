// The file's lights on patches, against E = I cos / r^2 and what stands in the way.
#include "tools/view/lights.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/tools/view/view_scenes.h"

namespace ff::view {
namespace {

using formats::Light;

const Light kPoint{"", Light::kPoint, {100, 50, 25}, {1, 2, 1}, {}, 0, 0, 0};

TEST(ViewLights, FollowTheInverseSquareAndTheCosine) {
  const Vec3 up{0, 1, 0};
  EXPECT_FLOAT_EQ(unshadowedIrradiance(kPoint, {1, 0, 1}, up).x, 25);          // 100 / 2^2
  EXPECT_NEAR(unshadowedIrradiance(kPoint, {3, 0, 1}, up).y, 50 / 8.0 * std::numbers::sqrt2 / 2, 1e-5);
  EXPECT_EQ(unshadowedIrradiance(kPoint, {1, 3, 1}, up), Vec3{}) << "from behind";
  EXPECT_EQ(unshadowedIrradiance(kPoint, {1, 2, 1}, up), Vec3{}) << "in the light itself";
  Light near = kPoint;
  near.range_m = 4;
  EXPECT_NEAR(unshadowedIrradiance(near, {1, 0, 1}, up).x, 25 * (1 - 1.0 / 16), 1e-5);
  near.range_m = 2;
  EXPECT_EQ(unshadowedIrradiance(near, {1, 0, 1}, up), Vec3{});
  const Light spot{"", Light::kSpot, {1, 1, 1}, {0, 1, 0}, {0, -1, 0}, 0, 0.2f, 0.4f};
  EXPECT_FLOAT_EQ(unshadowedIrradiance(spot, {0, 0, 0}, up).x, 1);
  EXPECT_EQ(unshadowedIrradiance(spot, {std::tan(0.41f), 0, 0}, up).x, 0);
  const float between = unshadowedIrradiance(spot, {std::tan(0.3f), 0, 0}, up).x;
  const double share = (std::cos(0.3) - std::cos(0.4)) / (std::cos(0.2) - std::cos(0.4));
  EXPECT_NEAR(between, share * share * std::pow(std::cos(0.3), 3), 1e-5);
  const Light sun{"", Light::kDirectional, {4, 4, 4}, {}, normalized({1, -1, 0}), 0, 0, 0};
  EXPECT_NEAR(unshadowedIrradiance(sun, {9, 9, 9}, up).x, 4 * std::numbers::sqrt2 / 2, 1e-5);
  EXPECT_EQ(unshadowedIrradiance(sun, {9, 9, 9}, {0, -1, 0}), Vec3{});
}

using Map = Vec3 (*)(Vec3);
struct Variant {
  Map map;
  float scale;
  bool mirrors;
};
// As it is; a hundredth as large, turned; three hundred times as large, mirrored.
const Variant kVariants[] = {{[](Vec3 p) { return p; }, 1, false},
                             {[](Vec3 p) { return Vec3{p.y, p.z, p.x} * 0.01f; }, 0.01f, false},
                             {[](Vec3 p) { return Vec3{-p.x, p.y, p.z} * 300.0f; }, 300, true}};

void addMapped(ViewScene& scene, const Variant& v, Vec3 at, Vec3 u, Vec3 w, int nu, int nv) {
  const Vec3 origin = v.map({}), a = v.map(u) - origin, b = v.map(w) - origin;
  v.mirrors ? addSheet(scene, v.map(at), b, a, nv, nu) : addSheet(scene, v.map(at), a, b, nu, nv);
}

// A floor of 4 x 4 m under a light, in patches of 25 cm. The mean over a patch is that of 32 points; the light's second
// derivative over 25 cm at 2 m is below 1 %.
TEST(ViewLights, OfPatchesAreTheMeansOfTheirPoints) {
  for (const Variant& v : kVariants) {
    ViewScene scene;
    scene.cell_m = 0.25f * v.scale;
    addMapped(scene, v, {-1, 0, -1}, {0, 0, 4}, {4, 0, 0}, 16, 16);
    Light light = kPoint;
    light.position = v.map(light.position);
    light.color_intensity *= v.scale * v.scale;
    const auto e = irradianceFrom(std::span(&light, 1), scene);
    double flux = 0;
    for (size_t p = 0; p < e.size(); ++p) {
      const Vec3 whole = unshadowedIrradiance(light, scene.patches[p].centroid, scene.patches[p].normal);
      ASSERT_NEAR(e[p].x / whole.x, 1, 0.03) << p;
      flux += static_cast<double>(e[p].x * scene.patches[p].area_m2);
    }
    // Solid angle of a square of half-edge 2 at height 2 is that of a cube's face: 4 pi / 6.
    EXPECT_NEAR(flux / (static_cast<double>(light.color_intensity.x) * 4 * std::numbers::pi / 6), 1, 2e-3);
  }
}

// A wall without thickness stands on the floor, halfway into a row of patches; the light is on its near side.
TEST(ViewLights, DoNotLeakThroughWalls) {
  for (const Variant& v : kVariants) {
    ViewScene scene;
    scene.cell_m = 0.5f * v.scale;
    addMapped(scene, v, {0, 0, 0}, {0, 0, 4}, {4, 0, 0}, 8, 8);
    const size_t floor = scene.patches.size();
    addMapped(scene, v, {2.25f, 0, 0}, {0, 9, 0}, {0, 0, 4}, 1, 1);
    Light light = kPoint;
    light.position = v.map({1, 2, 2});
    for (const bool mounted : {false, true}) {
      if (mounted) addMapped(scene, v, {0, 2, 0}, {4, 0, 0}, {0, 0, 4}, 1, 1);  // the light is in the ceiling's plane
      const auto e = irradianceFrom(std::span(&light, 1), scene);
      for (size_t p = 0; p < floor; ++p) {
        const float x = std::abs(v.map({1, 0, 0}).x) > 0 ? std::abs(scene.patches[p].centroid.x) / v.scale : scene.patches[p].centroid.z / v.scale;
        const float whole = unshadowedIrradiance(light, scene.patches[p].centroid, scene.patches[p].normal).x;
        if (x < 1.9f)
          EXPECT_NEAR(e[p].x / whole, 1, 0.1) << x;
        else if (x > 2.6f)
          EXPECT_EQ(e[p].x, 0) << x;
        else
          EXPECT_NEAR(e[p].x / whole, 0.5, 0.15) << "half of the patch lies behind the wall";
      }
    }
  }
}

TEST(ViewLights, AddUpAndOrderDoesNotMatter) {
  ViewScene scene;
  scene.cell_m = 0.5f;
  addSheet(scene, {0, 0, 0}, {0, 0, 2}, {2, 0, 0}, 4, 4);
  const Light sun{"", Light::kDirectional, {1, 1, 1}, {}, {0, -1, 0}, 0, 0, 0};
  const auto one = irradianceFrom(std::vector{kPoint}, scene), two = irradianceFrom(std::vector{sun}, scene),
             both = irradianceFrom(std::vector{kPoint, sun}, scene);
  ViewScene shuffled = scene;
  for (size_t t = 0; t < scene.triangles(); ++t) {
    const size_t from = (t * 7 + 3) % scene.triangles();
    std::copy_n(&scene.corners[3 * from], 3, &shuffled.corners[3 * t]);
    shuffled.triangle_patch[t] = scene.triangle_patch[from];
  }
  const auto again = irradianceFrom(std::vector{kPoint, sun}, shuffled);
  for (size_t p = 0; p < both.size(); ++p) {
    EXPECT_NEAR(both[p].x, one[p].x + two[p].x, 1e-4f * both[p].x);
    EXPECT_NEAR(again[p].x, both[p].x, 0.02f * both[p].x);
  }
  EXPECT_TRUE(irradianceFrom({}, scene) == std::vector<Vec3>(16));
}

}  // namespace
}  // namespace ff::view
