// The experiments behind ffchart's stability page, small.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numeric>

#include "tools/chart/stability/parts.h"
#include "tools/chart/stability/walk_matrix.h"

namespace ff::chart {
namespace {

using walks::SceneKind;
using walks::WalkKind;

const Measured& find(const std::vector<Measured>& all, const std::string& method) {
  for (const Measured& m : all)
    if (m.method == method) return m;
  throw std::runtime_error("no method " + method);
}

double most(const Measured& m) {
  double x = 0;
  for (const Measured::Point& p : m.points) x = std::max(x, p.error);
  return x;
}

Measured made(std::vector<Measured::Point> points) {
  return {.scene = "", .method = "", .knob = "swaps", .unit = "", .points = std::move(points), .then = ""};
}

TEST(BreakingPoint, IsTheFirstNumberPastTheLimitFromEasyToHard) {
  const Measured m = made({{100, 0.001}, {1000, 0.02}, {2000, 0.009}, {12345, 0.06}, {20000, INFINITY}});
  EXPECT_EQ(passes(m, 0.01), "1,000");
  EXPECT_EQ(passes(m, 0.05), "12,345");
  EXPECT_EQ(notFinite(m), "20,000");
  EXPECT_EQ(worst(m), "not finite");
  const Measured holds = made({{100, 0.001}, {100000, 0.002}});
  EXPECT_EQ(passes(holds, 0.01), "never to 100,000");
  EXPECT_EQ(notFinite(holds), "never to 100,000");
  EXPECT_EQ(worst(holds), "0.2 %");
  const Measured lost = made({{1, std::numeric_limits<double>::quiet_NaN()}});
  EXPECT_EQ(passes(lost, 0.01), "1");
  EXPECT_EQ(notFinite(lost), "1");
  EXPECT_EQ(worst(lost), "not finite");
}

TEST(BreakingPoint, IsNamedWithItsUnitAlsoWhereTheKnobIsTurnedDown) {
  Measured m = made({{16, 0.001}, {8, 0.02}, {0.5, 0.2}});
  m.unit = "m";
  EXPECT_EQ(passes(m, 0.01), "8 m");
  EXPECT_EQ(passes(m, 0.05), "0.5 m");
  EXPECT_EQ(passes(m, 0.5), "never to 0.5 m");
}

TEST(BreakingPoint, DrawsALineUpToWhereItLeavesTheChart) {
  const Series series = seriesOf(made({{1, 0}, {2, 0.5}, {4, INFINITY}, {8, 1}}), "seed");
  ASSERT_EQ(series.points.size(), 3u);
  EXPECT_EQ(series.points[0].y, kLeastDrawn);
  EXPECT_EQ(series.points[1].y, 0.5);
  EXPECT_EQ(series.points[2].y, kMaxDrawn);
  EXPECT_NE(series.points[2].hover.find("not finite"), std::string::npos) << series.points[2].hover;
}

TEST(WalkMatrix, KeepsRowSumsWhenItCountsAndLosesNoEntry) {
  for (const SceneKind kind : {SceneKind::kCorridor, SceneKind::kClosedBox, SceneKind::kEnclosures}) {
    const auto rows = walks::makeRows({.kind = kind, .patches = 128, .entries_per_row = 30});
    const auto counted = quantised(rows);
    for (size_t i = 0; i < rows.size(); ++i) {
      ASSERT_EQ(rows[i].size(), counted[i].size());
      double sum = 0, kept = 0;
      for (size_t k = 0; k < rows[i].size(); ++k) {
        sum += static_cast<double>(rows[i][k].second);
        kept += static_cast<double>(counted[i][k].second);
        EXPECT_GE(counted[i][k].second, 1.0f / kWalkQuanta);
      }
      EXPECT_NEAR(sum, kept, 0.51 / kWalkQuanta) << i;
    }
  }
}

// Two ways to one answer: elimination and Gauss-Seidel.
TEST(WalkMatrix, EliminationAndIterationAgree) {
  const walks::SceneRows set = quantisedScene({.patches = 60, .entries_per_row = 20});
  const std::vector<runtime::Vec4> light = walks::randomLight(60, 3);
  std::vector<uint32_t> present(40);
  std::iota(present.begin(), present.end(), 10u);
  const std::vector<walks::Rgb> direct = exactReflected(set, present, light);
  walks::Placement at(set, 40);
  (void)at.enter(present);
  std::vector<runtime::Vec4> source(40);
  for (const uint32_t p : present) source[at.place(p)] = light[p];
  const std::vector<walks::Rgb> e = exactIrradiance(at, source);
  for (const uint32_t p : present)
    EXPECT_NEAR(direct[p][1], static_cast<double>(set.albedo[p].y) * e[at.place(p)][1], 1e-11) << p;
}

// fp32 is a few hundred operations of 2^-24; the seed leaves paths behind with every patch that goes.
TEST(Stability, ASwapCostsTheSeedAccuracyAndTheExactMatrixNone) {
  const auto walked = measureWalk(
      {"oscillation", {.patches = 160, .entries_per_row = 30}, WalkKind::kOscillation, 64, 16, 400, 400}, 1);
  ASSERT_TRUE(walked) << walked.error().line();
  ASSERT_EQ(walked->size(), 5u);
  EXPECT_GT(most(find(*walked, "seed")), 0.05);
  EXPECT_LT(most(find(*walked, "multibounce fp32")), 5e-6);
  EXPECT_LT(most(find(*walked, "multibounce fp16")), 2e-3);
  EXPECT_LT(most(find(*walked, "dense solver, fp32")), 5e-6);
  for (const Measured& m : *walked) EXPECT_EQ(m.points.back().at, 400) << m.method;
}

TEST(Stability, AWalkIsTheSameWhateverTheThreads) {
  const WalkCase walk{"box",
                      {.kind = SceneKind::kClosedBox, .patches = 64, .entries_per_row = 20, .albedo = 0.98f},
                      WalkKind::kRandom,
                      64,
                      16,
                      128,
                      64};
  const auto one = measureWalk(walk, 1), two = measureWalk(walk, 2);
  ASSERT_TRUE(one && two);
  for (size_t m = 0; m < one->size(); ++m) {
    EXPECT_EQ((*one)[m].then, (*two)[m].then);
    ASSERT_EQ((*one)[m].points.size(), (*two)[m].points.size());
    for (size_t p = 0; p < (*one)[m].points.size(); ++p)
      EXPECT_EQ((*one)[m].points[p].error, (*two)[m].points[p].error) << (*one)[m].method << ", point " << p;
  }
}

TEST(Stability, SaysThatAMatrixIsRefusedWhereItCannotCarryTheLight) {
  const auto walked =
      measureWalk({"white box",
                   {.kind = SceneKind::kClosedBox, .patches = 96, .entries_per_row = 40, .albedo = 0.9999f},
                   WalkKind::kRandom,
                   96,
                   32,
                   256,
                   0},
                  1);
  ASSERT_TRUE(walked) << walked.error().line();
  const Measured& fp16 = find(*walked, "multibounce fp16");
  EXPECT_TRUE(fp16.then.find("refused") != std::string::npos || fp16.then.find("lowers albedos") != std::string::npos)
      << fp16.then;
  EXPECT_GT(most(find(*walked, "multibounce fp32")), 0.01) << "lowered albedos cost energy";
}

TEST(Stability, NoLightGetsIntoAClosedRoomHoweverLargeThePatches) {
  const auto part = stabilityOfLeaks({.quick = true}, {});
  ASSERT_TRUE(part) << part.error().line();
  const Measured& patches = part->measured[0];
  for (const Measured::Point& p : patches.points) EXPECT_EQ(p.error, 0) << p.at << " m";
  const Measured& clusters = part->measured[1];
  EXPECT_EQ(clusters.points.front().error, 0) << "level 0";
  EXPECT_GT(clusters.points.back().error, 0.01) << "the coarsest level mixes rooms";
}

}  // namespace
}  // namespace ff::chart
