#include "runtime/cut/cut_fade.h"

#include <cmath>
#include <map>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/updater.h"
#include "tests/runtime/solver/ease_cases.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

const stream::SyntheticSettings kWorld{.side = 64, .tile_nodes = 40, .seed = 2};

const auto kCpuSolvers = testing::Values(EaseCase{"Gather", 64, [] { return makeCpuGather(2); }}, EaseCase{"Multibounce", 16, [] {
  return std::unique_ptr<Solver>(makeDenseSolver(std::move(*makeCpuMultibounce({.places = 512})), {}));
}});
INSTANTIATE_TEST_SUITE_P(Cpu, Ease, kCpuSolvers, [](const auto& each) { return each.param.name; });

TEST(LightPace, IsLooserBeyondWhatIsNearAndLeavesNothingToWhoArrives) {
  const std::vector<float> radii_m{10, 13, 17};
  const auto at = [](float x) { return Box{{x, -1, -1}, {x + 4, 1, 1}}; };
  LightPace pace{.observers = stream::Observer{{}, {60, 0, 0}}, .radii_m = radii_m, .frame_seconds = 1.0f / 60, .most_change = 0.02f};
  EXPECT_NEAR(pace.of(0, at(20)).loosened, 1, 1e-5f);
  EXPECT_NEAR(pace.of(0, at(40)).loosened, 8, 1e-4f);
  EXPECT_NEAR(pace.of(0, at(57)).due, 1 / 50.0f, 1e-4f);  // 1 m a frame, and 50 are left until it is at hand
  EXPECT_NEAR(pace.of(0, at(17)).due, 1 / 36.0f, 1e-4f);
  EXPECT_NEAR(pace.of(0, at(7)).due, 1 / 36.0f, 1e-4f);
  EXPECT_EQ(pace.of(0, at(-30)).due, 0) << "behind";
  EXPECT_EQ(pace.of(1, at(1)).due, 0) << "finer ones will be there";
  EXPECT_NEAR(pace.of(2, at(1)).loosened, 1, 1e-5f);
  const auto aside = [](float x, float y) { return Box{{x, y - 1, -1}, {x + 4, y + 1, 1}}; };
  EXPECT_NEAR(pace.of(0, aside(57, 7)).due, 1 / 50.0f, 1e-4f);
  EXPECT_EQ(pace.of(0, aside(57, 9)).due, 0) << "who flies past it is never there";
  const stream::Observer several[] = {{{}, {60, 0, 0}}, {{57, 9, 90}, {0, 0, -120}}};
  pace.observers = std::span<const stream::Observer>(several);
  EXPECT_NEAR(pace.of(0, aside(57, 9)).due, 1 / 41.0f, 1e-4f);  // 2 m a frame, and 82 are left
  pace.observers = stream::Observer{{}, {}};
  EXPECT_EQ(pace.of(0, at(17)).due, 0) << "at rest";
  EXPECT_NEAR(pace.of(0, at(5)).due, 1 / 36.0f, 1e-4f);
}

TEST(CutFade, LightFollowsAndTilesAreWantedByTheWayOfTheFastestObserver) {
  constexpr float kFrame_s = 1.0f / 60;
  const std::vector<float> radii_m{16, 20};
  CutFade fade({.frames = 8}, radii_m);
  const auto at = [](float speed) { return stream::Observer{{}, {0, 0, speed}}; };
  EXPECT_NEAR(fade.begin(at(60), kFrame_s), 64.0f / 60, 1e-5f);
  EXPECT_NEAR(fade.begin(at(40), kFrame_s), 1.4f, 1e-5f);
  EXPECT_NEAR(fade.begin(at(30), kFrame_s), 1.4f, 1e-5f);
  EXPECT_EQ(fade.easeFrames(), 8u);  // of 4 m
  EXPECT_NEAR(fade.begin(at(5), kFrame_s), 41.6f / 5, 1e-5f);
  EXPECT_EQ(fade.easeFrames(), 48u);
  EXPECT_NEAR(fade.begin(at(600), kFrame_s), 1.2f * 8 * kFrame_s, 1e-5f);  // the frames that light takes are more than that way
  EXPECT_EQ(fade.easeFrames(), 8u);
  (void)fade.begin(at(0), kFrame_s);
  EXPECT_EQ(fade.easeFrames(), 120u);
  const stream::Observer several[] = {at(0), at(5), at(1)};
  EXPECT_NEAR(fade.begin(stream::Observers(several), kFrame_s), 41.6f / 5, 1e-5f);
  EXPECT_EQ(fade.easeFrames(), 48u);
  CutFade at_once({.frames = 0}, radii_m), slower({.frames = 300}, radii_m);
  EXPECT_EQ(at_once.begin(at(5), kFrame_s), 0);
  EXPECT_EQ(at_once.easeFrames(), 0u);
  (void)slower.begin(at(0), kFrame_s);
  EXPECT_EQ(slower.easeFrames(), 300u);
}

