// Closed forms: Howell, Menguc, Daun, Siegel. A Catalog of Radiation Heat Transfer Configuration Factors (C-11, C-14, C-41, C-74).
// Tolerances: N independent rays would err by sqrt(F (1 - F) / N) (one standard deviation); scrambled Sobol points do
// better, and four of these deviations are allowed.
#include "bake/light/form_factor.h"

#include <gtest/gtest.h>

#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

double allowed(double f, const CastScene& c, uint32_t from) {
  double rays = 0;
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) rays += materialOf(c, i) == from ? c.rows.rays[i] : 0;
  return 4 * std::sqrt(f * (1 - f) / rays);
}

TEST(FormFactor, ParallelUnitSquaresAtDistanceOneMatchTheClosedForm) {
  const CastScene c = cast(parallelSquares(), 0.25f, 16384);
  EXPECT_EQ(c.set.patches.size(), 32u);
  EXPECT_NEAR(formFactor(c, 0, 1), 0.199824895698, allowed(0.2, c, 0));
  EXPECT_NEAR(formFactor(c, 1, 0), 0.199824895698, allowed(0.2, c, 1));
}

// The limits of the README: patches of 1 cm and of 100 m, where a metre is no power of two of either.
TEST(FormFactor, PatchesOfACentimetreAndOfAHundredMetresMatchTheClosedForm) {
  for (const float patch_m : {0.01f, 100.0f}) {
    Scene s = parallelSquares();
    for (Vec3& p : s.positions) p *= 4 * patch_m;
    const CastScene c = cast(s, patch_m, 16384);
    EXPECT_EQ(c.set.patches.size(), 32u) << patch_m;
    EXPECT_NEAR(formFactor(c, 0, 1), 0.199824895698, allowed(0.2, c, 0)) << patch_m;
    EXPECT_NEAR(formFactor(c, 1, 0), 0.199824895698, allowed(0.2, c, 1)) << patch_m;
  }
}

TEST(FormFactor, PerpendicularUnitSquaresWithACommonEdgeMatchTheClosedForm) {
  const CastScene c = cast(perpendicularSquares(), 0.25f, 16384);
  EXPECT_NEAR(formFactor(c, 0, 1), 0.200043776075, allowed(0.2, c, 0));
  EXPECT_NEAR(formFactor(c, 1, 0), 0.200043776075, allowed(0.2, c, 1));
}

TEST(FormFactor, CoaxialUnitDiscsAtDistanceOneMatchTheClosedForm) {
  // 512 corners: the polygon of the disc's area differs from the disc by less than 1e-5 in F.
  const CastScene c = cast(coaxialDiscs(512), 0.25f, 8192);
  EXPECT_NEAR(formFactor(c, 0, 1), 0.381966011250, allowed(0.382, c, 0) + 1e-5);
}

TEST(FormFactor, EveryRowOfAClosedCubeSumsToOne) {
  const CastScene c = cast(closedBox({.5f, .5f, .5f}, {}), 0.25f, 4096);
  EXPECT_EQ(c.set.patches.size(), 96u);
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
    EXPECT_EQ(c.rows.sky[i], 0u) << "patch " << i;
    EXPECT_EQ(c.rows.absorbed[i], 0u) << "patch " << i;
    uint64_t sum = 0;
    for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k) sum += c.rows.count[k];
    EXPECT_EQ(sum, 4096u) << "patch " << i;
  }
}

TEST(FormFactor, ASphericalCapSeesItselfByHalfOfOneMinusTheCosineOfItsHalfAngle) {
  for (double beta : {30.0, 60.0, 90.0, 150.0}) {
    const double angle = beta * std::numbers::pi / 180;
    const CastScene c = cast(sphericalCap(angle, 48, 96), 0.25f, 2048);
    const double expected = (1 - std::cos(angle)) / 2;
    // A flat facet cannot see itself: the tessellation (4 608 quads) takes its own share of the sphere, under 2e-4, away,
    // and the chord sphere's smaller radius less than 1e-3 of F.
    EXPECT_NEAR(formFactor(c, 0, 0), expected, allowed(expected, c, 0) + 2e-4 + 1e-3 * expected) << beta << " degrees";
  }
}

TEST(FormFactor, RowsDoNotDependOnTheSeedBeyondTheirNoiseButDoDependOnIt) {
  const CastScene a = cast(parallelSquares(), 0.5f, 4096, 1), b = cast(parallelSquares(), 0.5f, 4096, 2);
  EXPECT_NE(a.rows.count, b.rows.count);
  EXPECT_NEAR(formFactor(a, 0, 1), formFactor(b, 0, 1), 2 * allowed(0.2, a, 0));
}

TEST(FormFactor, TheMeansOfAFreePlatesSkyAreThoseOfTheCosine) {
  // The mean of a cosine-distributed direction is 2/3 of the normal, that of y^2 is 1/2; what is odd averages out.
  Scene s;
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, addMaterial(s, {.5f, .5f, .5f}));
  const CastScene c = cast(std::move(s), 1, 16384);
  ASSERT_EQ(c.set.patches.size(), 1u);
  EXPECT_EQ(c.rows.sky[0], 16384u);
  EXPECT_NEAR(c.rows.sky_means[0].direction.y, 2.0f / 3, 2e-3f);
  EXPECT_NEAR(c.rows.sky_means[0].direction.x, 0.0f, 2e-3f);
  const std::array<float, 5> quadratic = {0, 0, 0, 0.25f, 0};
  for (size_t k = 0; k < 5; ++k) EXPECT_NEAR(c.rows.sky_means[0].quadratic[k], quadratic[k], 3e-3f) << k;
}

}  // namespace
}  // namespace ff::bake::test
