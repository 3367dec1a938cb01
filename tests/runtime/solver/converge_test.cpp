#include "runtime/solver/converge.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

namespace ff::runtime {
namespace {

// One slot whose distance to 1 W/m2 halves with each of iterate()'s steps, and is a thousandth after any approach().
class Halving final : public Solver {
 public:
  explicit Halving(float start = 0) : value_(start) {}
  Result<void> update(const LocalMatrix&, const MatrixChange&) override { return {}; }
  bool resolvesRows() const override { return false; }
  Result<void> setSource(std::span<const Vec4>) override { return {}; }
  Result<void> setRadiosity(std::span<const Vec4>) override { return {}; }
  Result<void> iterate(int k) override {
    iterated += k;
    for (int i = 0; i < k; ++i) value_ = 1 + (value_ - 1) / 2;
    return {};
  }
  Result<void> approach(int k) override {
    approached += k;
    value_ = 1 + (value_ - 1) / 1000;
    return {};
  }
  Result<void> radiosity(std::span<Vec4> out) override {
    if (reads_left == 0) return Error{ErrorCode::kIo, "", "device", "lost", ""};
    --reads_left;
    out[0] = {value_, 0, 0, 0};
    return {};
  }
  double lastMs() const override { return 0; }
  const char* name() const override { return "halving"; }

  int iterated = 0, approached = 0, reads_left = 1000;

 private:
  float value_;
};

Result<Settled> run(Halving& solver, const Convergence& until, std::array<Vec4, 1>& last) {
  std::array<Vec4, 1> before{};
  return converge(solver, until, last, before);
}

TEST(Converge, ApproachesAndLooksAtOneStepMoreUntilThatChangesNothing) {
  Halving solver;
  std::array<Vec4, 1> last{};
  const auto done = run(solver, {.tolerance = 1e-5f}, last);
  ASSERT_TRUE(done);
  // 1e-3, halved: a change of 5e-4. Then 5e-7, and 2.5e-7.
  EXPECT_EQ(done->iterations, 16);
  EXPECT_TRUE(done->settled);
  EXPECT_NEAR(done->change, 2.5e-7, 1e-7);  // of values near 1, whose rounding is 6e-8
  EXPECT_EQ(solver.iterated, 2);
  EXPECT_EQ(solver.approached, 14);
  EXPECT_NEAR(last[0].x, 1, 1e-6);
}

TEST(Converge, TakesAtLeastTheFewestAndAtMostWhatIsAllowed) {
  Halving two;
  std::array<Vec4, 1> last{};
  EXPECT_EQ(run(two, {.tolerance = 1, .fewest = 2}, last)->iterations, 2);
  EXPECT_EQ(two.approached, 1);
  Halving never;
  const auto undone = run(never, {.tolerance = -1, .max_iterations = 100}, last);
  EXPECT_EQ(undone->iterations, 100);
  EXPECT_FALSE(undone->settled);
  EXPECT_EQ(never.iterated + never.approached, 100);
}

TEST(Converge, SaysHowFarTheLightIsFromSettledWhereItStops) {
  Halving solver;
  std::array<Vec4, 1> last{};
  const auto done = run(solver, {.tolerance = 1e-9f, .max_iterations = 8}, last);
  ASSERT_TRUE(done);
  EXPECT_FALSE(done->settled);
  EXPECT_NEAR(done->change, 5e-4, 1e-6);  // from 1 - 1e-3, halved, over 1 - 5e-4
}

TEST(Converge, LightThatIsNotFiniteIsNotSettledAndStopsAtOnce) {
  Halving solver(std::numeric_limits<float>::infinity());
  std::array<Vec4, 1> last{};
  const auto done = run(solver, {}, last);
  EXPECT_EQ(done->iterations, 8);
  EXPECT_FALSE(done->settled);
  EXPECT_EQ(done->change, std::numeric_limits<double>::infinity());
}

TEST(Converge, PassesOnWhatTheSolverSays) {
  Halving solver;
  solver.reads_left = 1;
  std::array<Vec4, 1> last{};
  const auto done = run(solver, {}, last);
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().message, "lost");
}

}  // namespace
}  // namespace ff::runtime