TEST(CutFade, LightMayFollowFasterWhileSomebodyTurns) {
  const std::vector<float> radii_m{16, 20};
  CutFade fade({.frames = 8, .most_change = 0.02f}, radii_m);
  const auto limited = [&](Vec3 velocity, int frames) {
    const stream::Observer observer{{}, velocity};
    for (int frame = 0; frame < frames; ++frame) (void)fade.begin(observer, 1.0f / 60);
    return fade.pace(observer, 1.0f / 60).most_change < 0.03f;
  };
  EXPECT_TRUE(limited({}, 1));
  EXPECT_TRUE(limited({0, 0, 30}, 1)) << "sets out";
  EXPECT_TRUE(limited({0, 0, 30}, 60));
  EXPECT_TRUE(limited({5, 0, 30}, 1));
  EXPECT_FALSE(limited({30, 0, 0}, 1));
  EXPECT_FALSE(limited({30, 0, 0}, 20));
  EXPECT_TRUE(limited({30, 0, 0}, 20));
  EXPECT_FALSE(limited({-30, 0, 0}, 1));
  EXPECT_TRUE(limited({}, 1)) << "stands still";
}

// Flies along a line, everything there in time.
struct Flight {
  Flight(const TestWorld& world, const FadeSettings& fade)
      : test(world),
        streamer(std::move(*stream::Streamer::create(world.world(), {.radius_m = 8, .hysteresis = 1.0f}))),
        solver(makeCpuGather(1)),
        updater(world.world(), *streamer, *solver, FarLight::kPyramid, false, fade) {
    EXPECT_TRUE(updater.setSky({.l0 = {1, 2, 3}, .l1 = {}, .l2 = {}}));
  }
  void frame(Vec3 at) {
    streamer->update(at, {});
    EXPECT_TRUE(streamer->settle());
    EXPECT_TRUE(updater.frame(at, {}, 2));
  }
  // Irradiance by patch, W/m2 of one channel: what the node that stands for it shows.
  std::vector<float> shown() {
    const LocalMatrix& m = updater.matrix();
    std::vector<Vec4> light(m.slots());
    EXPECT_TRUE(updater.reflected(light));
    updater.fade().blend(m, light);
    std::vector<float> patches(test.world().levels()[0].nodes);
    for (uint32_t p = 0; p < patches.size(); ++p) {
      uint32_t level = 0, node = p, slot = m.slotOf(level, node);
      for (; slot == kNoSlot; slot = m.slotOf(level, node)) node = test.world().parent(level++, node);
      patches[p] = light[slot].y / m.albedo[slot].y;
    }
    return patches;
  }
  const TestWorld& test;
  // What tiles show of their own.
  std::map<formats::TileId, float> weights() const {
    std::map<formats::TileId, float> own;
    std::vector<shaders::FadingSlots> fading;
    const LocalMatrix& m = updater.matrix();
    updater.fade().fadingSlots(m, fading);
    for (const SlotRange& range : m.tiles) own[range.id] = 1;
    for (const shaders::FadingSlots& slots : fading) own[std::ranges::find(m.tiles, slots.first_slot, &SlotRange::first_slot)->id] = slots.own;
    return own;
  }
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<Solver> solver;
  Updater updater;
};

