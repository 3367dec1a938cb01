#include "runtime/cut/cut_fade.h"

#include <cmath>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/updater.h"
#include "tests/runtime/solver/ease_cases.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

const stream::SyntheticSettings kWorld{.side = 64, .tile_nodes = 40, .seed = 2};

INSTANTIATE_TEST_SUITE_P(Cpu, Ease, testing::Values(EaseCase{"Gather", 64, [] { return makeCpuGather(2); }}, EaseCase{"Multibounce", 16, [] {
  return std::unique_ptr<Solver>(makeDenseSolver(std::move(*makeCpuMultibounce({.places = 512})), {}));
}}), [](const auto& each) { return each.param.name; });

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
    for (int frame = 0; frame < 400; ++frame) flight.frame({58, 1, 30});
    EXPECT_EQ(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
    end[fades] = flight.shown();
  }
  EXPECT_LT(worst[1], 0.25f * worst[0]);
  ASSERT_EQ(end[0].size(), end[1].size());
  for (size_t p = 0; p < end[0].size(); ++p) ASSERT_NEAR(end[1][p], end[0][p], 1e-4f * (1 + end[0][p]));
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
  flight.updater.awaitCut();
  flight.frame({40, 1, 30});
  EXPECT_EQ(flight.updater.matrix().tiles.size(), flight.streamer->active().size());
  std::vector<Vec4> light(flight.updater.matrix().slots());
  ASSERT_TRUE(flight.updater.reflected(light));
  const std::vector<Vec4> before = light;
  flight.updater.fade().blend(flight.updater.matrix(), light);
  for (size_t s = 0; s < light.size(); ++s) ASSERT_EQ(light[s].y, before[s].y);
}

TEST(CutFade, TakesAsLongUnderALightThatHasChangedAsIfItHadAlwaysBeenSo) {
  const TestWorld test(kWorld);
  Flight always(test, {.frames = 1}), now(test, {.frames = 1});
  const auto spots = [](float light) {  // one node of three is lit, and of their parents all
    return [light](formats::TileId id, std::span<Vec3> irradiance) {
      for (size_t i = 0; i < irradiance.size(); ++i) irradiance[i] = id.level > 0 ? Vec3{light, light, light} : i % 3 == 0 ? Vec3{3 * light, 3 * light, 3 * light} : Vec3{};
    };
  };
  for (Flight* f : {&always, &now}) {  // no other light, which would count for less
    EXPECT_TRUE(f->updater.setSky({}));
    for (uint32_t group = 0; group < test.world().info().lamp_groups.size(); ++group) EXPECT_TRUE(f->updater.setLamp(group, {}));
  }
  always.updater.setDirectLight(spots(1));
  now.updater.setDirectLight(spots(1024));
  size_t most_tiles = 0;
  for (float x = 10; x < 58; x += 0.5f) {
    if (x == 36) now.updater.setDirectLight(spots(1));
    for (Flight* f : {&always, &now}) f->frame({x, 1, 30});
    if (x < 36) continue;
    ASSERT_EQ(now.updater.matrix().tiles.size(), always.updater.matrix().tiles.size()) << x;
    most_tiles = std::max(most_tiles, now.updater.matrix().tiles.size() - now.streamer->active().size());
  }
  EXPECT_GT(most_tiles, 0u);
}

}  // namespace
}  // namespace ff::runtime
