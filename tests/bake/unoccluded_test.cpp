// What patches exchange where nothing stands between them, in closed form, and how much of it is hidden.
// Howell, Menguc, Daun, Siegel. A Catalog of Radiation Heat Transfer Configuration Factors (C-11, C-14).
#include "bake/light/unoccluded.h"

#include <gtest/gtest.h>

#include <iostream>

#include "bake/light/ray_fan.h"
#include "bake/matrix/pool.h"
#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

PatchShape shapeOf(const PatchSet& set, uint32_t patch) {
  PatchShape shape;
  shape.assign(set, patch);
  return shape;
}

double exchange(const PatchSet& set, uint32_t i, uint32_t j) { return unoccludedExchange(shapeOf(set, i), shapeOf(set, j)).value(); }

// Of unit squares that face each other.
double facingSquares(double apart) {
  const double x = 1 / apart, s = std::sqrt(1 + x * x);
  return 2 / (std::numbers::pi * x * x) * (std::log(s * s / std::sqrt(1 + 2 * x * x)) + 2 * x * s * std::atan(x / s) - 2 * x * std::atan(x));
}

TEST(Unoccluded, FacingSquaresExchangeWhatTheClosedFormSays) {
  EXPECT_NEAR(facingSquares(1), 0.199824895698, 1e-12);
  for (const float apart : {0.2f, 0.5f, 1.0f, 1.5f, 2.0f, 2.5f, 3.0f, 5.0f, 8.0f, 9.0f, 20.0f, 100.0f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, m);
    addQuad(s, {0, apart, 0}, {1, apart, 0}, {1, apart, 1}, {0, apart, 1}, m);
    const auto set = makePatches(s, {.cell_m = 1});
    ASSERT_TRUE(set);
    ASSERT_EQ(set->patches.size(), 2u);
    const double expected = facingSquares(static_cast<double>(apart));
    EXPECT_NEAR(exchange(*set, 0, 1), expected, 0.01 * expected) << apart;
    EXPECT_NEAR(exchange(*set, 0, 1), exchange(*set, 1, 0), 1e-12) << apart;
    EXPECT_GE(farExchange(set->patches[0], set->patches[1]), expected) << apart;  // it asks for the work where it may matter
  }
}

TEST(Unoccluded, IsNotToldWhereSurfacesCrossOrLieCloseUponEachOther) {
  const auto told = [](Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, m);
    addQuad(s, a, b, c, d, m);
    for (Vec3& p : s.positions) p += Vec3{1, 1, 1};  // within a cell
    const auto set = makePatches(s, {.cell_m = 64});
    uint32_t first = 0;  // of each quad
    while (set->triangles[set->patches[first].first_triangle].source > 1) ++first;
    uint32_t second = 0;
    while (set->triangles[set->patches[second].first_triangle].source < 2) ++second;
    return unoccludedExchange(shapeOf(*set, first), shapeOf(*set, second)).has_value();
  };
  EXPECT_FALSE(told({0, 0.01f, 0}, {1, 0.01f, 0}, {1, 0.01f, 1}, {0, 0.01f, 1}));
  EXPECT_TRUE(told({0, 0.2f, 0}, {1, 0.2f, 0}, {1, 0.2f, 1}, {0, 0.2f, 1}));
  EXPECT_TRUE(told({0, -0.01f, 0}, {1, -0.01f, 0}, {1, -0.01f, 1}, {0, -0.01f, 1}));  // behind
  EXPECT_FALSE(told({0.5f, -0.5f, 0}, {0.5f, 0.5f, 0}, {0.5f, 0.5f, 1}, {0.5f, -0.5f, 1}));
  EXPECT_TRUE(told({0.5f, 0, 0}, {0.5f, 0.5f, 0}, {0.5f, 0.5f, 1}, {0.5f, 0, 1}));  // stands on it
  EXPECT_TRUE(told({1.5f, -0.5f, 0}, {1.5f, -0.5f, 1}, {1.5f, 0.5f, 1}, {1.5f, 0.5f, 0}));  // reaches below it, beside it
}

