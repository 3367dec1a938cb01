#include "runtime/dense/dense_solver.h"

#include <cmath>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/dense/bounce_monitor.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "tests/runtime/solver/solver_truth.h"
#include "tests/runtime/test_world.h"
#include "tests/support/counted_memory.h"

namespace ff::runtime {
namespace {

double errorOf(DenseSolver& solver, const LocalMatrix& matrix, std::span<const Vec4> source) {
  std::vector<Vec4> out(matrix.slots());
  EXPECT_TRUE(solver.radiosity(out));
  return differenceOf(matrix, out, converged(matrix, source));
}

std::unique_ptr<BounceMatrix> bounces(uint32_t places, Storage storage = Storage::kFloat32, bool slice = false) {
  auto made = makeCpuMultibounce({.places = places, .storage = storage, .time_slice = slice, .threads = 2});
  if (!made) throw std::runtime_error(made.error().line());
  return std::move(*made);
}

constexpr double kRounding = 1e-5;  // fp32 sums of some hundred terms

TEST(DenseSolver, OneStepFromDarknessIsAllBouncesOnEveryCut) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false, .seed = seed});
    for (const double chance : {0.0, 0.4, 0.8, 1.0}) {
      MatrixAssembler assembler(test.world());
      ASSERT_TRUE(assembler.update(test.randomCut(chance, seed)));
      const LocalMatrix& m = assembler.matrix();
      const std::vector<Vec4> source = randomSource(m, seed);
      for (const bool correct : {true, false}) {
        const auto solver = makeDenseSolver(bounces(400), {.correct = correct, .threads = 2});
        ASSERT_TRUE(setMatrix(*solver, m));
        ASSERT_TRUE(solver->setSource(source));
        ASSERT_TRUE(solver->iterate(1));
        EXPECT_LE(errorOf(*solver, m, source), kRounding) << (correct ? "corrected" : "bare");
        EXPECT_EQ(solver->stats().waiting, 0u);
      }
    }
  }
}

// Without corrections: the matrix itself must be that of the cut, so entries among leaves that stay have not changed.
TEST(DenseSolver, AfterAnyWalkTheMatrixIsThatOfTheCut) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .equal_areas = false, .seed = 7});
  MatrixAssembler assembler(test.world());
  const auto solver = makeDenseSolver(bounces(1000), {.correct = false, .threads = 2});
  std::mt19937_64 random(3);
  for (int step = 0; step < 25; ++step) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.5 + static_cast<double>(random() % 5) / 10, random())));
    const auto updated = solver->update(assembler.matrix(), assembler.change());
    ASSERT_TRUE(updated) << updated.error().line();
    if (step % 6 != 0) continue;
    const std::vector<Vec4> source = randomSource(assembler.matrix(), 1);
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->iterate(1));
    ASSERT_LE(errorOf(*solver, assembler.matrix(), source), kRounding) << "step " << step;
  }
  EXPECT_GT(solver->stats().left, 1000u);
}

TEST(DenseSolver, KeepsItsNodesWhenSlotsAreGivenOutAnew) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 8});
  LocalMatrix m;
  const auto solver = makeDenseSolver(bounces(1000), {.correct = false, .threads = 2});
  for (const uint64_t seed : {1, 2, 3}) {
    auto built = buildLocalMatrix(test.world(), test.randomCut(0.9, seed));
    ASSERT_TRUE(built);
    m = std::move(*built);  // the same matrix to the solver, all slots new
    const uint64_t entered = solver->stats().entered;
    ASSERT_TRUE(solver->update(m, {.any = true, .renumbered = true}));
    if (seed > 1) {
      EXPECT_LT(solver->stats().entered - entered, m.leaves.size() / 2) << "all entered again";
    }
    const std::vector<Vec4> source = randomSource(m, 1);
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->iterate(1));
    ASSERT_LE(errorOf(*solver, m, source), kRounding);
  }
}

