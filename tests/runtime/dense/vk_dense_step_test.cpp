// The dense solver recorded: two command buffers in flight, one submission a frame, nobody waits but for the frame
// before last. Its light against the CPU's gather, run until nothing changes; under synchronisation validation, which
// must stay silent, and once per subgroup size (see vulkan.cmake).
#include "runtime/dense/vk_dense_step.h"

#include <bit>
#include <cmath>
#include <limits>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/solver/fallback_solver.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "tests/runtime/solver/bad_numbers.h"
#include "tests/runtime/test_world.h"
#include "tests/runtime/vulkan/validated_vulkan.h"
#include "tests/support/counted_memory.h"

namespace ff::runtime {
namespace {

constexpr double kRounding = 1e-5;  // fp32 sums of some hundred terms

// A closed box: leaves that see each other at random, and nothing else; finishByHand() is still to come.
LocalMatrix unfinishedBox(uint32_t leaves, float albedo, uint64_t seed, uint32_t entries = 64) {
  std::mt19937_64 random(seed);
  LocalMatrix m;
  constexpr uint32_t quanta = 4096;
  m.row_start.push_back(0);
  for (uint32_t s = 0; s < leaves; ++s) {
    m.albedo.push_back({albedo, albedo * 0.9f, albedo * 0.5f, 0});
    m.area_m2.push_back(1);
    m.leaf.push_back(1);
    m.row_scale.push_back(1 / static_cast<float>(quanta));
    for (uint32_t e = 0; e < entries; ++e)
      m.entries.push_back(packEntry(static_cast<uint32_t>(random() % leaves), quanta / entries));
    m.row_start.push_back(static_cast<uint32_t>(m.entries.size()));
  }
  m.refined_level_start.push_back(0);
  return m;
}

LocalMatrix closedBox(uint32_t leaves, float albedo, uint64_t seed, uint32_t entries = 64) {
  LocalMatrix m = unfinishedBox(leaves, albedo, seed, entries);
  finishByHand(m);
  return m;
}

// What an engine does each frame.
class Engine {
 public:
  Engine(VkContext& context, VulkanRecorder& solver) : context_(context), solver_(solver) {
    auto pool_info = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
    pool_info.queueFamilyIndex = context.queueFamily();
    pool_info.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
    EXPECT_EQ(vkCreateCommandPool(context.device(), &pool_info, nullptr, &pool_), VK_SUCCESS);
    auto info = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
    info.commandPool = pool_;
    info.commandBufferCount = kInFlight;
    EXPECT_EQ(vkAllocateCommandBuffers(context.device(), &info, commands_), VK_SUCCESS);
    auto copied = Buffer::create(context, 8192 * sizeof(Vec4), 0, MemoryUse::kHost);
    if (!copied) throw std::runtime_error(copied.error().line());
    copied_ = std::move(*copied);
  }
  ~Engine() {
    for (const uint64_t s : submission_) EXPECT_TRUE(context_.wait(s));
    vkDestroyCommandPool(context_.device(), pool_, nullptr);
  }

  // A matrix made by hand and its light.
  void takeUp(const LocalMatrix& matrix, std::span<const Vec4> source) {
    slots = matrix.slots();
    if (auto taken = setMatrix(solver_, matrix); !taken) throw std::runtime_error(taken.error().line());
    if (auto lit = solver_.setSource(source); !lit) throw std::runtime_error(lit.error().line());
  }
  // Waits for the frame that was recorded kInFlight frames ago: before the solver is told anything of the next one.
  void begin() { EXPECT_TRUE(context_.wait(submission_[frame_ % kInFlight])); }
  void record(int iterations = 1) {
    const uint32_t f = frame_++ % kInFlight;
    auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    EXPECT_EQ(vkBeginCommandBuffer(commands_[f], &begin), VK_SUCCESS);
    const MemoryCalls before = memoryCalls();
    const auto recorded = solver_.record(commands_[f], iterations);
    allocated += memoryCalls().allocated - before.allocated;
    EXPECT_TRUE(recorded) << recorded.error().line();
    const VkBufferCopy copy{0, 0, slots * sizeof(Vec4)};
    vkCmdCopyBuffer(commands_[f], solver_.radiosityBuffer(), copied_.handle(), 1, &copy);
    barrier(commands_[f], VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
            VK_PIPELINE_STAGE_HOST_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT,
            VK_ACCESS_HOST_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT);
    EXPECT_EQ(vkEndCommandBuffer(commands_[f]), VK_SUCCESS);
    auto submitted = context_.submit(commands_[f]);
    EXPECT_TRUE(submitted);
    submission_[f] = *submitted;
  }
  void frames(int count) {
    for (int i = 0; i < count; ++i) {
      begin();
      record();
    }
  }
  // Of the last frame; waits.
  std::span<const Vec4> radiosity() {
    for (const uint64_t s : submission_) EXPECT_TRUE(context_.wait(s));
    return {reinterpret_cast<const Vec4*>(copied_.mapped()), slots};
  }

