// Numbers that are no light, brought to a solver in every way there is: none may stay.
#pragma once
#include <functional>
#include <limits>

#include "runtime/solver/sound_light.h"
#include "tests/runtime/solver/solver_truth.h"

namespace ff::runtime {

inline constexpr float kBadNumbers[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                                        -std::numeric_limits<float>::infinity(), 3e38f};

inline std::vector<Vec4> soundRadiosity(Solver& solver, const LocalMatrix& m) {
  std::vector<Vec4> out(m.slots());
  EXPECT_TRUE(solver.radiosity(out));
  for (uint32_t s = 0; s < m.slots(); ++s) EXPECT_TRUE(isSound(out[s])) << solver.name() << ", slot " << s;
  return out;
}

// A slot of the source, then of the radiosity, is a bad number; once the light is right again, 300 steps leave what
// they leave to a solver that saw nothing of it. Light is positive and albedos are at most 0.9: 0.9^300 = 2e-14 of what
// there was, so rounding decides: `tolerance`, relative L2.
inline void expectBadNumbersLeaveNoTrace(const std::function<std::unique_ptr<Solver>()>& make, const LocalMatrix& m,
                                         double tolerance) {
  const std::vector<Vec4> source = randomSource(m, 2);
  const uint32_t slot = m.leaves[m.leaves.size() / 2];
  const auto clean = make();
  ASSERT_TRUE(setMatrix(*clean, m));
  ASSERT_TRUE(clean->setSource(source));
  ASSERT_TRUE(clean->iterate(300));
  EXPECT_EQ(clean->repaired(), 0u);
  const std::vector<Vec4> truth = soundRadiosity(*clean, m);
  for (const float bad : kBadNumbers) {
    const auto solver = make();
    ASSERT_TRUE(setMatrix(*solver, m));
    std::vector<Vec4> broken = source;
    broken[slot].y = bad;
    ASSERT_TRUE(solver->setSource(broken));
    ASSERT_TRUE(solver->iterate(2));
    EXPECT_GT(solver->repaired(), 0u) << bad;
    std::vector<Vec4> radiosity = soundRadiosity(*solver, m);
    ASSERT_TRUE(solver->approach(20));
    soundRadiosity(*solver, m);
    ASSERT_TRUE(solver->setSource(source));
    for (const uint32_t s : {slot, m.leaves.front(), m.leaves.back()}) radiosity[s] = {bad, bad, bad, bad};
    ASSERT_TRUE(solver->setRadiosity(radiosity));
    ASSERT_TRUE(solver->iterate(1));
    soundRadiosity(*solver, m);
    ASSERT_TRUE(solver->approach(20));
    soundRadiosity(*solver, m);
    const uint64_t repaired = solver->repaired();
    ASSERT_TRUE(solver->iterate(300));
    EXPECT_EQ(solver->repaired(), repaired) << "and nothing is found any more";
    EXPECT_LE(differenceOf(m, soundRadiosity(*solver, m), truth), tolerance) << solver->name() << " after " << bad;
  }
}

// What a step makes is looked at as well: with an albedo that is not finite, or one past all bounds, a slot goes on
// from its source and no other is corrupt.
inline void expectAStepKeepsNothingUnsound(const std::function<std::unique_ptr<Solver>()>& make, LocalMatrix m) {
  const std::vector<Vec4> source = randomSource(m, 2);
  const uint32_t slot = m.leaves[m.leaves.size() / 2];
  for (const float bad : kBadNumbers) {
    m.albedo[slot].y = bad;
    const auto solver = make();
    ASSERT_TRUE(setMatrix(*solver, m));
    ASSERT_TRUE(solver->setSource(source));
    for (int i = 0; i < 3; ++i) {
      ASSERT_TRUE(solver->iterate(1));
      const std::vector<Vec4> out = soundRadiosity(*solver, m);
      if (i == 0) continue;  // from darkness, nothing is reflected by the first
      EXPECT_EQ(out[slot].y, source[slot].y);
    }
    EXPECT_GT(solver->repaired(), 0u);
    ASSERT_TRUE(solver->approach(20));
    soundRadiosity(*solver, m);
  }
}

}  // namespace ff::runtime