TEST(DenseSolver, WithMoreLeavesThanPlacesItConvergesNoSlowerThanGather) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .sky_share = 0.05, .albedo = 0.9f, .seed = 5});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(1, 5)));
  const LocalMatrix& m = assembler.matrix();
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  double before = 1;
  for (const uint32_t places : {1u, 100u, 400u, 1000u}) {
    const auto solver = makeDenseSolver(bounces(places), {.threads = 2});
    ASSERT_TRUE(setMatrix(*solver, m));
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->iterate(6));
    EXPECT_EQ(solver->stats().on_places, std::min<size_t>(places, m.leaves.size()));
    EXPECT_EQ(solver->stats().on_places + solver->stats().waiting, m.leaves.size());
    std::vector<Vec4> out(m.slots());
    ASSERT_TRUE(solver->radiosity(out));
    const double error = differenceOf(m, out, truth);
    EXPECT_LE(error, before) << places << " places";
    before = error * 1.0001;
    if (places > 1) continue;
    const auto gather = makeCpuGather(2);
    ASSERT_TRUE(setMatrix(*gather, m));
    ASSERT_TRUE(gather->setSource(source));
    ASSERT_TRUE(gather->iterate(7));  // from E = 0, a step of the dense solver starts with B = M
    ASSERT_TRUE(gather->radiosity(out));
    EXPECT_LE(error, differenceOf(m, out, truth) * 1.0001);
  }
  EXPECT_LE(before, 10 * kRounding);
  const auto strict = makeDenseSolver(bounces(100), {.correct = false, .threads = 2});
  const auto refused = setMatrix(*strict, m);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
}

TEST(DenseSolver, NodesThatEnterAFewBlocksAFrameAreRightAllTheWhile) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 6});
  MatrixAssembler assembler(test.world());
  const auto solver = makeDenseSolver(bounces(1000, Storage::kFloat32, true),
                                      {.blocks_per_frame = 1, .columns_per_frame = 50, .threads = 2});
  for (const uint64_t seed : {1, 2}) {
    ASSERT_TRUE(assembler.update(test.randomCut(1, seed)));
    ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
    const std::vector<Vec4> source = randomSource(assembler.matrix(), seed);
    ASSERT_TRUE(solver->setSource(source));
    double before = 1;
    for (int frame = 0; frame < 30; ++frame) {
      ASSERT_TRUE(solver->iterate(1));
      const double error = errorOf(*solver, assembler.matrix(), source);
      ASSERT_LE(error, std::max(before, kRounding));
      before = error;
    }
    EXPECT_EQ(solver->stats().waiting, 0u);
    EXPECT_LE(before, kRounding);
    EXPECT_EQ(solver->stats().rebuilds, 0u);
  }
}

TEST(DenseSolver, HalfPrecisionLeavesNoErrorOnceTheLightStands) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  MatrixAssembler assembler(test.world());
  const auto solver = makeDenseSolver(bounces(400, Storage::kFloat16), {.threads = 2});
  for (uint64_t step = 0; step < 20; ++step) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.8, step)));
    ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
  }
  const std::vector<Vec4> source = randomSource(assembler.matrix(), 1);
  ASSERT_TRUE(solver->setSource(source));
  ASSERT_TRUE(solver->iterate(1));
  EXPECT_LE(errorOf(*solver, assembler.matrix(), source), 2e-3);
  ASSERT_TRUE(solver->iterate(2));
  EXPECT_LE(errorOf(*solver, assembler.matrix(), source), kRounding);
}

TEST(DenseSolver, StartsNewNodesFromTheirParentsAndGoesOnFromWhatItIsGiven) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  MatrixAssembler assembler(test.world());
  const auto solver = makeDenseSolver(bounces(400), {.threads = 2});
  ASSERT_TRUE(assembler.update(test.randomCut(0, 1)));
  ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
  const std::vector<Vec4> coarse = randomSource(assembler.matrix(), 1);
  ASSERT_TRUE(solver->setSource(coarse));
  ASSERT_TRUE(solver->setRadiosity(coarse));
  std::vector<Vec4> out(assembler.matrix().slots());
  ASSERT_TRUE(solver->radiosity(out));
  for (const uint32_t s : assembler.matrix().leaves) ASSERT_EQ(out[s].y, coarse[s].y);
  ASSERT_TRUE(assembler.update(test.randomCut(1, 1)));
  const LocalMatrix& m = assembler.matrix();
  ASSERT_TRUE(solver->update(m, assembler.change()));
  out.resize(m.slots());
  ASSERT_TRUE(solver->radiosity(out));
  for (const uint32_t t : assembler.change().entered)
    for (uint32_t s = m.tiles[t].first_slot; s < m.tiles[t].first_slot + m.tiles[t].nodes; ++s)
      if (m.parent_slot[s] != kNoSlot) {
        ASSERT_EQ(out[s].y, out[m.parent_slot[s]].y);
      }
}