  static constexpr uint32_t kInFlight = 2;
  uint32_t slots = 0;
  uint64_t allocated = 0;

 private:
  VkContext& context_;
  VulkanRecorder& solver_;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkCommandBuffer commands_[kInFlight] = {};
  Buffer copied_;
  uint64_t submission_[kInFlight] = {};
  uint32_t frame_ = 0;
};

constexpr VulkanGatherSettings kSmallRoom{
    .slots = 8192, .tiles = 512, .pages = 1024, .packed_bytes = 1 << 20, .entry_bytes = 2 << 20};

class VkDenseStep : public ValidatedVulkan {
 protected:
  std::unique_ptr<VulkanRecorder> make(const MultibounceSettings& settings, VulkanGatherSettings room = kSmallRoom) {
    auto made = makeVulkanDenseRecorder(context_, room, settings);
    if (!made) throw std::runtime_error(made.error().line());
    return std::move(*made);
  }
};

struct Kind {
  MultibounceSettings settings;
  double after_one, settled;  // errors: after a frame of another light, under a light that stays
};
// fp16 rounds by 2^-11 and luminance leaves the third power of the colours' deviation; corrections then take that away.
const Kind kKinds[] = {{{.places = 1000}, kRounding, kRounding},
                       {{.places = 1000, .storage = Storage::kFloat16}, 5e-3, kRounding},
                       {{.places = 1000, .storage = Storage::kFloat16, .luminance = true}, 1e-2, kRounding}};

TEST_F(VkDenseStep, TheFrameAfterTheLightChangesHasAllBounces) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false, .seed = 3});
  for (const Kind& kind : kKinds)
    for (const double chance : {0.3, 1.0}) {
      MatrixAssembler assembler(test.world());
      ASSERT_TRUE(assembler.update(test.randomCut(chance, 3)));
      const LocalMatrix& m = assembler.matrix();
      const auto solver = make(kind.settings);
      Engine engine(*context_, *solver);
      engine.slots = m.slots();
      ASSERT_TRUE(solver->update(m, assembler.change()));
      ASSERT_TRUE(solver->setSource(randomSource(m, 1)));
      engine.frames(static_cast<int>(m.leaves.size() / (kRebuildBlocks * kMaxBlock)) + 3);
      ASSERT_EQ(solver->dense()->on_places, m.leaves.size());
      const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
      engine.begin();
      ASSERT_TRUE(solver->setSource(source));
      engine.record();
      EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kind.after_one) << solver->name();
      engine.frames(8);
      EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kind.settled) << solver->name();
      EXPECT_LE(solver->residual(), kRounding);
      EXPECT_GE(solver->residual(), 0);
      EXPECT_EQ(solver->dense()->rebuilds + solver->dense()->refused, 0u) << solver->dense()->last_event;
    }
}

