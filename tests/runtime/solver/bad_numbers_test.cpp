// Numbers that are no light, at every door of the runtime and in every solver on the CPU.
#include "tests/runtime/solver/bad_numbers.h"

#include <cstring>

#include "runtime/api/formfield.h"
#include "runtime/cut/matrix_assembler.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/dense_solver.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

std::unique_ptr<Solver> dense(Storage storage) {
  auto matrix = makeCpuMultibounce({.places = 400, .storage = storage, .threads = 2});
  EXPECT_TRUE(matrix);
  return makeDenseSolver(std::move(*matrix), {.threads = 2});
}

TEST(BadNumbers, LeaveNoTraceInAnySolver) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .albedo = 0.7f, .seed = 4});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 1)));
  const LocalMatrix& m = assembler.matrix();
  ASSERT_LT(m.leaves.size(), 400u);
  // Sums of some hundred products in fp32: 1e2 * 2^-24, times 1 / (1 - 0.7); 1e-4 leaves room.
  expectBadNumbersLeaveNoTrace([] { return makeCpuGather(2); }, m, 1e-4);
  expectBadNumbersLeaveNoTrace([] { return dense(Storage::kFloat32); }, m, 1e-4);
  expectBadNumbersLeaveNoTrace([] { return dense(Storage::kFloat16); }, m, 1e-4);
  const auto baseline = [](Result<std::unique_ptr<BounceMatrix>> matrix) -> std::unique_ptr<Solver> {
    EXPECT_TRUE(matrix);
    return makeDenseSolver(std::move(*matrix), {.correct = false, .threads = 2});
  };
  expectBadNumbersLeaveNoTrace([&] { return baseline(makeCpuSeed({.places = 400, .threads = 2})); }, m, 1e-4);
  expectBadNumbersLeaveNoTrace([&] { return baseline(makeCpuPlainLocal({.places = 400, .threads = 2}, 3)); }, m, 1e-4);
}

TEST(BadNumbers, AStepKeepsNone) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .albedo = 0.7f, .seed = 4});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 1)));
  expectAStepKeepsNothingUnsound([] { return makeCpuGather(2); }, assembler.matrix());
  expectAStepKeepsNothingUnsound([] { return dense(Storage::kFloat32); }, assembler.matrix());
}

// A baseline whose matrix has gone past all bounds, as the seed's does: found by its light, and built anew at once.
class Overflown final : public BounceMatrix {
 public:
  explicit Overflown(std::unique_ptr<BounceMatrix> inner) : inner_(std::move(inner)) {}
  uint32_t capacity() const override { return inner_->capacity(); }
  uint64_t bytes() const override { return inner_->bytes(); }
  Result<void> insert(const EnteringBlock& block) override { return inner_->insert(block); }
  Result<void> remove(std::span<const uint32_t> places) override { return inner_->remove(places); }
  Result<void> clear() override {
    overflown = false;
    return inner_->clear();
  }
  Result<uint32_t> advance(uint32_t columns) override { return inner_->advance(columns); }
  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    if (auto lit = inner_->relight(source, irradiance); !lit) return lit;
    if (overflown) irradiance[3] = {std::nanf(""), 1, 1, 0};
    return {};
  }
  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    return inner_->relightChanged(places, difference, irradiance);
  }
  BounceStats stats() const override { return inner_->stats(); }
  const char* name() const override { return inner_->name(); }
  bool overflown = false;

 private:
  std::unique_ptr<BounceMatrix> inner_;
};

TEST(BadNumbers, ABaselineWhoseMatrixIsNotFiniteIsBuiltAnewWithinTheFrame) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .albedo = 0.7f, .seed = 4});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 1)));
  const LocalMatrix& m = assembler.matrix();
  auto seed = makeCpuSeed({.places = 400, .threads = 2});
  ASSERT_TRUE(seed);
  auto owned = std::make_unique<Overflown>(std::move(*seed));
  Overflown& matrix = *owned;
  const auto solver = makeDenseSolver(std::move(owned), {.correct = false, .threads = 2});
  ASSERT_TRUE(setMatrix(*solver, m));
  ASSERT_TRUE(solver->setSource(randomSource(m, 2)));
  ASSERT_TRUE(solver->iterate(1));
  const std::vector<Vec4> before = soundRadiosity(*solver, m);
  matrix.overflown = true;
  ASSERT_TRUE(solver->iterate(1));
  EXPECT_LE(differenceOf(m, soundRadiosity(*solver, m), before),
            1e-3);  // the order in which nodes enter is another one
  EXPECT_EQ(solver->stats().rebuilds, 1u);
  EXPECT_EQ(solver->repaired(), 1u);
}