TEST(Unoccluded, SquaresWithACommonEdgeExchangeWhatTheClosedFormSays) {
  const auto set = makePatches(perpendicularSquares(), {.cell_m = 1});
  ASSERT_TRUE(set);
  EXPECT_NEAR(exchange(*set, 0, 1), 0.200043776075, 1e-4);
}

// Nothing hides anything in a box: whatever a patch sees of it adds up to its hemisphere, small beside large, side by side, in corners.
TEST(Unoccluded, WhatAPatchExchangesWithAClosedBoxIsItsArea) {
  for (const float cell_m : {0.5f, 0.25f, 0.1f, 0.3f}) {  // the last one leaves strips along walls
    const auto set = makePatches(closedBox({.5f, .5f, .5f}, {}), {.cell_m = cell_m});
    ASSERT_TRUE(set);
    for (uint32_t i = 0; i < set->patches.size(); ++i) {
      double sum = 0;
      for (uint32_t j = 0; j < set->patches.size(); ++j) sum += i == j ? 0 : exchange(*set, i, j);
      EXPECT_NEAR(sum / static_cast<double>(set->patches[i].area_m2), 1, 0.004) << cell_m << ", patch " << i;
    }
  }
}

TEST(Unoccluded, TrianglesOfOnePolygonAreOneFacet) {
  const auto set = makePatches(coaxialDiscs(16), {.cell_m = 4});
  ASSERT_TRUE(set);
  const PatchShape quarter = shapeOf(*set, 0), square = shapeOf(*makePatches(parallelSquares(), {.cell_m = 1}), 0);
  EXPECT_EQ(square.facets.size(), 1u);
  EXPECT_EQ(square.facets[0].corners, 4u);
  EXPECT_NEAR(square.area_m2, 1, 1e-6);
  EXPECT_NEAR(quarter.area_m2, std::numbers::pi / 4, 1e-5);
  EXPECT_EQ(quarter.facets.size(), 1u);  // of four triangles around a corner
  EXPECT_EQ(quarter.facets[0].corners, 6u);
}

// A box with a sheet in it, another that overlaps the floor in part, and something round.
Scene crowded() {
  Scene s = closedBox({.5f, .5f, .5f}, {});
  addQuad(s, {0.2f, 0.5f, 0.2f}, {0.2f, 0.5f, 0.8f}, {0.7f, 0.5f, 0.8f}, {0.7f, 0.5f, 0.2f}, 0);
  addQuad(s, {0.2f, 0.5f, 0.2f}, {0.7f, 0.5f, 0.2f}, {0.7f, 0.5f, 0.8f}, {0.2f, 0.5f, 0.8f}, 0);
  addQuad(s, {0.1f, 0, 0.1f}, {0.1f, 0, 0.6f}, {0.55f, 0, 0.6f}, {0.55f, 0, 0.1f}, 0);
  const Scene ball = sphericalCap(std::numbers::pi, 6, 8);
  for (const Triangle& t : ball.triangles) {
    const auto at = [&](int k) { return ball.positions[t.v[static_cast<size_t>(k)]] * 0.15f + Vec3{0.7f, 0.8f, 0.7f}; };
    addTriangle(s, at(0), at(2), at(1), 0);  // seen from outside
  }
  return s;
}

bool comesThrough(const PatchShape::Facet& facet, const Ray& ray) {
  const Point origin = pointOf(ray.origin), direction = pointOf(ray.direction);
  const double towards = -dot(direction, facet.normal), height = dot(origin - facet.corner[0], facet.normal);
  if (!(towards > 0 && height > 0)) return false;
  const Point at = origin + direction * (height / towards);
  for (size_t i = 0; i < facet.corners; ++i)
    if (dot(cross(facet.corner[(i + 1) % facet.corners] - facet.corner[i], at - facet.corner[i]), facet.normal) < 0) return false;
  return true;
}

