#include "runtime/cut/cut_fade.h"

#include <cmath>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/updater.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

const stream::SyntheticSettings kWorld{.side = 64, .tile_nodes = 40, .seed = 2};
constexpr uint32_t kFrames = 10;

// What a slot reflects without a bounce, by node: the same in every cut.
std::vector<Vec4> sourceOf(const LocalMatrix& m, float scale = 1) {
  std::vector<Vec4> source(m.slots());
  for (const SlotRange& range : m.tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint32_t node = range.first_node + i;
      source[range.first_slot + i] = m.albedo[range.first_slot + i] * Vec4{scale * static_cast<float>(node * 7 % 11), scale, scale * static_cast<float>(node % 5), 0};
    }
  return source;
}

std::vector<Vec4> lightOf(Solver& solver, const LocalMatrix& m) {
  std::vector<Vec4> light(m.slots());
  EXPECT_TRUE(solver.radiosity(light));
  return light;
}

float distance(const Vec4& a, const Vec4& b) { return std::max({std::abs(a.x - b.x), std::abs(a.y - b.y), std::abs(a.z - b.z)}); }

// Settles on one cut, then takes up another.
struct CutChange {
  CutChange(const TestWorld& test, uint32_t frames) : assembler(test.world()), solver(makeCpuGather(2)) {
    EXPECT_TRUE(assembler.update(test.randomCut(0.5, 1)));
    EXPECT_TRUE(solver->update(assembler.matrix(), assembler.change()));
    EXPECT_TRUE(solver->setSource(sourceOf(assembler.matrix())));
    EXPECT_TRUE(solver->iterate(300));
    before_tiles = assembler.matrix().tiles;
    before = lightOf(*solver, assembler.matrix());
    solver->ease(frames);
    EXPECT_TRUE(assembler.update(test.randomCut(0.7, 4)));
    EXPECT_TRUE(solver->update(assembler.matrix(), assembler.change()));
    EXPECT_TRUE(solver->setSource(sourceOf(assembler.matrix())));
  }
  const LocalMatrix& matrix() const { return assembler.matrix(); }
  std::vector<Vec4> light() { return lightOf(*solver, matrix()); }
  // The largest change of irradiance since before of a leaf: its own, or where it is new its nearest ancestor's of then.
  float largestChange(const std::vector<Vec4>& now, const TestWorld& test) const {
    float largest = 0;
    for (const SlotRange& range : matrix().tiles)
      for (uint32_t i = 0; i < range.nodes; ++i) {
        const uint32_t slot = range.first_slot + i;
        if (!matrix().leaf[slot]) continue;
        uint32_t level = range.id.level, node = range.first_node + i, old = slotOf(before_tiles, level, node);
        for (; old == kNoSlot; old = slotOf(before_tiles, level, node)) node = test.world().parent(level++, node);
        const Vec3 from = test.node(level, node).albedo, to = test.node(range.id.level, range.first_node + i).albedo;
        const Vec4 &b = now[slot], &was = before[old];
        largest = std::max({largest, std::abs(b.x / to.x - was.x / from.x), std::abs(b.y / to.y - was.y / from.y), std::abs(b.z / to.z - was.z / from.z)});
      }
    return largest;
  }
  MatrixAssembler assembler;
  std::unique_ptr<Solver> solver;
  std::vector<SlotRange> before_tiles;
  std::vector<Vec4> before;
};

TEST(Ease, LightFollowsAChangeOfTheCutEvenlyAndEndsWhereItWouldHaveBeenAtOnce) {
  const TestWorld test(kWorld);
  CutChange eased(test, kFrames), at_once(test, 0);
  ASSERT_TRUE(at_once.solver->iterate(300));
  const std::vector<Vec4> end = at_once.light();
  const float whole = at_once.largestChange(end, test);
  float last = 0;
  for (uint32_t frame = 1; frame <= kFrames; ++frame) {
    ASSERT_TRUE(eased.solver->iterate(2));
    const float changed = eased.largestChange(eased.light(), test);
    EXPECT_LT(changed - last, 2.0f * whole / kFrames) << "frame " << frame;  // what bounces comes on top of what is let go
    last = changed;
  }
  EXPECT_GT(last, 0.5f * whole);
  ASSERT_TRUE(eased.solver->iterate(300));
  const std::vector<Vec4> light = eased.light();
  for (const uint32_t slot : eased.matrix().leaves) ASSERT_LT(distance(light[slot], end[slot]), 1e-4f * (1 + end[slot].x + end[slot].y + end[slot].z));
}

TEST(Ease, AChangeOfSourcesIsNotHeldBack) {
  const TestWorld test(kWorld);
  std::vector<std::vector<Vec4>> light;
  for (const uint32_t frames : {0u, kFrames})
    for (const float scale : {1.0f, 3.0f}) {
      CutChange change(test, frames);  // the light changes in the same frame as the cut
      ASSERT_TRUE(change.solver->setSource(sourceOf(change.matrix(), scale)));
      ASSERT_TRUE(change.solver->iterate(3));
      light.push_back(change.light());
    }
  const CutChange cut(test, 0);
  for (const uint32_t slot : cut.matrix().leaves) {  // light adds up: what it does beside a cut that is eased in is what it does alone
    const Vec4 minus{-1, -1, -1, 0};
    const Vec4 at_once = light[1][slot] + light[0][slot] * minus, eased = light[3][slot] + light[2][slot] * minus;
    ASSERT_LT(distance(at_once, eased), 1e-4f * (1 + at_once.x + at_once.y + at_once.z));
  }
}

TEST(Ease, NoughtLetsAllGoNow) {
  const TestWorld test(kWorld);
  CutChange eased(test, kFrames), at_once(test, 0);
  ASSERT_TRUE(eased.solver->iterate(1));
  eased.solver->ease(0);
  for (CutChange* change : {&eased, &at_once}) ASSERT_TRUE(change->solver->iterate(300));
  const std::vector<Vec4> a = eased.light(), b = at_once.light();
  for (const uint32_t slot : eased.matrix().leaves) ASSERT_LT(distance(a[slot], b[slot]), 1e-4f * (1 + b[slot].x + b[slot].y + b[slot].z));
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

}  // namespace
}  // namespace ff::runtime