// What a callback says of one node in one frame.
struct Lamp {
  float bad = 0;
  bool broken = false;
  uint32_t level = 0, node = 0;
};
void light(void* user, uint32_t level, uint32_t, uint64_t first_node, uint32_t nodes, const FormfieldNode*,
           float* irradiance) {
  const Lamp& lamp = *static_cast<const Lamp*>(user);
  for (uint32_t i = 0; i < nodes; ++i) {
    for (uint32_t c = 0; c < 3; ++c) irradiance[3 * i + c] = static_cast<float>((first_node + i + c) % 7);
    if (lamp.broken && level == lamp.level && first_node + i == lamp.node) irradiance[3 * i + 1] = lamp.bad;
  }
}

class BadNumbersAtTheDoor : public testing::TestWithParam<FormfieldSolver> {
 protected:
  BadNumbersAtTheDoor() : test_({.side = 16, .tile_nodes = 12, .albedo = 0.7f, .seed = 4}) {
    EXPECT_EQ(formfieldCreateCpuDevice(2, &device_), FORMFIELD_OK);
    FormfieldWorldSettings settings;
    formfieldDefaultWorldSettings(&settings);
    settings.solver = GetParam();
    settings.dense_places = 1000;
    EXPECT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &settings, &world_), FORMFIELD_OK)
        << formfieldError(device_);
    EXPECT_EQ(formfieldSetSky(world_, &kSky), FORMFIELD_OK);
    EXPECT_EQ(formfieldSetDirectLight(world_, light, &lamp_), FORMFIELD_OK);
    frames(1);
    EXPECT_EQ(formfieldSettle(world_, 1e-6f, 1000), FORMFIELD_OK) << formfieldError(device_);
    clean_ = radiosity();
  }
  ~BadNumbersAtTheDoor() override {
    formfieldCloseWorld(world_);
    formfieldDestroyDevice(device_);
  }
  void frames(int count) {
    const double at[3] = {8, 1, 8};
    for (int i = 0; i < count; ++i)
      ASSERT_EQ(formfieldFrame(world_, at, nullptr), FORMFIELD_OK) << formfieldError(device_);
  }
  std::vector<float> radiosity() {
    uint32_t slots = 0;
    const float* const b = formfieldRadiosity(world_, &slots);
    std::vector<float> out(b, b + size_t{4} * slots);
    for (const float x : out) EXPECT_TRUE(isSound(x)) << x;
    return out;
  }
  // 40 frames of two steps at an albedo of 0.7 leave 4e-13 of a difference: rounding decides.
  void expectClean() {
    frames(40);
    const std::vector<float> now = radiosity();
    ASSERT_EQ(now.size(), clean_.size());
    for (size_t i = 0; i < now.size(); ++i) ASSERT_NEAR(now[i], clean_[i], 1e-4f * (1 + clean_[i])) << i;
  }
  FormfieldStats stats() {
    FormfieldStats stats{};
    stats.size = sizeof(stats);
    EXPECT_EQ(formfieldGetStats(world_, &stats), FORMFIELD_OK);
    return stats;
  }
  static constexpr FormfieldSky kSky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}, {}};

  TestWorld test_;
  FormfieldDevice device_ = nullptr;
  FormfieldWorld world_ = nullptr;
  Lamp lamp_;
  std::vector<float> clean_;
};

constexpr float kAtTheDoor[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), -1,
                                3e38f, 1.1e12f};

TEST_P(BadNumbersAtTheDoor, OfACallbackAreTakenForZeroAndCounted) {
  EXPECT_STREQ(formfieldLightFault(world_), "");
  uint64_t zeroed = 0;
  lamp_.level = 0;
  lamp_.node = 29;
  for (const float bad : kAtTheDoor) {
    lamp_.bad = bad;
    lamp_.broken = true;
    ASSERT_EQ(formfieldLightChanged(world_), FORMFIELD_OK);
    frames(3);
    radiosity();
    EXPECT_EQ(stats().light_zeroed, ++zeroed) << bad;
    const std::string line = formfieldLightFault(world_);
    const uint32_t tile = test_.world().tileOf(0, 29);
    EXPECT_NE(line.find("tile 0:" + std::to_string(tile) + ", node 29"), std::string::npos) << line;
    EXPECT_NE(line.find("slot "), std::string::npos) << line;
    lamp_.broken = false;
    ASSERT_EQ(formfieldLightChanged(world_), FORMFIELD_OK);
    expectClean();
    EXPECT_EQ(stats().light_zeroed, zeroed);
  }
  EXPECT_EQ(stats().light_repaired, 0u) << "none came as far as the solver";
  lamp_.bad = -1e-5f;  // a cosine's rounding
  lamp_.broken = true;
  ASSERT_EQ(formfieldLightChanged(world_), FORMFIELD_OK);
  frames(1);
  EXPECT_EQ(stats().light_zeroed, zeroed);
}