TEST(RayFan, CountsTheRaysTowardsEachPatchThatAllRaysTriedOneByOneDo) {
  const Scene scene = crowded();
  const auto caster = RayCaster::create(scene);
  const auto set = makePatches(scene, {.cell_m = 0.25f}, &*caster);
  ASSERT_TRUE(set);
  constexpr uint32_t kRays = 512;
  const SobolTable sobol(kRays);
  std::vector<Ray> rays(kRays);
  std::vector<Hit> hits(kRays);
  std::vector<uint32_t> met(kRays);
  uint64_t hidden = 0, seen = 0, few = 0;
  for (uint32_t i = 0; i < set->patches.size(); ++i) {
    patchRays(scene, *set, i, sobol, 1, *caster, rays);
    caster->nearest(std::span<const Ray>(rays), hits);
    for (size_t k = 0; k < kRays; ++k) {
      met[k] = hits[k].triangle == kNone ? kNone : set->patchAt(hits[k].triangle, hits[k].front, hits[k].point);
      if (met[k] >= set->patches.size()) met[k] = kNone;
    }
    RayFan fan;
    fan.assign(shapeOf(*set, i), set->patches[i].normal, rays, met);
    for (uint32_t j = 0; j < set->patches.size(); ++j) {
      if (i == j) continue;
      const PatchShape shape = shapeOf(*set, j);
      std::array<uint32_t, 2> there{}, towards{};
      for (size_t k = 0; k < kRays; ++k) {
        uint32_t times = 0;
        for (const PatchShape::Facet& f : shape.facets) times += comesThrough(f, rays[k]);
        there[k >= kRays / 2] += met[k] == j;
        towards[k >= kRays / 2] += met[k] == j ? std::max(times, 1u) : times;
      }
      const RayFan::Share share = fan.towards(j, shape, 0);
      EXPECT_EQ(share.there, there) << i << ", " << j;
      // A ray along an edge may be in or out by rounding of its origin.
      for (size_t half = 0; half < 2; ++half) EXPECT_NEAR(share.towards[half], towards[half], 1) << i << ", " << j;
      hidden += towards[0] + towards[1] - there[0] - there[1];
      seen += there[0] + there[1];
      // Of many rays some tell that nothing is in the way.
      const RayFan::Share some = fan.towards(j, shape, towards[0] + towards[1]);
      EXPECT_LE(some.expected, towards[0] + towards[1]);
      if (some.expected < towards[0] + towards[1]) EXPECT_TRUE(some.all() && some.isLikely());
      else EXPECT_EQ(some.towards, share.towards);
      few += some.expected < towards[0] + towards[1];
    }
  }
  EXPECT_GT(hidden, seen / 10);
  EXPECT_GT(few, 4u);
}

// Pooled rows of few rays, against those of 256 times as many that are only counted: how far exchange areas are off.
TEST(Unoccluded, TimesTheShareThatIsSeenIsWhatManyRaysCount) {
  const CastScene few = cast(crowded(), 0.25f, 256, 3), many = cast(crowded(), 0.25f, 65535, 1);
  std::vector<float> areas;
  for (const Patch& p : few.set.patches) areas.push_back(p.area_m2);
  const PooledPatches told(few.rows, areas), by_count(counts(few.rows), areas), truth(counts(many.rows), areas);
  double told_square = 0, counted_square = 0, bias = 0, all = 0;
  ExchangeRow row;
  for (uint32_t i = 0; i < truth.nodes(); ++i) {
    const auto dense = [&](const PooledPatches& pooled) {
      std::vector<double> area_m2(truth.nodes());
      pooled.row(i, row);
      for (size_t k = 0; k < row.column.size(); ++k) area_m2[row.column[k]] = row.area_m2[k];
      return area_m2;
    };
    const std::vector<double> t = dense(told), c = dense(by_count), x = dense(truth);
    for (size_t j = 0; j < t.size(); ++j) {
      told_square += (t[j] - x[j]) * (t[j] - x[j]);
      counted_square += (c[j] - x[j]) * (c[j] - x[j]);
      bias += t[j] - x[j];
      all += x[j];
    }
  }
  EXPECT_LT(told_square, counted_square / 4);
  EXPECT_NEAR(bias / all, 0, 0.005);
  std::cout << "square errors " << told_square / counted_square << " of those of counts, bias " << bias / all << "\n";
}

}  // namespace
}  // namespace ff::bake::test
