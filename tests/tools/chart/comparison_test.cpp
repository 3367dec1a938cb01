// Errors over patches and places, on numbers made by hand.
#include "tools/chart/sweep/comparison.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/tools/chart/chart_world.h"
#include "tools/chart/outside.h"
#include "tools/chart/scene_of_model.h"
#include "tools/scene/analytic.h"

namespace ff::chart {
namespace {

// A small world whose patches differ in size, and light that a test fills in. Values of patch k: base + k.
class ComparisonOfPlaces : public InABakedScene {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::furnaceBox(0.5f, 2)), 0.4f, 16));
    world_->lookAt(std::vector<Place>{{{0.5f, 0.5f, 0.5f}, {}, 10}}, 100000);
    ASSERT_EQ(world_->lookedAt().size(), world_->patches().size());
    light_.full.assign(3 * world_->patches().size(), 0);
    light_.traced.resize(world_->patches().size());
    for (PatchTruth& t : light_.traced) t.reflected = {2, 2, 2};
  }
  static std::vector<double> repeated(size_t patches, double value) { return std::vector<double>(3 * patches, value); }
  double areaOf(std::span<const uint32_t> numbers) const {
    double area = 0;
    for (const uint32_t n : numbers) area += static_cast<double>(world_->patches()[world_->lookedAt()[n]].area_m2);
    return area;
  }

  LitWorld light_;
};

TEST_F(ComparisonOfPlaces, TenPercentMoreLightIsTenPercentOfErrorAndEnergy) {
  Comparison c;
  const auto numbers = world_->ofPlace(0);
  c.addPlace(*world_, light_, numbers, repeated(numbers.size(), 2.2));
  const Accuracy a = c.accuracy("light");
  EXPECT_EQ(a.light, "light");
  EXPECT_NEAR(a.rel_l2.value, 0.1, 1e-6);
  EXPECT_NEAR(a.energy.value, 0.1, 1e-6);
  EXPECT_NEAR(a.median.value, 0.1, 1e-6);
  EXPECT_NEAR(a.p99.value, 0.1, 1e-6);
  EXPECT_TRUE(std::isnan(a.rel_l2.error)) << "one place says nothing about its error";
}

TEST_F(ComparisonOfPlaces, PatchesCountByTheirArea) {
  const auto numbers = world_->ofPlace(0);
  std::vector<uint32_t> large;
  float largest = 0, smallest = 1e9f;
  for (const formats::Node& n : world_->patches()) largest = std::max(largest, n.area_m2), smallest = std::min(smallest, n.area_m2);
  ASSERT_GT(largest, 2 * smallest);
  std::vector<double> got;
  for (const uint32_t n : numbers) {
    const bool wrong = world_->patches()[world_->lookedAt()[n]].area_m2 > 0.9f * largest;
    if (wrong) large.push_back(n);
    got.insert(got.end(), 3, wrong ? 3.0 : 2.0);
  }
  Comparison c;
  c.addPlace(*world_, light_, numbers, got);
  EXPECT_NEAR(c.accuracy("").rel_l2.value, 0.5 * std::sqrt(areaOf(large) / areaOf(numbers)), 1e-6);
  EXPECT_NEAR(c.accuracy("").energy.value, 0.5 * areaOf(large) / areaOf(numbers), 1e-6);
}

// The tracer's variance is in the squares of the differences and of the truth alike.
TEST_F(ComparisonOfPlaces, TheTracersNoiseIsTakenOff) {
  for (PatchTruth& t : light_.traced) t.error = {0.3f, 0.3f, 0.3f};
  const auto numbers = world_->ofPlace(0);
  const double noise = static_cast<double>(0.3f);
  Comparison exact, off;
  exact.addPlace(*world_, light_, numbers, repeated(numbers.size(), 2 + noise));
  EXPECT_NEAR(exact.accuracy("").rel_l2.value, 0, 1e-6);
  off.addPlace(*world_, light_, numbers, repeated(numbers.size(), 2 + 0.5));
  EXPECT_NEAR(off.accuracy("").rel_l2.value, std::sqrt((0.25 - noise * noise) / (4 - noise * noise)), 1e-6);
  EXPECT_NEAR(off.tracerNoise(), noise / std::sqrt(4 - noise * noise), 1e-6);
}

TEST_F(ComparisonOfPlaces, BuriedPatchesTakeNoPart) {
  const auto numbers = world_->ofPlace(0);
  std::vector<double> got = repeated(numbers.size(), 2.2);
  for (const size_t k : {size_t{3}, size_t{8}}) {
    light_.traced[numbers[k]].buried = true;
    light_.traced[numbers[k]].reflected = {};
    for (size_t c = 0; c < 3; ++c) got[3 * k + c] = 1000;
  }
  Comparison c;
  c.addPlace(*world_, light_, numbers, got);
  EXPECT_NEAR(c.accuracy("").rel_l2.value, 0.1, 1e-6);
  EXPECT_NEAR(c.accuracy("").p99.value, 0.1, 1e-6);
  EXPECT_NEAR(c.accuracy("").energy.value, 0.1, 1e-6);
}