TEST_P(BadNumbersAtTheDoor, OfASetterAreRefusedAndTheOldLightStays) {
  uint32_t tiles = 0;
  const FormfieldTile tile = formfieldTiles(world_, &tiles, nullptr)[0];
  for (const float bad : kAtTheDoor) {
    FormfieldSky sky = kSky;
    sky.radiance[2] = bad;
    EXPECT_EQ(formfieldSetSky(world_, &sky), FORMFIELD_ERROR_USAGE) << bad;
    sky = kSky;
    sky.gradient[1][0] = bad == -1 ? -3e38f : bad;  // a gradient may be negative
    EXPECT_EQ(formfieldSetSky(world_, &sky), FORMFIELD_ERROR_USAGE) << bad;
    std::vector<float> irradiance(size_t{3} * tile.nodes, 1.0f);
    irradiance[3 * 5 + 2] = bad;
    EXPECT_EQ(formfieldSetDirectIrradiance(world_, tile.first_slot, tile.nodes, irradiance.data()),
              FORMFIELD_ERROR_USAGE);
    const std::string line = formfieldError(device_);
    EXPECT_NE(line.find("slot " + std::to_string(tile.first_slot + 5) + ": tile " + std::to_string(tile.level) + ":" +
                        std::to_string(tile.tile) + ", node " + std::to_string(tile.first_node + 5)),
              std::string::npos)
        << line;
  }
  expectClean();
  EXPECT_EQ(stats().light_zeroed + stats().light_repaired, 0u);
}

INSTANTIATE_TEST_SUITE_P(Solvers, BadNumbersAtTheDoor,
                         testing::Values(FORMFIELD_SOLVER_GATHER, FORMFIELD_SOLVER_MULTIBOUNCE, FORMFIELD_SOLVER_SEED),
                         [](const auto& each) {
                           return each.param == FORMFIELD_SOLVER_GATHER        ? "Gather"
                                  : each.param == FORMFIELD_SOLVER_MULTIBOUNCE ? "Multibounce"
                                                                               : "Seed";
                         });

TEST_P(BadNumbersAtTheDoor, OfASampleAreAnsweredWithZeroAndTheOthersAsEver) {
  std::vector<Vec3> points, normals;
  for (int i = 0; i < 100; ++i) {
    points.push_back({1 + 0.14f * static_cast<float>(i), 2, 8});
    normals.push_back(normalized({0.3f, -1, 0.01f * static_cast<float>(i)}));
  }
  std::vector<Vec3> expected(points.size()), got(points.size());
  const auto sample = [&](std::vector<Vec3>& out) {
    return formfieldSample(world_, static_cast<uint32_t>(points.size()), &points[0].x, &normals[0].x, &out[0].x);
  };
  ASSERT_EQ(sample(expected), FORMFIELD_OK) << formfieldError(device_);
  normals[7] = {};
  normals[8].y = std::nanf("");
  normals[9].x = std::numeric_limits<float>::infinity();
  points[10].z = std::nanf("");
  normals[11] = normals[11] * 1e30f;  // long ones and short ones are directions as well
  normals[12] = normals[12] * 1e-30f;
  normals[13] = normals[13] * 3.0f;
  ASSERT_EQ(sample(got), FORMFIELD_OK) << formfieldError(device_);
  for (size_t i = 0; i < points.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      EXPECT_GT(expected[i][c], 0);
      // Rounding of a normal can move a ray past an edge: one of 256.
      if (i >= 11 && i <= 13)
        EXPECT_NEAR(got[i][c], expected[i][c], 0.01f * expected[i][c]) << i;
      else
        EXPECT_EQ(got[i][c], i >= 7 && i <= 10 ? 0.0f : expected[i][c]) << i;
    }
  EXPECT_EQ(stats().samples_refused, 4u);
}

}  // namespace
}  // namespace ff::runtime