// Nodes that enter, leave, wait and are refined; frames in flight all the while.
TEST_F(VkDenseStep, ShowsTheLightOfTheCutAfterAWalk) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .equal_areas = false, .seed = 7});
  for (const Kind& kind : kKinds) {
    MatrixAssembler assembler(test.world());
    const LocalMatrix& m = assembler.matrix();
    const auto solver = make(kind.settings);
    Engine engine(*context_, *solver);
    for (uint64_t step = 0; step < 6; ++step) {
      SCOPED_TRACE(testing::Message() << solver->name() << " step " << step);
      engine.begin();
      // Some cuts are taken up two in a frame; some leave almost nothing of the last.
      for (uint64_t cut = 0; cut < 1 + step % 2; ++cut) {
        const double chance = step % 4 == 3 ? 0.0 : 0.95 - 0.05 * static_cast<double>(step % 3);
        ASSERT_TRUE(assembler.update(test.randomCut(chance, 10 * step + cut)));
        ASSERT_TRUE(solver->update(m, assembler.change()));
      }
      engine.slots = m.slots();
      ASSERT_TRUE(solver->setSource(randomSource(m, 1)));
      engine.record();
      engine.frames(static_cast<int>(step % 3));
      if (step % 3 != 2) continue;
      engine.frames(10);  // all enter within six
      EXPECT_EQ(solver->dense()->on_places, m.leaves.size());
      EXPECT_LE(differenceOf(m, engine.radiosity(), converged(m, randomSource(m, 1))), kind.settled);
      engine.begin();
      ASSERT_TRUE(solver->setSource(randomSource(m, 2)));
      engine.record();
      EXPECT_LE(differenceOf(m, engine.radiosity(), converged(m, randomSource(m, 2))), kind.after_one)
          << "the matrix is not that of the cut";
    }
    EXPECT_GT(solver->dense()->left, 500u);
    EXPECT_EQ(solver->dense()->rebuilds + solver->dense()->refused, 0u) << solver->dense()->last_event;
  }
}

TEST_F(VkDenseStep, KeepsItsNodesWhenSlotsAreGivenOutAnew) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 8});
  LocalMatrix m;
  const auto solver = make({.places = 400});
  for (const uint64_t seed : {1, 2, 3}) {
    MatrixAssembler assembler(test.world());
    ASSERT_TRUE(assembler.update(test.randomCut(0.9, seed)));
    m = assembler.matrix();  // the same matrix to the solver, all slots new
    const uint64_t entered = solver->dense()->entered;
    ASSERT_TRUE(solver->update(m, {.any = true, .renumbered = true}));
    const std::vector<Vec4> source = randomSource(m, 1);
    ASSERT_TRUE(solver->setSource(source));
    for (int frame = 0; frame < 4; ++frame) ASSERT_TRUE(solver->iterate(1));
    if (seed > 1) {
      EXPECT_LT(solver->dense()->entered - entered, m.leaves.size() / 2) << "all entered again";
    }
    std::vector<Vec4> out(m.slots());
    ASSERT_TRUE(solver->setSource(randomSource(m, 2)));
    ASSERT_TRUE(solver->iterate(1));
    ASSERT_TRUE(solver->radiosity(out));
    EXPECT_LE(differenceOf(m, out, converged(m, randomSource(m, 2))), kRounding);
  }
}

// A staging region has room for the largest block there may be: the second block here does not fit beside the first.
TEST_F(VkDenseStep, BlocksThatDoNotFitIntoAFrameEnterInTheNext) {
  const LocalMatrix m = closedBox(128, 0.9f, 1, 512);
  const std::vector<Vec4> source = randomSource(m, 2);
  const auto solver = make({.places = 128});
  Engine engine(*context_, *solver);
  engine.takeUp(m, source);
  engine.frames(1);
  EXPECT_EQ(solver->dense()->on_places, 64u);
  EXPECT_EQ(solver->dense()->waiting, 64u);
  engine.frames(1);
  EXPECT_EQ(solver->dense()->on_places, 128u);
  EXPECT_EQ(solver->dense()->waiting, 0u);
  engine.frames(1);
  EXPECT_LE(differenceOf(m, engine.radiosity(), converged(m, source)), kRounding);
}

