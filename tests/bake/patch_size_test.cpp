#include "bake/surface/patch_size.h"

#include <gtest/gtest.h>

#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

// Floor tiles of one square each, on a slope of steps: `at` is the corner of the first, m.
Scene steps(int side, float square_m, Vec3 at = {}) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  for (int x = 0; x < side; ++x)
    for (int z = 0; z < side; ++z) {
      const Vec3 o = at + Vec3{static_cast<float>(x), static_cast<float>((x + z) / 2), static_cast<float>(z)} * square_m;
      addQuad(s, o, o + Vec3{0, 0, square_m}, o + Vec3{square_m, 0, square_m}, o + Vec3{square_m, 0, 0}, m);
    }
  return s;
}

TEST(PatchSize, ALatticeIsFoundWhereAllCornersLieOnIt) {
  EXPECT_EQ(latticeOf(steps(8, 1), 0.1f), 1);
  EXPECT_EQ(latticeOf(steps(8, 0.25f, {3, -2, 100}), 0.1f), 0.25f);
  EXPECT_EQ(latticeOf(steps(8, 1, {0.5f, 0, 0}), 0.1f), 0.5f);  // cells start at the origin
}

TEST(PatchSize, ThereIsNoLatticeInOtherScenesNorOneFinerThanIsAskedFor) {
  EXPECT_EQ(latticeOf(sphericalCap(2.0, 16, 32), 0.01f), 0);
  EXPECT_EQ(latticeOf(steps(8, 1, {0.3f, 0, 0}), 0.1f), 0);
  EXPECT_EQ(latticeOf(steps(8, 0.05f), 0.1f), 0);
  EXPECT_EQ(latticeOf({}, 0.1f), 0);
}

TEST(PatchSize, CellsFallOnTheSquaresOfALatticeWhereTheBudgetAllows) {
  const Scene scene = steps(32, 0.5f);
  const auto caster = RayCaster::create(scene);
  ASSERT_TRUE(caster);
  // 1024 squares, 4096 quarters of them.
  for (const auto& [budget, cell] : {std::pair{1000u, 0.5f}, {4200u, 0.25f}}) {
    const auto set = patchesWithin(budget, scene, {}, *caster);
    ASSERT_TRUE(set);
    EXPECT_EQ(set->cell_m, cell) << budget;
    EXPECT_EQ(set->patches.size(), cell == 0.5f ? 1024u : 4096u);
  }
}

TEST(PatchSize, TheBudgetComesBeforeTheLattice) {
  const Scene scene = steps(32, 0.5f);
  const auto caster = RayCaster::create(scene);
  ASSERT_TRUE(caster);
  const auto set = patchesWithin(2000, scene, {}, *caster);
  ASSERT_TRUE(set);
  EXPECT_NEAR(static_cast<double>(set->patches.size()), 2000, 300);
}

}  // namespace
}  // namespace ff::bake::test