// A matrix that goes wrong in one of the ways that devices, drift or bugs might bring about; clear() makes it good.
class Faulty final : public BounceMatrix {
 public:
  enum class Fault { kNone, kTooBright, kNotFinite, kRefuses };
  explicit Faulty(std::unique_ptr<BounceMatrix> good) : good_(std::move(good)) {}
  Fault fault = Fault::kNone;
  bool stays = false;

  uint32_t capacity() const override { return good_->capacity(); }
  uint64_t bytes() const override { return good_->bytes(); }
  Result<void> insert(const EnteringBlock& block) override {
    if (fault == Fault::kRefuses) return Error{ErrorCode::kInvalidFile, "", "", "no room for light", ""};
    return good_->insert(block);
  }
  Result<void> remove(std::span<const uint32_t> places) override { return good_->remove(places); }
  Result<void> clear() override {
    if (!stays) fault = Fault::kNone;
    return good_->clear();
  }
  Result<uint32_t> advance(uint32_t columns) override { return good_->advance(columns); }
  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    auto lit = good_->relight(source, irradiance);
    spoil(irradiance);
    return lit;
  }
  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    auto lit = good_->relightChanged(places, difference, irradiance);
    spoil(irradiance);
    return lit;
  }
  BounceStats stats() const override { return good_->stats(); }
  const char* name() const override { return good_->name(); }

 private:
  void spoil(std::span<Vec4> irradiance) const {
    const float factor = fault == Fault::kTooBright ? 1.02f : fault == Fault::kNotFinite ? NAN : 1.0f;
    if (factor == 1) return;
    for (Vec4& e : irradiance) e = {e.x * factor, e.y * factor, e.z * factor, 0};
  }
  std::unique_ptr<BounceMatrix> good_;
};

struct Spoilt {
  explicit Spoilt(const TestWorld& test) : assembler(test.world()) {
    auto owned = std::make_unique<Faulty>(bounces(400));
    matrix = owned.get();
    solver = makeDenseSolver(std::move(owned), {.threads = 2});
    EXPECT_TRUE(assembler.update(test.randomCut(0.9, 1)));
    EXPECT_TRUE(solver->update(assembler.matrix(), assembler.change()));
    source = randomSource(assembler.matrix(), 1);
    EXPECT_TRUE(solver->setSource(source));
  }
  double error() { return errorOf(*solver, assembler.matrix(), source); }
  MatrixAssembler assembler;
  Faulty* matrix;
  std::unique_ptr<DenseSolver> solver;
  std::vector<Vec4> source;
};

TEST(DenseSolver, TheProbeFindsDriftWithinTwoRoundsAndTheMatrixIsBuiltAnew) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 4});
  Spoilt s(test);
  for (int frame = 0; frame < 40; ++frame) ASSERT_TRUE(s.solver->iterate(1));
  EXPECT_EQ(s.solver->stats().rebuilds, 0u) << "a sound matrix: " << s.solver->stats().last_event;
  EXPECT_GT(s.solver->stats().probe, 0);
  EXPECT_LT(s.solver->stats().probe, 1e-5);
  s.matrix->fault = Faulty::Fault::kTooBright;  // 2 %, under a light that does not change: the picture does not tell
  int frames = 0;
  for (; frames < 40 && s.solver->stats().rebuilds == 0; ++frames) {
    ASSERT_TRUE(s.solver->iterate(1));
    ASSERT_LE(s.error(), kRounding) << "corrections hide it";
  }
  EXPECT_LE(frames, 32);
  EXPECT_NE(s.solver->stats().last_event.find("probe"), std::string::npos);
  for (int frame = 0; frame < 40; ++frame) {
    ASSERT_TRUE(s.solver->iterate(1));
    ASSERT_LE(s.error(), kRounding) << "nor does the rebuilding show";
  }
  EXPECT_EQ(s.solver->stats().rebuilds, 1u);
  EXPECT_EQ(s.solver->stats().waiting, 0u);
  EXPECT_LT(s.solver->stats().probe, 1e-5);
}

TEST(DenseSolver, AMatrixThatIsNoBetterWhenBuiltAnewIsKept) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 4});
  Spoilt s(test);
  s.matrix->stays = true;
  s.matrix->fault = Faulty::Fault::kTooBright;  // from the start, and after every clear()
  for (int frame = 0; frame < 80; ++frame) ASSERT_TRUE(s.solver->iterate(1));
  EXPECT_GT(s.solver->stats().probe, 10 * defaultProbeLimit(s.matrix->name()));
  EXPECT_EQ(s.solver->stats().rebuilds, 0u) << s.solver->stats().last_event;
  EXPECT_LE(s.error(), kRounding) << "corrections hide it";
}

