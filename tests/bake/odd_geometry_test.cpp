// Scenes as people export them, each with one odd thing, beside their clean twins.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/bake/analytic_scenes.h"

namespace ff::bake::test {
namespace {

// A floor of 8 m with a slab 10 cm above its middle, and one triangle of 1 m2 so far away.
Scene floorUnderSlab(float stray_m) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 8}, {8, 0, 8}, {8, 0, 0}, m);
  addBlock(s, {2, 0.1f, 2}, {6, 0.14f, 6}, m);
  if (stray_m > 0) addTriangle(s, {stray_m, 0, 0}, {stray_m, 0, 2}, {stray_m + 1, 0, 1}, m);
  return s;
}

TEST(OddGeometry, AStrayTriangleFarAwayChangesNothing) {
  struct Near {
    double area = 0, sky = 0;
  };
  const auto near = [](float stray_m) {
    const CastScene c = cast(floorUnderSlab(stray_m), 0.5f, 256);
    Near sum;
    for (size_t i = 0; i < c.set.patches.size(); ++i) {
      if (c.set.patches[i].centroid.x > 100) continue;
      const double area = static_cast<double>(c.set.patches[i].area_m2);
      sum.area += area;
      sum.sky += area * c.rows.sky[i] / c.rows.rays[i];
    }
    return sum;
  };
  const Near alone = near(0);
  EXPECT_NEAR(alone.area, 64 + 2 * 16 + 4 * 4 * 0.04, 0.05);  // less a little that is sealed between floor and slab
  for (const float stray_m : {5e3f, 5e4f, 4e5f}) {
    const Near with = near(stray_m);
    EXPECT_NEAR(with.area, alone.area, 1e-4) << stray_m;
    // Patches' numbers are others, so are their rays: 256 rays of each of some 600 patches, a standard error of 0.1 % of a share near 0.5.
    EXPECT_NEAR(with.sky / alone.sky, 1, 0.005) << stray_m;
  }
}

}  // namespace
}  // namespace ff::bake::test