TEST_F(ComparisonOfPlaces, TheFullSolveIsCompared) {
  light_.full.assign(light_.full.size(), 2.5);
  const auto numbers = world_->ofPlace(0);
  Comparison c;
  c.addPlace(*world_, light_, numbers, repeated(numbers.size(), 2.0));
  EXPECT_NEAR(c.accuracy("").full_solve_rel_l2.value, 0.5 / 2.5, 1e-6);
  EXPECT_NEAR(c.fullSolveAgainstTraced().value, 0.25, 1e-6);
  EXPECT_NEAR(c.accuracy("").rel_l2.value, 0, 1e-6);
}

// A black room's error is over the mean truth, not over its own.
TEST_F(ComparisonOfPlaces, DarkPatchesAreJudgedByTheMean) {
  const auto numbers = world_->ofPlace(0);
  std::vector<double> got = repeated(numbers.size(), 2.0);
  double bright = 0;
  for (size_t k = 0; k < numbers.size(); ++k) {
    if (k % 2 == 0) {
      light_.traced[numbers[k]].reflected = {};
      for (size_t c = 0; c < 3; ++c) got[3 * k + c] = 0.1;
    } else {
      bright += 1;
    }
  }
  Comparison c;
  c.addPlace(*world_, light_, numbers, got);
  EXPECT_NEAR(c.accuracy("").p99.value, 0.1 / (2 * bright / static_cast<double>(numbers.size())), 1e-6);
  EXPECT_NEAR(c.accuracy("").median.value, 0.1, 0.011) << "half of the patches are exact, the rank lies between";
}

// Leaving one of two out gives 0.2 and 0.1: sqrt(1/2 (0.05^2 + 0.05^2)) = 0.05.
TEST(RelativeNorm, HasTheJackknifesError) {
  const std::vector<double> wrong{1, 4}, truth{100, 100}, even{4, 4, 4}, one{100, 100, 100};
  EXPECT_NEAR(relativeNorm(wrong, truth).value, std::sqrt(5.0 / 200), 1e-12);
  EXPECT_NEAR(relativeNorm(wrong, truth).error, 0.05, 1e-12);
  EXPECT_NEAR(relativeNorm(even, one).value, 0.2, 1e-12);
  EXPECT_NEAR(relativeNorm(even, one).error, 0, 1e-8);
}

TEST(RelativeNorm, KeepsWhatIsNotFiniteAndTakesNoiseBelowZeroAsZero) {
  const double infinity = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(std::isfinite(relativeNorm(std::vector<double>{1, infinity}, std::vector<double>{1, 1}).value));
  EXPECT_TRUE(std::isnan(relativeNorm(std::vector<double>{}, std::vector<double>{}).value));
  EXPECT_EQ(relativeNorm(std::vector<double>{-1, 0.5}, std::vector<double>{1, 1}).value, 0);
}

// Patches 0 to 4 at x = their number; 1 and 2 are active, a coarse node is not.
TEST(Outside, HasADistanceAndAMeanByArea) {
  std::vector<formats::Node> nodes(5);
  for (size_t i = 0; i < nodes.size(); ++i) nodes[i].centroid = {static_cast<float>(i), 0, 0};
  std::vector<runtime::SlotRange> tiles(2);
  tiles[0].id = {0, 0};
  tiles[0].first_node = 1;
  tiles[0].nodes = 2;
  tiles[1].id = {1, 0};
  tiles[1].first_node = 0;
  tiles[1].nodes = 5;
  const Outside outside(nodes.size(), tiles);
  EXPECT_EQ(outside.distance({1.75f, 0, 0}, nodes), 1.25f);
  EXPECT_EQ(outside.distance({0.25f, 0, 0}, nodes), 0.25f);
  EXPECT_EQ(outside.distance({0, 0, 0}, std::span(nodes).subspan(1, 3), 1), 3) << "numbers from 1 on: 3 alone is outside";
  const std::vector<float> areas{1, 100, 100, 1, 2};
  std::vector<double> radiosity(15, 0);
  radiosity[3 * 0] = 4, radiosity[3 * 1] = 1000, radiosity[3 * 4 + 1] = 6;
  const runtime::Vec4 mean = outside.meanRadiosity(areas, radiosity);
  EXPECT_EQ(mean.x, 1);
  EXPECT_EQ(mean.y, 3);
  EXPECT_EQ(mean.z, 0);
  tiles[0].first_node = 0;
  tiles[0].nodes = 5;
  const Outside none(nodes.size(), tiles);
  EXPECT_EQ(none.distance({0, 0, 0}, nodes), 1e30f);
  EXPECT_EQ(none.meanRadiosity(areas, radiosity).x, 0);
}

TEST(MedianOf, IsTheMiddleWithHalfTheQuartileRange) {
  const Figure m = medianOf({5, 1, 3, 2, 4});
  EXPECT_EQ(m.value, 3);
  EXPECT_EQ(m.error, 1);
  EXPECT_TRUE(std::isnan(medianOf({}).value));
}

}  // namespace
}  // namespace ff::chart