TEST(CutFade, LightOfFixedPatchesDoesNotJumpAlongAFlightAndRestsWhereItWouldWithoutFading) {
  const TestWorld test(kWorld);
  float worst[2] = {};
  std::vector<float> end[2];
  for (const bool fades : {false, true}) {
    Flight flight(test, {.frames = fades ? 20u : 0u});
    std::vector<float> last;
    size_t most_tiles = 0;
    for (float x = 5; x < 58; x += 0.25f) {
      flight.frame({x, 1, 30});
      const std::vector<float> now = flight.shown();
      for (size_t p = 0; p < last.size(); ++p) worst[fades] = std::max(worst[fades], std::abs(now[p] - last[p]));
      if (x > 6) last = now;  // the first frames wait for the first light
      most_tiles = std::max(most_tiles, flight.updater.matrix().tiles.size() - flight.streamer->active().size());
    }
    EXPECT_EQ(most_tiles > 0, fades) << "tiles that stay while they fade out";
    for (int frame = 0; frame < 700; ++frame) flight.frame({58, 1, 30});
    EXPECT_EQ(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
    end[fades] = flight.shown();
  }
  EXPECT_LT(worst[1], 0.25f * worst[0]);
  ASSERT_EQ(end[0].size(), end[1].size());
  for (size_t p = 0; p < end[0].size(); ++p) ASSERT_NEAR(end[1][p], end[0][p], 1e-4f * (1 + end[0][p]));
}

// By the way of the observer alone, whatever it takes in frames; and all of it where a tile is at hand.
TEST(CutFade, TilesShowMoreOfTheirOwnWithEachStepTowardsThemAndLessWithEachStepAway) {
  const TestWorld test(kWorld);
  constexpr uint32_t kFrames = 3;
  constexpr float kRadius_m = 8;
  Flight slow(test, {.frames = kFrames}), fast(test, {.frames = kFrames});
  size_t between = 0, compared = 0;
  std::map<formats::TileId, float> before, away_before, slope;  // slope: of a weight, by the fifth power of the distance
  size_t even = 0;
  for (int step = 0; step < 200; ++step) {
    const Vec3 at{10 + 0.2f * static_cast<float>(step), 1, 30};
    slow.frame(at);
    if (step % 2 == 0) fast.frame(at);
    const auto now = slow.weights(), now_fast = fast.weights();
    for (const auto& [id, weight] : now) {
      if (id.level != 0 || step == 0) continue;
      const float away_m = test.world().tiles(0)[id.tile].bounds.distance(at), step_weight = before.contains(id) ? weight - before[id] : 0;
      ASSERT_LE(std::abs(step_weight), 1.0f / kFrames + 1e-5f);
      if (away_m < 0.8f * kRadius_m - 0.2f * kFrames) {
        ASSERT_EQ(weight, 1) << step << ": a tile at " << away_m << " m";
      }
      between += weight > 0 && weight < 1;
      const float nearer_m = away_before.contains(id) ? away_before[id] - away_m : 0;
      if (nearer_m > 0.1f && before.contains(id) && before[id] > 0 && weight < 1 && step_weight > 0.02f) {  // on its way in, and neither as fast nor as slowly as may be
        const float now_slope = step_weight / (std::pow(away_before[id], 5.0f) - std::pow(away_m, 5.0f));
        if (slope.contains(id)) {
          ASSERT_NEAR(now_slope, slope[id], 0.03f * slope[id]) << step << ": what is near changes more slowly, as it is seen larger";
          ++even;
        } else {
          slope[id] = now_slope;
        }
      }
      away_before[id] = away_m;
      if (step % 2 != 0 || !now_fast.contains(id)) continue;
      ASSERT_NEAR(now_fast.at(id), weight, 0.25f) << step << ": the same way in half of the frames";
      ++compared;
    }
    before = now;
  }
  EXPECT_GT(between, 200u);
  EXPECT_GT(even, 50u);
  EXPECT_GT(compared, 1000u);
  for (int frame = 0; frame < 490; ++frame) slow.frame({49.8f, 1, 30});  // and at rest it ends, too
  for (const auto& [id, weight] : slow.weights()) ASSERT_EQ(weight, 1);
  EXPECT_EQ(slow.updater.fade().easeFrames(), 120u) << "nothing has come late, and nobody says how fast he is";
  EXPECT_EQ(slow.updater.matrix().tiles.size(), slow.streamer->active().size());
}

TEST(CutFade, TilesThatLeaveHaveGoneAfterAWayThatGrowsAsTheRootOfTheirRadius) {
  const TestWorld test(kWorld);
  constexpr float kStep_m = 0.2f;
  Flight flight(test, {.frames = 3});
  std::map<formats::TileId, float> left_at_m, gone_at_m;  // how far the observer was
  for (float x = 2; x < 62; x += kStep_m) {
    const Vec3 at{x, 1, 30};
    flight.frame(at);
    for (const auto& [id, weight] : flight.weights()) {
      const float away_m = test.world().tiles(id.level)[id.tile].bounds.distance(at);
      const bool active = std::ranges::any_of(flight.streamer->active(), [&](const stream::StripPtr& strip) { return strip->id == id; });
      if (active && weight == 1) left_at_m[id] = away_m;
      if (!active && left_at_m.contains(id)) gone_at_m[id] = away_m;
    }
  }
  std::map<uint32_t, float> longest_m;  // by level
  for (const auto& [id, away_m] : gone_at_m) longest_m[id.level] = std::max(longest_m[id.level], away_m - left_at_m[id]);
  ASSERT_GE(longest_m.size(), 3u);
  for (const auto& [level, way_m] : longest_m) {
    const float expected_m = 2 * std::sqrt(8 * flight.streamer->radii()[level]);
    EXPECT_LE(way_m, expected_m + 3 * kStep_m) << "level " << level;
    if (level < 2) {  // the world ends before coarser ones have gone
      EXPECT_GE(way_m, expected_m - 3 * kStep_m) << "level " << level;
    }
  }
}

TEST(CutFade, WhatComesLateOrIsWaitedForShowsItsOwnAtOnce) {
  const TestWorld test(kWorld);
  Flight flight(test, {.frames = 4});
  flight.frame({10, 1, 30});
  std::vector<shaders::FadingSlots> fading;
  flight.updater.fade().fadingSlots(flight.updater.matrix(), fading);
  EXPECT_TRUE(fading.empty()) << "the first frame waits";
  flight.frame({17, 1, 30});  // not so far that it counts as a jump
  const LocalMatrix& m = flight.updater.matrix();
  flight.updater.fade().fadingSlots(m, fading);
  EXPECT_FALSE(fading.empty());
  EXPECT_EQ(flight.updater.fade().easeFrames(), 4u) << "light, too";
  for (int frame = 1; frame < 4; ++frame) flight.frame({17, 1, 30});
  flight.updater.fade().fadingSlots(m, fading);
  for (const shaders::FadingSlots& slots : fading) {
    const SlotRange& range = *std::ranges::find(m.tiles, slots.first_slot, &SlotRange::first_slot);
    EXPECT_GE(test.world().tiles(range.id.level)[range.id.tile].bounds.distance({17, 1, 30}), 0.9f * flight.streamer->radii()[range.id.level]);
  }
}

TEST(CutFade, WhatLeavesAfterAFrameThatHasWaitedFadesAsEver) {
  const TestWorld test(kWorld);
  Flight flight(test, {.frames = 4});
  flight.frame({25, 1, 30});  // the first one: it waits, and comes from nowhere
  EXPECT_EQ(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
  flight.frame({32, 1, 30});
  EXPECT_GT(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
}

TEST(CutFade, WaitingForTheCutEndsAllFadesAndWhatIsTooMuchLeavesAtOnce) {
  const TestWorld test(kWorld);
  Flight flight(test, {.frames = 50}), narrow(test, {.frames = 50, .max_nodes = 100});
  size_t leaving = 0;
  for (float x = 10; x < 40; x += 0.5f)
    for (Flight* f : {&flight, &narrow}) {
      f->frame({x, 1, 30});
      size_t nodes = 0;
      for (const SlotRange& range : f->updater.matrix().tiles)
        if (std::ranges::none_of(f->streamer->active(), [&](const stream::StripPtr& strip) { return strip->id == range.id; })) nodes += range.nodes;
      if (f == &narrow) {
        ASSERT_LE(nodes, 100u);
      }
      leaving = std::max(leaving, nodes);
    }
  EXPECT_GT(leaving, 100u);
  // Where there is no room for many, those that show least go faster than the observer.
  const auto fastest = [](Flight& f) {
    float most = 0;
    std::map<formats::TileId, float> before;
    for (int step = 0; step < 120; ++step) {
      f.frame({39.5f + 0.02f * static_cast<float>(step), 1, 30});
      std::map<formats::TileId, float> now = f.weights();
      for (const auto& [id, weight] : now)
        if (step > 60 && before.contains(id)) most = std::max(most, before[id] - weight);
      before = std::move(now);
    }
    return most;
  };
  EXPECT_GT(fastest(narrow), 1.0f / 100);
  EXPECT_LT(fastest(flight), 1.0f / 150);
  flight.updater.awaitCut();
  flight.frame({42, 1, 30});
  EXPECT_EQ(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
  std::vector<Vec4> light(flight.updater.matrix().slots());
  ASSERT_TRUE(flight.updater.reflected(light));
  const std::vector<Vec4> before = light;
  flight.updater.fade().blend(flight.updater.matrix(), light);
  for (size_t s = 0; s < light.size(); ++s) ASSERT_EQ(light[s].y, before[s].y);
}

}  // namespace
}  // namespace ff::runtime
