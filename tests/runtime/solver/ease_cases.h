// How light follows a change of the cut, whoever solves it: include this and instantiate Ease with solvers.
#pragma once
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/solver/solver.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {

constexpr uint32_t kEaseFrames = 10;

struct EaseCase {
  std::string name;  // letters and digits
  uint32_t side;     // of the world
  std::function<std::unique_ptr<Solver>()> make;             // null: there is no device
  std::function<std::vector<std::string>()> complaints = {};  // of validation layers, since the start
  friend void PrintTo(const EaseCase& c, std::ostream* out) { *out << c.name; }
};

// What a slot reflects without a bounce, by node: the same in every cut.
inline std::vector<Vec4> sourceOf(const LocalMatrix& m, float scale = 1) {
  std::vector<Vec4> source(m.slots());
  for (const SlotRange& range : m.tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint64_t node = range.first_node + i;
      source[range.first_slot + i] = m.albedo[range.first_slot + i] * Vec4{scale * static_cast<float>(node * 7 % 11), scale, scale * static_cast<float>(node % 5), 0};
    }
  return source;
}

inline std::vector<Vec4> lightOf(Solver& solver, const LocalMatrix& m) {
  std::vector<Vec4> light(m.slots());
  EXPECT_TRUE(solver.radiosity(light));
  return light;
}

inline float distance(const Vec4& a, const Vec4& b) { return std::max({std::abs(a.x - b.x), std::abs(a.y - b.y), std::abs(a.z - b.z)}); }

// Settles on one cut, then takes up another.
struct CutChange {
  CutChange(const EaseCase& of, const TestWorld& test, uint32_t frames) : assembler(test.world()), solver(of.make()) {
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
        uint64_t node = range.first_node + i;
        uint32_t level = range.id.level, old = slotOf(before_tiles, level, node);
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

inline const std::vector<float> kPaceRadii_m(12, 200.0f);

// Who stands at that distance from a world: all of it is near, and nobody will be there soon.
inline LightPace paceOf(float most_change) {
  return {.observers = stream::Observer{{-300, 0, 32}, {}}, .radii_m = kPaceRadii_m, .frame_seconds = 1.0f / 60, .most_change = most_change};
}

inline float meanOf(const LocalMatrix& m, const std::vector<Vec4>& light) {
  double sum = 0, area_m2 = 0;
  for (const uint32_t s : m.leaves) {
    sum += static_cast<double>(m.area_m2[s] * (light[s].x + light[s].y + light[s].z) / 3);
    area_m2 += static_cast<double>(m.area_m2[s]);
  }
  return static_cast<float>(sum / area_m2);
}

class Ease : public testing::TestWithParam<EaseCase> {
 protected:
  void SetUp() override {
    if (!GetParam().make()) GTEST_SKIP() << "no Vulkan device with validation layers, nothing was tested";
  }
  void TearDown() override {
    if (!GetParam().complaints) return;
    for (const std::string& message : GetParam().complaints()) ADD_FAILURE() << message;
  }
  stream::SyntheticSettings world() const { return {.side = GetParam().side, .tile_nodes = 40, .seed = 2}; }
};

TEST_P(Ease, LightFollowsAChangeOfTheCutEvenlyAndEndsWhereItWouldHaveBeenAtOnce) {
  const TestWorld test(world());
  CutChange eased(GetParam(), test, kEaseFrames), at_once(GetParam(), test, 0);
  ASSERT_TRUE(at_once.solver->iterate(300));
  const std::vector<Vec4> end = at_once.light();
  const float whole = at_once.largestChange(end, test);
  float last = 0;
  for (uint32_t frame = 1; frame <= kEaseFrames; ++frame) {
    ASSERT_TRUE(eased.solver->iterate(2));
    const float changed = eased.largestChange(eased.light(), test);
    EXPECT_LT(changed - last, 2.0f * whole / kEaseFrames) << "frame " << frame;  // what bounces comes on top of what is let go
    last = changed;
  }
  EXPECT_GT(last, 0.5f * whole);
  ASSERT_TRUE(eased.solver->iterate(300));
  const std::vector<Vec4> light = eased.light();
  for (const uint32_t slot : eased.matrix().leaves) ASSERT_LT(distance(light[slot], end[slot]), 1e-4f * (1 + end[slot].x + end[slot].y + end[slot].z));
}

// An observer who walked runs: light is held for long no more.
TEST_P(Ease, WhatIsHeldTakesNoLongerThanTheNextChangeDoes) {
  const TestWorld test(world());
  CutChange slow(GetParam(), test, 100 * kEaseFrames), at_once(GetParam(), test, 0);
  for (CutChange* change : {&slow, &at_once}) {
    ASSERT_TRUE(change->solver->iterate(2));
    if (change == &slow) change->solver->ease(kEaseFrames);
    ASSERT_TRUE(change->assembler.update(test.randomCut(0.6, 5)));
    ASSERT_TRUE(change->solver->update(change->matrix(), change->assembler.change()));
    ASSERT_TRUE(change->solver->setSource(sourceOf(change->matrix())));
    for (uint32_t frame = 0; frame < kEaseFrames; ++frame) ASSERT_TRUE(change->solver->iterate(2));
    ASSERT_TRUE(change->solver->iterate(300));
  }
  const std::vector<Vec4> light = slow.light(), end = at_once.light();
  for (const uint32_t slot : slow.matrix().leaves) ASSERT_LT(distance(light[slot], end[slot]), 1e-4f * (1 + end[slot].x + end[slot].y + end[slot].z));
}

// A walk of many changes, some of them while others are held back: what rows have changed may be known, or be found out by looking at all.
TEST_P(Ease, WhatIsHeldIsTheSameWhetherOrNotItIsKnownWhichRowsHaveChanged) {
  const TestWorld test(world());
  CutChange known(GetParam(), test, kEaseFrames), unknown(GetParam(), test, kEaseFrames);
  size_t changed_leaves = 0, leaves = 0;
  for (uint64_t step = 0; step < 12; ++step) {
    for (CutChange* change : {&known, &unknown}) {
      ASSERT_TRUE(change->solver->iterate(step % 3 == 0 ? 2 : 1));
      change->solver->ease(step == 7 ? kEaseFrames / 2 : kEaseFrames);
      ASSERT_TRUE(change->assembler.update(test.randomCut(step % 2 == 0 ? 0.7 : 0.6, 4 + step % 2)));
      if (change == &unknown) const_cast<LocalMatrix&>(change->matrix()).changed_leaves.clear();
      changed_leaves += change->matrix().changed_leaves.size();
      leaves += change->matrix().leaves.size();
      ASSERT_TRUE(change->solver->update(change->matrix(), change->assembler.change()));
      ASSERT_TRUE(change->solver->setSource(sourceOf(change->matrix())));
      ASSERT_TRUE(change->solver->iterate(1));
    }
    const std::vector<Vec4> light = known.light(), right = unknown.light();
    for (const uint32_t slot : known.matrix().leaves) ASSERT_LT(distance(light[slot], right[slot]), 1e-4f * (1 + right[slot].x + right[slot].y + right[slot].z)) << "step " << step;
  }
  EXPECT_GT(changed_leaves, 0u);
  EXPECT_LT(changed_leaves, leaves);
}

TEST_P(Ease, AChangeOfSourcesIsNotHeldBack) {
  const TestWorld test(world());
  std::vector<std::vector<Vec4>> light;
  for (const uint32_t frames : {0u, kEaseFrames})
    for (const float scale : {1.0f, 3.0f}) {
      CutChange change(GetParam(), test, frames);  // the light changes in the same frame as the cut
      ASSERT_TRUE(change.solver->setSource(sourceOf(change.matrix(), scale)));
      ASSERT_TRUE(change.solver->iterate(3));
      light.push_back(change.light());
    }
  const CutChange cut(GetParam(), test, 0);
  for (const uint32_t slot : cut.matrix().leaves) {  // light adds up: what it does beside a cut that is eased in is what it does alone
    const Vec4 minus{-1, -1, -1, 0};
    const Vec4 at_once = light[1][slot] + light[0][slot] * minus, eased = light[3][slot] + light[2][slot] * minus;
    ASSERT_LT(distance(at_once, eased), 1e-4f * (1 + at_once.x + at_once.y + at_once.z));
  }
}

// However a new cut's sources are given, light is the same, to the bit.
TEST_P(Ease, SourcesOfWhatEnteredAreAsGoodAsAll) {
  const TestWorld test(world());
  enum Way { kAll, kEntered, kEnteredWhichStay };
  std::vector<std::vector<Vec4>> light;
  for (const Way way : {kAll, kEntered, kEnteredWhichStay}) {
    std::vector<Vec4> source;
    CutChange walk(GetParam(), test, kEaseFrames);
    for (uint64_t step = 0; step < 6; ++step) {
      ASSERT_TRUE(walk.solver->iterate(2));
      ASSERT_TRUE(walk.assembler.update(test.randomCut(0.5 + 0.1 * static_cast<double>(step % 3), 10 + step)));
      const MatrixChange& change = walk.assembler.change();
      ASSERT_FALSE(change.renumbered);
      ASSERT_TRUE(walk.solver->update(walk.matrix(), change));
      source = sourceOf(walk.matrix());
      ASSERT_TRUE(way == kAll ? walk.solver->setSource(source) : walk.solver->setEnteredSource(source, change, way == kEnteredWhichStay));
      if (way == kEntered) std::ranges::fill(source, Vec4{1, 1, 1, 0});
    }
    ASSERT_TRUE(walk.solver->iterate(3));
    light.push_back(walk.light());
    for (uint32_t slot = 0; slot < walk.matrix().slots(); ++slot) {
      if (!walk.matrix().leaf[slot]) light.back()[slot] = {};
    }
  }
  for (const Way way : {kEntered, kEnteredWhichStay}) {
    ASSERT_EQ(light[way].size(), light[kAll].size());
    for (size_t slot = 0; slot < light[kAll].size(); ++slot) ASSERT_EQ(distance(light[kAll][slot], light[way][slot]), 0);
  }
}

TEST_P(Ease, LightFollowsByNoMoreInAFrameThanItMayAndEndsWhereItWouldHaveBeenAtOnce) {
  const TestWorld test(world());
  constexpr uint32_t kFrames = 4;
  constexpr float kMost = 0.05f;
  CutChange paced(GetParam(), test, kFrames), free(GetParam(), test, kFrames), at_once(GetParam(), test, 0);
  ASSERT_TRUE(at_once.solver->iterate(300));
  const std::vector<Vec4> end = at_once.light();
  const float mean = meanOf(at_once.matrix(), end);
  float largest[2] = {};
  for (CutChange* change : {&paced, &free}) {
    if (change == &paced) change->solver->pace(paceOf(kMost));
    ASSERT_TRUE(change->solver->iterate(1));
    std::vector<Vec4> last = change->light();
    for (uint32_t frame = 1; frame < 2 * kFrames; ++frame) {
      ASSERT_TRUE(change->solver->iterate(1));
      const std::vector<Vec4> now = change->light();
      for (const uint32_t s : change->matrix().leaves) largest[change == &free] = std::max(largest[change == &free], distance(now[s], last[s]));
      last = now;
    }
  }
  EXPECT_LT(largest[0], 2 * kMost * mean);  // what bounces comes on top
  EXPECT_GT(largest[1], 3 * kMost * mean);
  std::vector<Vec4> light = paced.light();
  float left = 0;
  for (const uint32_t s : paced.matrix().leaves) left = std::max(left, distance(light[s], end[s]));
  EXPECT_GT(left, kMost * mean) << "it takes longer than it would";
  for (int frame = 0; frame < 500; ++frame) ASSERT_TRUE(paced.solver->iterate(1));
  light = paced.light();
  for (const uint32_t s : paced.matrix().leaves) ASSERT_LT(distance(light[s], end[s]), 1e-4f * (1 + end[s].x + end[s].y + end[s].z));
}

TEST_P(Ease, NoughtLetsAllGoNow) {
  const TestWorld test(world());
  CutChange eased(GetParam(), test, kEaseFrames), at_once(GetParam(), test, 0);
  ASSERT_TRUE(eased.solver->iterate(1));
  eased.solver->ease(0);
  for (CutChange* change : {&eased, &at_once}) ASSERT_TRUE(change->solver->iterate(300));
  const std::vector<Vec4> a = eased.light(), b = at_once.light();
  for (const uint32_t slot : eased.matrix().leaves) ASSERT_LT(distance(a[slot], b[slot]), 1e-4f * (1 + b[slot].x + b[slot].y + b[slot].z));
}

}  // namespace ff::runtime
