// The Vulkan gather against a plain double-precision loop over the same local matrix, on random matrices. The test is
// run once per subgroup size (see vulkan.cmake). Validation with synchronisation checks is on and must stay silent.
#include "runtime/gather/vk_gather.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <random>
#include <vector>

#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "tests/runtime/solver/bad_numbers.h"
#include "tests/runtime/vulkan/validated_vulkan.h"

namespace ff::runtime {
namespace {

// A random but physical matrix: `leaves` leaf slots whose rows sum to at most `row_sum` of their quanta, then levels of
// refined slots over consecutive groups of 1..8. Some rows are empty.
LocalMatrix randomMatrix(uint32_t leaves, uint32_t max_row, int refined_levels, uint32_t seed, double row_sum = 0.95) {
  std::mt19937 bits(seed);
  const auto rng = [&] { return static_cast<uint32_t>(bits()); };
  const auto unit = [&] { return static_cast<float>(rng() >> 8) * 0x1p-24f; };
  LocalMatrix m;
  // Refined slots come first, as coarser tiles may; each level's children are the slots of the finer level.
  std::vector<uint32_t> sizes{leaves};
  std::vector<std::vector<uint32_t>> groups;  // per refined level, children of each slot
  for (int l = 0; l < refined_levels; ++l) {
    std::vector<uint32_t> group;
    for (uint32_t left = sizes.back(); left > 0;) {
      group.push_back(std::min<uint32_t>(left, 1 + rng() % 8));
      left -= group.back();
    }
    sizes.push_back(static_cast<uint32_t>(group.size()));
    groups.push_back(group);
  }
  std::vector<uint32_t> first_slot(sizes.size());
  uint32_t slots = 0;
  for (size_t l = 0; l < sizes.size(); ++l) {
    first_slot[l] = slots;
    slots += sizes[l];
  }
  m.albedo.resize(slots);
  m.area_m2.resize(slots);
  m.leaf.resize(slots);
  m.row_scale.resize(slots);
  m.row_start.push_back(0);
  for (uint32_t s = 0; s < slots; ++s) {
    m.albedo[s] = {0.9f * unit(), 0.9f * unit(), 0.9f * unit(), 0};
    m.area_m2[s] = 0.1f + unit();
    m.leaf[s] = s < leaves;
    const uint32_t quanta = 64 + rng() % 4000;
    m.row_scale[s] = 1.0f / static_cast<float>(quanta);
    const uint32_t entries = s < leaves && max_row > 0 && rng() % 10 != 0 ? 1 + rng() % max_row : 0;
    const auto budget = static_cast<uint32_t>(row_sum * quanta);
    const uint32_t share = entries ? std::max(1u, budget / entries) : 0;
    uint32_t spent = 0;
    for (uint32_t e = 0; e < entries && spent + share <= budget; ++e, spent += share)
      m.entries.push_back(packEntry(rng() % slots, share));
    m.row_start.push_back(static_cast<uint32_t>(m.entries.size()));
  }
  for (size_t l = 0; l < groups.size(); ++l) {
    m.refined_level_start.push_back(static_cast<uint32_t>(m.refined.size()));
    uint32_t child = first_slot[l];
    for (uint32_t i = 0; i < groups[l].size(); ++i) {
      m.refined.push_back({first_slot[l + 1] + i, child, child + groups[l][i] - 1});
      child += groups[l][i];
    }
  }
  m.refined_level_start.push_back(static_cast<uint32_t>(m.refined.size()));
  finishByHand(m);
  return m;
}

struct Rgb {
  double v[3] = {};
};

std::vector<Rgb> reference(const LocalMatrix& m, std::span<const Vec4> source, std::vector<Rgb> b, int iterations) {
  for (int k = 0; k < iterations; ++k) {
    std::vector<Rgb> next(b.size());
    for (uint32_t s = 0; s < m.slots(); ++s) {
      if (!m.leaf[s]) continue;
      double sum[3] = {};
      for (const uint32_t e : m.row(s))
        for (int c = 0; c < 3; ++c) sum[c] += countOfEntry(e) * b[slotOfEntry(e)].v[c];
      const double albedo[3] = {m.albedo[s].x, m.albedo[s].y, m.albedo[s].z};
      const double emitted[3] = {source[s].x, source[s].y, source[s].z};
      for (int c = 0; c < 3; ++c) next[s].v[c] = emitted[c] + albedo[c] * static_cast<double>(m.row_scale[s]) * sum[c];
    }
    for (const auto& r : m.refined) {
      double area = 0;
      for (uint32_t c = r.first_child; c <= r.last_child; ++c) {
        for (int i = 0; i < 3; ++i) next[r.slot].v[i] += static_cast<double>(m.area_m2[c]) * next[c].v[i];
        area += static_cast<double>(m.area_m2[c]);
      }
      for (double& v : next[r.slot].v) v /= area;
    }
    b = std::move(next);
  }
  return b;
}

std::vector<Vec4> randomSource(uint32_t slots, uint32_t seed) {
  std::mt19937 rng(seed);
  std::vector<Vec4> s(slots);
  for (Vec4& v : s)
    v = {static_cast<float>(rng() % 1000) * 0.01f, static_cast<float>(rng() % 1000) * 0.01f,
         static_cast<float>(rng() % 1000) * 0.01f, 0};
  return s;
}

uint32_t longestSum(const LocalMatrix& m) {
  uint32_t longest = 8;  // children of a refined slot
  for (uint32_t s = 0; s < m.slots(); ++s) longest = std::max(longest, m.row_entries[s]);
  return longest;
}

// Every term of a row is >= 0, so the relative error of a fp32 sum of n products is at most (n + 5) u, in any order,
// with u = 2^-24: n - 1 additions, two roundings a product (count is exact), the scale, the albedo, the emitted light.
// A division on the device may err by 2.5 ulp = 5 u, which is the refined slots' share. An iteration hands its relative
// error on undiminished (non-negative terms again: F cannot amplify a relative error), so k iterations stay within
// k * levels-deep chains: k * ((n + 5) + levels * (8 + 8)) u.
double tolerance(const LocalMatrix& m, int iterations) {
  const double levels = static_cast<double>(m.refined_level_start.size()) - 1;
  return iterations * (longestSum(m) + 5 + levels * 16) * 0x1p-24;
}

class VkGather : public ValidatedVulkan {
 protected:
  void expectAgrees(const LocalMatrix& m, int iterations, const VulkanGatherSettings& settings = {},
                    bool warm = false) {
    auto solver = makeVulkanGather(context_, settings);
    ASSERT_TRUE(solver) << solver.error().line();
    std::vector<Vec4> start = warm ? randomSource(m.slots(), 99) : std::vector<Vec4>{};
    std::vector<Rgb> b(m.slots());
    for (size_t i = 0; i < start.size(); ++i) b[i] = {{start[i].x, start[i].y, start[i].z}};
    const std::vector<Vec4> source = randomSource(m.slots(), 5);
    auto kept = std::make_shared<const LocalMatrix>(m);
    auto set = setMatrix(**solver, *kept, start);
    ASSERT_TRUE(set) << set.error().line();
    ASSERT_TRUE((*solver)->setSource(source));
    // In two calls, so that the state between calls is tested, too.
    ASSERT_TRUE((*solver)->iterate(iterations / 2));
    ASSERT_TRUE((*solver)->iterate(iterations - iterations / 2));
    EXPECT_GT((*solver)->lastMs(), 0);
    std::vector<Vec4> got(m.slots());
    ASSERT_TRUE((*solver)->radiosity(got));
    const std::vector<Rgb> want = reference(m, source, b, iterations);
    double worst = 0, largest = 0;
    for (uint32_t s = 0; s < m.slots(); ++s) {
      const float g[3] = {got[s].x, got[s].y, got[s].z};
      for (int c = 0; c < 3; ++c) {
        ASSERT_TRUE(std::isfinite(g[c])) << "slot " << s;
        const double w = want[s].v[c];
        worst = std::max(worst, std::abs(static_cast<double>(g[c]) - w) / std::max(w, 1e-30));
        largest = std::max(largest, w);
      }
    }
    EXPECT_GT(largest, 0);
    EXPECT_LE(worst, tolerance(m, iterations));
  }
};

TEST_F(VkGather, AgreesWithDoublePrecisionAfterOneAndManyIterations) {
  const LocalMatrix m = randomMatrix(700, 300, 0, 1);
  for (int iterations : {1, 2, 7, 40}) expectAgrees(m, iterations);
}

TEST_F(VkGather, AveragesRefinedSlotsLevelByLevel) {
  expectAgrees(randomMatrix(2000, 120, 1, 2), 5);
  expectAgrees(randomMatrix(2000, 120, 4, 3), 5);
}

TEST_F(VkGather, AgreesWithTheCpuGather) {
  const auto m = std::make_shared<const LocalMatrix>(randomMatrix(3000, 250, 3, 21));
  const auto source = randomSource(m->slots(), 22);
  auto vulkan = makeVulkanGather(context_);
  ASSERT_TRUE(vulkan) << vulkan.error().line();
  const std::unique_ptr<Solver> cpu = makeCpuGather(2);
  std::vector<Vec4> a(m->slots()), b(m->slots());
  for (auto [solver, out] : {std::pair<Solver*, std::vector<Vec4>*>(vulkan->get(), &a), {cpu.get(), &b}}) {
    ASSERT_TRUE(setMatrix(*solver, *m));
    ASSERT_TRUE(solver->setSource(source));
    ASSERT_TRUE(solver->iterate(12));
    ASSERT_TRUE(solver->radiosity(*out));
  }
  const double both = 2 * tolerance(*m, 12);  // each may err by one tolerance
  for (uint32_t s = 0; s < m->slots(); ++s) {
    ASSERT_NEAR(a[s].x, b[s].x, both * static_cast<double>(b[s].x) + 1e-30) << "slot " << s;
    ASSERT_NEAR(a[s].y, b[s].y, both * static_cast<double>(b[s].y) + 1e-30) << "slot " << s;
    ASSERT_NEAR(a[s].z, b[s].z, both * static_cast<double>(b[s].z) + 1e-30) << "slot " << s;
  }
}

TEST_F(VkGather, StartsFromTheWarmStart) { expectAgrees(randomMatrix(500, 100, 2, 4), 3, {}, true); }

TEST_F(VkGather, HandlesRowsOfEveryShortLength) {
  for (uint32_t longest = 1; longest <= 20; ++longest) expectAgrees(randomMatrix(40, longest, 1, 100 + longest), 3);
}

TEST_F(VkGather, HandlesAMatrixWithoutEntries) { expectAgrees(randomMatrix(300, 0, 1, 5), 2); }

TEST_F(VkGather, HandlesASingleSlot) {
  LocalMatrix m = randomMatrix(1, 0, 0, 6);
  expectAgrees(m, 3);
  // A closed box of one slot that sees only itself: B -> M / (1 - albedo).
  m.albedo[0] = {0.5f, 0.9f, 0.25f, 0};
  m.entries = {1024};
  m.row_start = {0, 1};
  m.row_scale = {1.0f / 1024};
  finishByHand(m);
  auto solver = makeVulkanGather(context_);
  ASSERT_TRUE(solver) << solver.error().line();
  ASSERT_TRUE(setMatrix(**solver, m));
  ASSERT_TRUE((*solver)->setSource(std::vector<Vec4>{{1, 1, 1, 0}}));
  ASSERT_TRUE((*solver)->iterate(300));
  std::vector<Vec4> b(1);
  ASSERT_TRUE((*solver)->radiosity(b));
  EXPECT_NEAR(b[0].x, 2, 1e-5);
  EXPECT_NEAR(b[0].y, 10, 1e-4);  // the fixed point amplifies rounding by 1 / (1 - albedo)
  EXPECT_NEAR(b[0].z, 4.0 / 3, 1e-5);
}

TEST_F(VkGather, HandlesAllSlotsThatAnEntryCanName) {
  LocalMatrix m = randomMatrix(50000, 60, 0, 7);
  for (int levels = 1; m.slots() < 60000; ++levels) m = randomMatrix(50000, 60, levels, 7);
  const uint32_t refined = m.slots() - 50000;
  m = randomMatrix(kMaxSlots - refined, 8, 0, 8);
  // Refined slots on top, one child each from the end, so that the last slot is written and read.
  const uint32_t leaves = m.slots();
  m.refined_level_start = {0, refined};
  for (uint32_t i = 0; i < refined; ++i) {
    m.refined.push_back({leaves + i, leaves - 1 - i, leaves - 1 - i});
    m.albedo.push_back({});
    m.area_m2.push_back(1);
    m.leaf.push_back(0);
    m.row_scale.push_back(1);
    m.row_start.push_back(0);
  }
  m.row_start.push_back(static_cast<uint32_t>(m.entries.size()));
  for (uint32_t r = 0; r < refined; ++r) m.row_start[leaves + r] = m.row_start.back();
  finishByHand(m);
  for (uint32_t& e : m.entries)
    if (e % 7 == 0) e = packEntry(kMaxSlots - 1 - e % refined, countOfEntry(e));
  ASSERT_EQ(m.slots(), kMaxSlots);
  expectAgrees(m, 4, {.slots = kMaxSlots});
}

TEST_F(VkGather, SplitsEntriesThatExceedTheBindingRange) {
  const LocalMatrix m = randomMatrix(1500, 200, 2, 9);
  // 256 rows of a tile stay together: 200 entries each at most, in up to 16 words more, and room to round up.
  const uint64_t largest_tile = 256 * (200 + 16 + 8) * sizeof(uint32_t);
  for (uint64_t bytes : {largest_tile, 2 * largest_tile + 48, uint64_t{1} << 20})
    expectAgrees(m, 6, {.entry_bytes = 8 * largest_tile, .max_binding_bytes = bytes});
  auto solver = makeVulkanGather(context_, {.entry_bytes = 1 << 16, .max_binding_bytes = 1024});
  ASSERT_TRUE(solver) << solver.error().line();
  const auto refused = setMatrix(**solver, m);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().cause, ErrorCause::kOutOfDeviceMemory);
}

TEST_F(VkGather, TakesAnotherMatrixAndForgetsTheLast) {
  auto solver = makeVulkanGather(context_);
  ASSERT_TRUE(solver);
  for (uint32_t leaves : {900u, 30u, 2500u}) {
    const LocalMatrix m = randomMatrix(leaves, 90, 2, leaves);
    const auto source = randomSource(m.slots(), leaves);
    ASSERT_TRUE(setMatrix(**solver, m));
    ASSERT_TRUE((*solver)->setSource(source));
    ASSERT_TRUE((*solver)->iterate(4));
    std::vector<Vec4> got(m.slots());
    ASSERT_TRUE((*solver)->radiosity(got));
    const auto want = reference(m, source, std::vector<Rgb>(m.slots()), 4);
    for (uint32_t s = 0; s < m.slots(); ++s)
      ASSERT_NEAR(got[s].y, want[s].v[1], tolerance(m, 4) * want[s].v[1] + 1e-30) << "slot " << s;
  }
}

// What a frame that waits for the device costs: one submission, and nothing taken from the driver.
TEST_F(VkGather, ASubmissionBringsItsLightAlong) {
  auto solver = makeVulkanGather(context_);
  ASSERT_TRUE(solver);
  const LocalMatrix m = randomMatrix(900, 90, 2, 3);
  ASSERT_TRUE(setMatrix(**solver, m));
  std::vector<Vec4> seen(m.slots()), again(m.slots());
  for (int frame = 0; frame < 3; ++frame) {
    const auto source = randomSource(m.slots(), static_cast<uint64_t>(frame));
    ASSERT_TRUE((*solver)->setSource(source));
    const uint64_t before = context_->submissions();
    ASSERT_TRUE((*solver)->iterate(2));
    ASSERT_TRUE((*solver)->radiosity(seen));
    EXPECT_EQ(context_->submissions() - before, 1u);
  }
  const std::vector<Vec4> given(m.slots(), Vec4{5, 6, 7, 0});  // light that came otherwise is seen as well
  ASSERT_TRUE((*solver)->setRadiosity(given));
  ASSERT_TRUE((*solver)->radiosity(again));
  EXPECT_EQ(again[0].y, 6);
}

// Synchronisation validation does not see a missing barrier between two dispatches that write one buffer, so the
// barriers are tested by results: many iterations over a chain in which every iteration needs the last one's light.
TEST_F(VkGather, GivesTheSameBitsEveryTime) {
  const auto m = std::make_shared<const LocalMatrix>(randomMatrix(6000, 100, 3, 11));
  const auto source = randomSource(m->slots(), 12);
  std::vector<Vec4> first;
  for (int repeat = 0; repeat < 20; ++repeat) {
    auto solver = makeVulkanGather(context_);
    ASSERT_TRUE(solver);
    ASSERT_TRUE(setMatrix(**solver, *m));
    ASSERT_TRUE((*solver)->setSource(source));
    ASSERT_TRUE((*solver)->iterate(20));
    std::vector<Vec4> b(m->slots());
    ASSERT_TRUE((*solver)->radiosity(b));
    if (first.empty()) first = b;
    for (uint32_t s = 0; s < m->slots(); ++s)
      ASSERT_TRUE(b[s].x == first[s].x && b[s].y == first[s].y && b[s].z == first[s].z) << "slot " << s;
  }
}

// The gate that all tests above lean on: a wrong call does leave a message.
TEST_F(VkGather, BadNumbersLeaveNoTrace) {
  const LocalMatrix m = randomMatrix(700, 100, 2, 31, 0.8);
  const auto make = [&] {
    auto solver = makeVulkanGather(context_);
    EXPECT_TRUE(solver);
    return std::move(*solver);
  };
  expectBadNumbersLeaveNoTrace(make, m, tolerance(m, 10));  // of the steps whose light still counts: 0.7^10 = 0.03
  expectAStepKeepsNothingUnsound(make, m);
}

// As CpuGather.ApproachSettlesAClosedBoxInAFourthOfTheSteps.
TEST_F(VkGather, ApproachSettlesInHalfTheStepsAsOnTheCpu) {
  // A ring whose slots see their four neighbours to either side and nothing else: reciprocal, and it keeps its light.
  LocalMatrix m;
  constexpr uint32_t kSlots = 300, kSide = 4;
  m.albedo.assign(kSlots, {0.98f, 0.97f, 0.9f, 0});
  m.area_m2.assign(kSlots, 1);
  m.leaf.assign(kSlots, 1);
  m.row_scale.assign(kSlots, 1.0f / (2 * kSide));
  for (uint32_t s = 0; s < kSlots; ++s) {
    m.row_start.push_back(8 * s);
    for (uint32_t k = 1; k <= kSide; ++k)
      for (const uint32_t column : {(s + k) % kSlots, (s + kSlots - k) % kSlots}) m.entries.push_back(packEntry(column, 1));
  }
  m.row_start.push_back(8 * kSlots);
  m.refined_level_start = {0};
  finishByHand(m);
  const std::vector<Vec4> source = randomSource(m.slots(), 33);
  const std::vector<Rgb> want = reference(m, source, std::vector<Rgb>(m.slots()), 3000);
  const auto errorAfter = [&](Solver& solver, const std::function<Result<void>()>& steps) {
    EXPECT_TRUE(setMatrix(solver, m));
    EXPECT_TRUE(solver.setSource(source));
    EXPECT_TRUE(steps());
    std::vector<Vec4> got(m.slots());
    EXPECT_TRUE(solver.radiosity(got));
    double error = 0, norm = 0;
    for (const uint32_t s : m.leaves) {
      const float g[3] = {got[s].x, got[s].y, got[s].z};
      for (int c = 0; c < 3; ++c) {
        error += std::pow(static_cast<double>(g[c]) - want[s].v[c], 2);
        norm += std::pow(want[s].v[c], 2);
      }
    }
    return std::sqrt(error / norm);
  };
  auto vulkan = makeVulkanGather(context_);
  ASSERT_TRUE(vulkan);
  const auto cpu = makeCpuGather(2);
  const double jacobi = errorAfter(**vulkan, [&] { return (*vulkan)->iterate(160); });
  const auto fourTimes = [](Solver& solver) {  // each call knows better how slowly light decays
    for (int i = 0; i < 3; ++i)
      if (auto approached = solver.approach(20); !approached) return approached;
    return solver.approach(20);
  };
  const double approached = errorAfter(**vulkan, [&] { return fourTimes(**vulkan); });
  const double on_cpu = errorAfter(*cpu, [&] { return fourTimes(*cpu); });
  EXPECT_LT(approached, 0.5 * jacobi);
  EXPECT_NEAR(approached, on_cpu, 0.1 * on_cpu);  // what one of 80 steps is worth: how fast light decays is learnt from rounded steps, and code for another processor rounds its own way (0.07 on an AMD EPYC)
}

TEST(VkContext, KeepsTheMessagesOfTheValidationLayers) {
  auto c = openVulkan({.device = "auto", .validate = true, .gpu_assisted = false});
  if (!c) GTEST_SKIP() << "no Vulkan device with validation layers, nothing was tested: " << c.error().line();
  EXPECT_TRUE(validationMessages(**c).empty());
  {
    auto from = Buffer::create(**c, 64, 0);
    auto to = Buffer::create(**c, 32, 0);
    ASSERT_TRUE(from && to);
    VkBufferMemoryBarrier unfit{};  // has no sType
    unfit.buffer = from->handle();
    unfit.size = VK_WHOLE_SIZE;
    ASSERT_TRUE((*c)->run([&](VkCommandBuffer commands) {
      vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, nullptr, 1,
                           &unfit, 0, nullptr);
      const VkBufferCopy half{0, 0, 32}, other_half{32, 0, 32};  // both write to the same bytes, no barrier between
      vkCmdCopyBuffer(commands, from->handle(), to->handle(), 1, &half);
      vkCmdCopyBuffer(commands, from->handle(), to->handle(), 1, &other_half);
    }));
  }
  bool core = false, hazard = false;
  for (const std::string& message : validationMessages(**c)) {
    core |= message.find("VUID-VkBufferMemoryBarrier") != std::string::npos;
    hazard |= message.find("SYNC-HAZARD-WRITE-AFTER-WRITE") != std::string::npos;
  }
  EXPECT_TRUE(core);
  EXPECT_TRUE(hazard);
}

TEST(VkContext, NamesTheDevicesThatExistWhenTheWantedOneDoesNot) {
  auto all = openVulkan();
  if (!all) GTEST_SKIP() << "no Vulkan device, nothing was tested: " << all.error().line();
  auto none = openVulkan({.device = "no such device", .validate = false, .gpu_assisted = false});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kIo);
  EXPECT_NE(none.error().line().find(deviceName(**all)), std::string::npos) << none.error().line();
}

}  // namespace
}  // namespace ff::runtime