TEST(DenseSolver, ValuesThatAreNotFiniteNeverReachTheRadiosity) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 4});
  for (const bool stays : {false, true}) {
    Spoilt s(test);
    s.matrix->stays = stays;
    s.matrix->fault = Faulty::Fault::kNotFinite;
    std::vector<Vec4> out(s.assembler.matrix().slots());
    for (int frame = 0; frame < 80; ++frame) {
      ASSERT_TRUE(s.solver->iterate(1));
      ASSERT_TRUE(s.solver->radiosity(out));
      for (const Vec4& b : out) ASSERT_TRUE(std::isfinite(b.x + b.y + b.z)) << "frame " << frame;
    }
    EXPECT_GT(s.solver->stats().rebuilds, 0u);
    EXPECT_FALSE(s.solver->stats().last_event.empty());
    EXPECT_LE(s.error(), stays ? 1e-2 : kRounding) << "at worst it is a gather solver";
  }
}

TEST(DenseSolver, NodesThatTheMatrixRefusesAreLeftToTheSparseRows) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 4});
  auto owned = std::make_unique<Faulty>(bounces(400));
  owned->fault = Faulty::Fault::kRefuses;
  owned->stays = true;
  Faulty* matrix = owned.get();
  const auto solver = makeDenseSolver(std::move(owned), {.threads = 2});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 1)));
  ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
  EXPECT_GT(solver->stats().refused, 0u);
  EXPECT_EQ(solver->stats().on_places, 0u);
  EXPECT_NE(solver->stats().last_event.find("no room for light"), std::string::npos);
  const std::vector<Vec4> source = randomSource(assembler.matrix(), 1);
  ASSERT_TRUE(solver->setSource(source));
  ASSERT_TRUE(solver->iterate(100));
  EXPECT_LE(errorOf(*solver, assembler.matrix(), source), kRounding);
  matrix->fault = Faulty::Fault::kNone;
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 2)));
  ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
  EXPECT_EQ(solver->stats().on_places, assembler.matrix().leaves.size()) << "tried again at the next cut";
}

TEST(DenseSolver, TakesNoMemoryOnTheFramePath) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 6});
  MatrixAssembler assembler(test.world());
  const auto solver = makeDenseSolver(bounces(600), {.blocks_per_frame = 2, .threads = 1});
  std::vector<Vec4> out(kMaxSlots);
  for (uint64_t step = 0; step < 12; ++step) {
    const Cut cut = test.randomCut(0.8, step);
    ASSERT_TRUE(assembler.update(cut));
    const std::vector<Vec4> source = randomSource(assembler.matrix(), step);
    const MemoryCalls before = memoryCalls();
    const bool updated = static_cast<bool>(solver->update(assembler.matrix(), assembler.change()));
    const bool lit = static_cast<bool>(solver->setSource(source)), iterated = static_cast<bool>(solver->iterate(2));
    const bool read = static_cast<bool>(solver->radiosity(std::span(out).first(assembler.matrix().slots())));
    const MemoryCalls after = memoryCalls();
    ASSERT_TRUE(updated && lit && iterated && read);
    EXPECT_EQ(after.allocated - before.allocated, 0u) << "step " << step;
    EXPECT_EQ(after.freed - before.freed, 0u);
  }
}

// The baseline on the patches near the observer, everything else one constant.
TEST(DenseSolver, TheSeedsMethodComesNearTheSolutionOnItsOwnCut) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .albedo = 0.5f, .seed = 3});
  MatrixAssembler assembler(test.world(), FarLight::kConstant);
  auto made = makeCpuSeed({.places = 300, .threads = 2});
  ASSERT_TRUE(made);
  const auto solver = makeDenseSolver(std::move(*made), {.correct = false, .threads = 2});
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 1)));
  const LocalMatrix& m = assembler.matrix();
  ASSERT_NE(m.ambient_slot, kNoSlot);
  ASSERT_TRUE(solver->update(m, assembler.change()));
  std::vector<Vec4> source = randomSource(m, 1);
  source[m.ambient_slot] = {3, 3, 3, 0};
  ASSERT_TRUE(solver->setSource(source));
  ASSERT_TRUE(solver->iterate(1));
  const double error = errorOf(*solver, m, source);
  EXPECT_LE(error, 0.05);
  EXPECT_GT(error, 0) << "the baseline is not exact";
}

}  // namespace
}  // namespace ff::runtime