TEST_F(VkDenseStep, WithMoreLeavesThanPlacesItConvergesFasterThanGather) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .sky_share = 0.05, .albedo = 0.9f, .seed = 5});
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(1, 5)));
  const LocalMatrix& m = assembler.matrix();
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source), dark(m.slots());
  double before = 1;
  for (const uint32_t places : {0u, 150u, 700u}) {
    auto gather = makeVulkanRecorder(context_, kSmallRoom);
    ASSERT_TRUE(gather);
    const auto solver = places > 0 ? make({.places = places}) : std::move(*gather);
    Engine engine(*context_, *solver);
    engine.slots = m.slots();
    ASSERT_TRUE(solver->update(m, assembler.change()));
    ASSERT_TRUE(solver->setSource(dark));
    engine.frames(5);
    engine.begin();
    ASSERT_TRUE(solver->setSource(source));
    engine.record(3);
    engine.frames(4);
    if (places > 0) {
      EXPECT_EQ(solver->dense()->on_places, places);
      EXPECT_EQ(solver->dense()->waiting, m.leaves.size() - places);
    }
    const double error = differenceOf(m, engine.radiosity(), truth);
    EXPECT_LT(error, 0.95 * before) << places << " places";
    before = error;
    engine.frames(150);
    EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding) << places << " places";
  }
}

TEST_F(VkDenseStep, AClosedBoxIsLitAtOnceWhereGatherTakesLong) {
  const LocalMatrix m = closedBox(200, 0.9f, 1);
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  for (const bool dense : {false, true}) {
    auto gather = makeVulkanRecorder(context_, kSmallRoom);
    ASSERT_TRUE(gather);
    const auto solver = dense ? make({.places = 200}) : std::move(*gather);
    Engine engine(*context_, *solver);
    engine.takeUp(m, randomSource(m, 1));
    engine.frames(4);
    engine.begin();
    ASSERT_TRUE(solver->setSource(source));
    engine.record();
    engine.frames(2);
    const double error = differenceOf(m, engine.radiosity(), truth);
    EXPECT_EQ(error <= kRounding, dense) << error;
    EXPECT_TRUE(dense || error > 0.01) << error;
  }
}

// The caller's shaders may write M: no call tells of it.
TEST_F(VkDenseStep, ALightThatFlickersInTheSourceBufferIsNoDrift) {
  const LocalMatrix m = closedBox(150, 0.9f, 1);
  const auto solver = make({.places = 150});
  Engine engine(*context_, *solver);
  engine.takeUp(m, randomSource(m, 1));
  engine.frames(4);
  for (int frame = 0; frame < 24; ++frame) {
    const float bright = frame % 5 == 0 ? 1.0f : frame % 5 == 2 ? 1.03f : 8.0f;  // each step brings more than the last
    ASSERT_TRUE(context_->run([&](VkCommandBuffer c) {
      vkCmdFillBuffer(c, solver->sourceBuffer(), 0, m.slots() * sizeof(Vec4), std::bit_cast<uint32_t>(bright));
    }));
    engine.frames(1);
  }
  const std::vector<Vec4> source(m.slots(), {8, 8, 8, 0}), truth = converged(m, source);
  EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding);
  EXPECT_EQ(solver->dense()->rebuilds, 0u) << solver->dense()->last_event;
}

// Two leaves that see only each other, twice over: I - S C is singular in red, of which there is none.
TEST_F(VkDenseStep, ARefusedBlockIsTakenBackAndItsNodesAreLeftToTheSparseRows) {
  LocalMatrix m = unfinishedBox(300, 0.6f, 4);
  for (const uint32_t s : {0u, 1u}) {
    m.albedo[s] = {0.5f, 0.3f, 0.1f, 0};
    for (uint32_t e = 0; e < 64; ++e) m.entries[64 * s + e] = packEntry(1 - s, 128);
  }
  finishByHand(m);
  std::vector<Vec4> source = randomSource(m, 2);
  for (Vec4& b : source) b.x = 0;
  const std::vector<Vec4> truth = converged(m, source);
  const auto solver = make({.places = 300});
  Engine engine(*context_, *solver);
  engine.takeUp(m, source);
  double before = 1;
  for (int frame = 0; frame < 40; ++frame) {
    engine.frames(1);
    if (frame > 4) continue;
    const double error = differenceOf(m, engine.radiosity(), truth);
    EXPECT_LT(error, before) << "frame " << frame << ": also while it counts as present";
    before = error;
  }
  EXPECT_EQ(solver->dense()->refused, 1u);
  EXPECT_NE(solver->dense()->last_event.find("light would be caught"), std::string::npos);
  EXPECT_EQ(solver->dense()->on_places, 300u - kMaxBlock);
  EXPECT_EQ(solver->dense()->waiting, 0u);
  EXPECT_EQ(solver->dense()->rebuilds, 0u) << solver->dense()->last_event;
  EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding);
}

