// Light that changes, in a room with a window to the sky.
#include "tools/chart/sweep/temporal.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/support/analytic_scenes.h"
#include "tests/tools/chart/chart_world.h"

namespace ff::chart {
namespace {

// A room of 4 x 3 x 4 m with a lamp on its floor; half of its ceiling is open.
bake::Scene roomWithLamp() {
  bake::Scene s;
  s.name = "room";
  const uint32_t wall = bake::test::addMaterial(s, {0.8f, 0.7f, 0.6f}), lamp = bake::test::addMaterial(s, {}, {20, 18, 15});
  const auto quad = [&](Vec3 a, Vec3 b, Vec3 c, Vec3 d, uint32_t m) { bake::test::addQuad(s, a, b, c, d, m); };
  quad({0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, wall);
  quad({0, 3, 0}, {2, 3, 0}, {2, 3, 4}, {0, 3, 4}, wall);
  quad({0, 0, 0}, {0, 3, 0}, {0, 3, 4}, {0, 0, 4}, wall);
  quad({4, 0, 0}, {4, 0, 4}, {4, 3, 4}, {4, 3, 0}, wall);
  quad({0, 0, 0}, {4, 0, 0}, {4, 3, 0}, {0, 3, 0}, wall);
  quad({0, 0, 4}, {0, 3, 4}, {4, 3, 4}, {4, 0, 4}, wall);
  quad({0.5f, 0.1f, 0.5f}, {0.5f, 0.1f, 1.5f}, {1.5f, 0.1f, 1.5f}, {1.5f, 0.1f, 0.5f}, lamp);
  return s;
}

class TemporalInARoom : public InABakedScene {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(open(roomWithLamp(), 0.5f, 256));
    options_.standard.radius_m = 6;
    options_.quick = true;
  }

  TemporalOptions options_;
  const Place place_{{2, 1.5f, 2}, {}, 5};
  const Lighting sun_{.name = "sun and sky", .sky = {{1, 1.2f, 1.5f}, {}}, .to_sun = normalized({-0.5f, 1, 0.1f}),
                      .sun = {12, 11, 9}, .lamps = 0};
  const Lighting lamps_{.name = "lamps", .sky = {}, .sun = {}, .lamps = 1};
};

TEST_F(TemporalInARoom, LightAfterASwitchSettlesTheFasterTheMoreStepsAFrameTakes) {
  const auto t = measureTemporal(*world_, place_, sun_, lamps_, options_);
  ASSERT_TRUE(t) << t.error().line();
  ASSERT_EQ(t->followers.size(), 5u);
  for (const Follower& f : t->followers) {
    ASSERT_EQ(f.switched.size(), 32u) << f.name;
    EXPECT_GT(f.relight_ms.value, 0);
    EXPECT_LT(f.switched.back(), 0.003) << f.name;
    for (size_t i = 1; i < f.switched.size(); ++i) EXPECT_LE(f.switched[i], f.switched[i - 1] + 1e-5) << f.name << " " << i;
  }
  // k steps are k steps, however they are cut into frames.
  const auto &one = t->followers[0].switched, &two = t->followers[1].switched, &eight = t->followers[3].switched;
  EXPECT_GT(one[0], 0.1);
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_NEAR(two[i], one[2 * i + 1], 1e-4 + 1e-3 * two[i]);
    EXPECT_NEAR(eight[i], one[8 * i + 7], 1e-4 + 1e-3 * eight[i]);
  }
  // All patches sit on places of the dense matrix: one frame is enough.
  EXPECT_LT(t->followers[4].switched[0], 1e-3);
}

TEST_F(TemporalInARoom, SunAndLampsBothLagTheLessTheMoreStepsAFrameTakes) {
  Lighting both = sun_;
  both.name = "both";
  both.lamps = 1;
  const auto t = measureTemporal(*world_, place_, lamps_, both, options_);
  ASSERT_TRUE(t) << t.error().line();
  for (const Follower& f : t->followers) ASSERT_EQ(f.lag.size(), 2u);
  for (const size_t l : {0, 1}) {
    for (size_t m = 1; m < 4; ++m)
      EXPECT_LT(t->followers[m].lag[l].rel_l2.value, t->followers[m - 1].lag[l].rel_l2.value) << t->followers[m].name;
    EXPECT_LT(t->followers[4].lag[l].rel_l2.value, t->followers[0].lag[l].rel_l2.value);
  }
  EXPECT_EQ(t->followers[0].lag[0].light, "moving sun, 1 degree a frame (lag)");
  ASSERT_EQ(t->charts.size(), 4u);
  for (const Chart& c : t->charts) EXPECT_EQ(c.series.size(), 5u) << c.id;
  EXPECT_EQ(t->charts[2].series[0].points.size(), 8u) << "quick: eight positions of the sun";
  ASSERT_EQ(t->table.rows.size(), 5u);
  for (const auto& row : t->table.rows) EXPECT_EQ(row.size(), t->table.columns.size());
  // A degree is little light, a lamp's 70 % is much.
  EXPECT_GT(t->followers[0].lag[0].rel_l2.value, 0);
  EXPECT_GT(t->followers[0].lag[1].rel_l2.value, t->followers[0].lag[0].rel_l2.value);
}

TEST_F(TemporalInARoom, WithoutASunNothingMoves) {
  Lighting half = lamps_;
  half.name = "half the lamps";
  half.lamps = 0.5f;
  const auto t = measureTemporal(*world_, place_, half, lamps_, options_);
  ASSERT_TRUE(t) << t.error().line();
  ASSERT_EQ(t->charts.size(), 3u);
  ASSERT_EQ(t->followers[0].lag.size(), 1u);
  // From a half to the whole: what the lamps light is there at once, what it bounces lags by half. (Of the cut's solution; the
  // full solve is of the same rows but for what lies outside, and here all of it lies inside.)
  const auto lit = world_->lit(lamps_, options_.standard.shadow_rays, nullptr);
  ASSERT_TRUE(lit) << lit.error().line();
  double bounced = 0, all = 0;
  for (size_t i = 0; i < (*lit)->full.size(); ++i) {
    const auto area = static_cast<double>(world_->patches()[i / 3].area_m2);
    bounced += area * ((*lit)->full[i] - (*lit)->source[i]) * ((*lit)->full[i] - (*lit)->source[i]);
    all += area * (*lit)->full[i] * (*lit)->full[i];
  }
  EXPECT_NEAR(t->followers[0].switched[0], 0.5 * std::sqrt(bounced / all), 1e-3);
}

TEST_F(TemporalInARoom, BlackLightAndEmptyPlacesAreRefused) {
  const Lighting none{.name = "none", .sky = {}, .sun = {}};
  const auto black = measureTemporal(*world_, place_, sun_, none, options_);
  ASSERT_FALSE(black);
  EXPECT_EQ(black.error().code, ErrorCode::kUsage);
  EXPECT_NE(black.error().line().find("none"), std::string::npos);
  const auto empty = measureTemporal(*world_, {{200, 0, 0}, {}, 1}, sun_, lamps_, options_);
  ASSERT_FALSE(empty);
  EXPECT_EQ(empty.error().code, ErrorCode::kUsage);
}

}  // namespace
}  // namespace ff::chart