TEST_F(VkDenseStep, AMatrixThatGoesWrongIsBuiltAnew) {
  const LocalMatrix m = closedBox(300, 0.8f, 5);
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  const auto solver = make({.places = 300});
  Engine engine(*context_, *solver);
  engine.takeUp(m, source);
  engine.frames(6);
  EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding);
  const std::pair<float, const char*> faults[] = {{0.2f, "made the error grow"},
                                                  {std::numeric_limits<float>::quiet_NaN(), "the matrix is not finite"},
                                                  {std::numeric_limits<float>::infinity(), "the matrix is not finite"}};
  uint64_t rebuilds = 0;
  for (const auto& [value, event] : faults) {
    ASSERT_TRUE(fillMatrix(*solver, value));
    std::vector<Vec4> other = source;
    for (Vec4& b : other) b.y *= 1.2f;
    engine.begin();
    ASSERT_TRUE(solver->setSource(other));  // something to correct
    engine.record();
    for (int frame = 0; frame < 12; ++frame) {
      engine.frames(1);
      for (const Vec4& b : engine.radiosity())
        ASSERT_TRUE(std::isfinite(b.x + b.y + b.z)) << value << " frame " << frame;
    }
    EXPECT_EQ(solver->dense()->rebuilds, ++rebuilds);
    EXPECT_NE(solver->dense()->last_event.find(event), std::string::npos) << solver->dense()->last_event;
    EXPECT_EQ(solver->dense()->on_places, 300u);
    EXPECT_LE(differenceOf(m, engine.radiosity(), converged(m, other)), kRounding) << value;
  }
}

// While light is held back errors say nothing of the matrix; a recorder has to learn from its device that none is held any more.
TEST_F(VkDenseStep, AMatrixThatGoesWrongIsBuiltAnewOnceLightHasFollowedAChangeOfTheCut) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  const auto solver = make({.places = 600});
  Engine engine(*context_, *solver);
  const auto source = [&](float scale) {
    std::vector<Vec4> all = randomSource(m, 1);
    for (Vec4& b : all) b.y *= scale;
    return all;
  };
  for (uint64_t cut = 0; cut < 2; ++cut) {
    engine.begin();
    solver->ease(4);
    ASSERT_TRUE(assembler.update(test.randomCut(0.9, cut)));
    ASSERT_TRUE(solver->update(m, assembler.change()));
    engine.slots = m.slots();
    ASSERT_TRUE(solver->setSource(source(1)));
    engine.record();
    engine.frames(12);
  }
  ASSERT_TRUE(fillMatrix(*solver, 0.2f));
  engine.begin();
  ASSERT_TRUE(solver->setSource(source(1.2f)));
  engine.record();
  engine.frames(12);
  EXPECT_EQ(solver->dense()->rebuilds, 1u);
  EXPECT_NE(solver->dense()->last_event.find("made the error grow"), std::string::npos) << solver->dense()->last_event;
}

// What is too small to make light wrong, or errors grow, only slows the steps down: only random vectors find that.
TEST_F(VkDenseStep, TheProbeFindsDriftThatTheLightDoesNotShow) {
  const LocalMatrix m = closedBox(300, 0.8f, 5);
  const std::vector<Vec4> source = randomSource(m, 2);
  constexpr int kRound = 16 * Engine::kInFlight;  // frames
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    const double healthy = storage == Storage::kFloat32 ? 1e-5 : 5e-3;
    const auto solver = make({.places = 300, .storage = storage});
    Engine engine(*context_, *solver);
    engine.takeUp(m, source);
    engine.frames(2 * kRound);
    EXPECT_GT(solver->dense()->probe, 0);
    EXPECT_LT(solver->dense()->probe, healthy);
    EXPECT_EQ(solver->dense()->rebuilds, 0u) << solver->dense()->last_event;
    ASSERT_TRUE(fillMatrix(*solver, storage == Storage::kFloat32 ? 1e-5f : std::bit_cast<float>(0x00a800a8u)));  // next to nothing; two of fp16
    engine.frames(2 * kRound);
    EXPECT_EQ(solver->dense()->rebuilds, 1u);
    EXPECT_NE(solver->dense()->last_event.find("probe"), std::string::npos) << solver->dense()->last_event;
    engine.frames(2 * kRound);
    EXPECT_LT(solver->dense()->probe, healthy);
    EXPECT_EQ(solver->dense()->rebuilds, 1u);
    EXPECT_LE(differenceOf(m, engine.radiosity(), converged(m, source)), kRounding);
  }
}

// Vectors are judged frames after they were drawn: never by other rows or places than those of then.
TEST_F(VkDenseStep, TheProbeFindsNothingOnAWalkWhereNothingIsWrong) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .equal_areas = false, .seed = 3});
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  const auto solver = make({.places = 600});
  Engine engine(*context_, *solver);
  for (uint64_t step = 0; step < 40; ++step) {
    engine.begin();
    ASSERT_TRUE(assembler.update(test.randomCut(0.9, step)));
    ASSERT_TRUE(solver->update(m, assembler.change()));
    engine.slots = m.slots();
    ASSERT_TRUE(solver->setSource(randomSource(m, 1)));
    engine.record();
    engine.frames(2 + static_cast<int>(step % 2));
  }
  EXPECT_GT(solver->dense()->probe, 0);
  EXPECT_LT(solver->dense()->probe, 1e-5);
  EXPECT_EQ(solver->dense()->rebuilds + solver->dense()->refused, 0u) << solver->dense()->last_event;
}

TEST_F(VkDenseStep, NodesThatCannotLeaveSpoilTheMatrixAndNothingElse) {
  const TestWorld test({.side = 16, .tile_nodes = 12, .seed = 3});
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  const auto solver = make({.places = 400});
  ASSERT_TRUE(assembler.update(test.randomCut(0.95, 1)));
  ASSERT_TRUE(solver->update(m, assembler.change()));
  ASSERT_TRUE(solver->setSource(randomSource(m, 1)));
  ASSERT_TRUE(solver->iterate(1));
  ASSERT_TRUE(solver->iterate(1));
  ASSERT_TRUE(fillMatrix(*solver, 1e9f));
  const uint64_t left = solver->dense()->left;
  ASSERT_TRUE(assembler.update(test.randomCut(0.9, 2)));
  ASSERT_TRUE(solver->update(m, assembler.change()));
  ASSERT_GT(solver->dense()->left, left);
  ASSERT_TRUE(solver->setSource(randomSource(m, 2)));
  std::vector<Vec4> out(m.slots());
  for (int frame = 0; frame < 8; ++frame) {
    ASSERT_TRUE(solver->iterate(1));
    ASSERT_TRUE(solver->radiosity(out));
    for (const uint32_t s : m.leaves) ASSERT_LT(out[s].y, 100) << "frame " << frame;  // sources are below 10
  }
  EXPECT_EQ(solver->dense()->rebuilds, 1u);
  EXPECT_EQ(solver->dense()->refused, 0u) << "what the corrupt matrix refused is nobody's fault";
  EXPECT_NE(solver->dense()->last_event.find("lost its precision"), std::string::npos) << solver->dense()->last_event;
  EXPECT_LE(differenceOf(m, out, converged(m, randomSource(m, 2))), kRounding);
}

TEST_F(VkDenseStep, LightThatWasNotFiniteDoesNotStay) {
  const LocalMatrix m = closedBox(150, 0.8f, 5);
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  for (const float bad : kBadNumbers) {
    const auto solver = make({.places = 150});
    Engine engine(*context_, *solver);
    engine.takeUp(m, source);
    engine.frames(5);
    std::vector<Vec4> broken = source;
    broken[17].z = bad;
    engine.begin();
    ASSERT_TRUE(solver->setSource(broken));
    engine.record();
    EXPECT_EQ(solver->repaired(), 1u);
    engine.begin();
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->setRadiosity(std::vector<Vec4>(m.slots(), Vec4{bad, 1, 1, 0})));
    engine.record();
    for (const Vec4& b : engine.radiosity()) ASSERT_TRUE(isSound(b)) << bad;
    engine.frames(12);
    EXPECT_EQ(solver->dense()->rebuilds, 0u) << "the matrix had no part in it";
    EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding);
  }
}

// The caller's own shaders may write the source.
TEST_F(VkDenseStep, WhatTheSourceBufferIsFilledWithDoesNotStay) {
  const LocalMatrix m = closedBox(150, 0.8f, 5);
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  for (const float bad : kBadNumbers) {
    const auto solver = make({.places = 150});
    Engine engine(*context_, *solver);
    engine.takeUp(m, source);
    engine.frames(5);
    ASSERT_TRUE(context_->run([&](VkCommandBuffer c) {
      vkCmdFillBuffer(c, solver->sourceBuffer(), 17 * sizeof(Vec4), 4, std::bit_cast<uint32_t>(bad));
    }));
    engine.frames(1);
    for (const Vec4& b : engine.radiosity()) ASSERT_TRUE(isSound(b)) << bad;
    EXPECT_EQ(solver->repaired(), 1u);
    engine.begin();
    ASSERT_TRUE(solver->setSource(source));
    engine.record();
    engine.frames(12);
    EXPECT_EQ(solver->repaired(), 1u);
    EXPECT_LE(differenceOf(m, engine.radiosity(), truth), kRounding);
  }
}

TEST_F(VkDenseStep, ALostDeviceHandsOverToTheCpu) {
  const LocalMatrix m = closedBox(150, 0.8f, 5);
  const std::vector<Vec4> source = randomSource(m, 2), truth = converged(m, source);
  const auto solver = makeFallbackSolver(make({.places = 150}), makeCpuGather(1));
  ASSERT_TRUE(setMatrix(*solver, m));
  ASSERT_TRUE(solver->setSource(source));
  ASSERT_TRUE(solver->iterate(2));
  std::vector<Vec4> out(m.slots());
  ASSERT_TRUE(solver->radiosity(out));
  EXPECT_LE(differenceOf(m, out, truth), 0.1);
  EXPECT_EQ(solver->reason(), "");
  context_->loseDeviceAfter(1);
  ASSERT_TRUE(solver->iterate(1));
  ASSERT_TRUE(solver->iterate(100));
  EXPECT_NE(solver->reason(), "");
  EXPECT_STREQ(solver->name(), "cpu");
  ASSERT_TRUE(solver->radiosity(out));
  EXPECT_LE(differenceOf(m, out, truth), kRounding);
}

// Without the layers, which allocate on their own.
TEST(VkDenseStepMemory, TakesNoneOnTheFramePath) {
  const auto context = openVulkan();
  if (!context) GTEST_SKIP() << "no Vulkan device, nothing was tested: " << context.error().line();
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 6});
  MatrixAssembler assembler(test.world());
  auto made = makeVulkanDenseRecorder(*context, kSmallRoom, {.places = 600});
  ASSERT_TRUE(made) << made.error().line();
  VulkanRecorder& solver = **made;
  Engine engine(**context, solver);
  const uint64_t device_bytes = (*context)->heap().allocatedBytes();
  for (uint64_t step = 0; step < 12; ++step) {
    engine.begin();
    ASSERT_TRUE(assembler.update(test.randomCut(0.8, step)));
    const std::vector<Vec4> source = randomSource(assembler.matrix(), step);
    engine.slots = assembler.matrix().slots();
    const MemoryCalls before = memoryCalls();
    const bool updated = static_cast<bool>(solver.update(assembler.matrix(), assembler.change()));
    const bool lit = static_cast<bool>(solver.setSource(source));
    EXPECT_EQ(memoryCalls().allocated - before.allocated, 0u) << "step " << step;
    ASSERT_TRUE(updated && lit);
    engine.record();
    engine.frames(2);
  }
  EXPECT_EQ(engine.allocated, 0u);
  EXPECT_EQ((*context)->heap().allocatedBytes(), device_bytes);
  EXPECT_GT(solver.dense()->left, 300u);
}

}  // namespace
}  // namespace ff::runtime
