// Light that follows a change of the cut on Vulkan: the cases of the CPU's solvers, and what engines read while tiles fade out.
#include <cstring>

#include "runtime/dense/cpu_multibounce.h"
#include "runtime/gather/vk_recorder.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "tests/runtime/solver/ease_cases.h"
#include "tests/runtime/vulkan/validated_vulkan.h"

namespace ff::runtime {
namespace {

const std::shared_ptr<VkContext>& validated() {
  static const std::shared_ptr<VkContext> context = [] {
    auto opened = openVulkan({.device = "auto", .validate = true, .gpu_assisted = false});
    return opened ? *opened : nullptr;
  }();
  return context;
}

std::vector<std::string> complaints() { return validated() ? validationMessages(*validated()) : std::vector<std::string>(); }

template <class Make>
EaseCase onDevice(const char* name, uint32_t side, Make&& make) {
  return {name, side, [make]() -> std::unique_ptr<Solver> {
            if (!validated()) return nullptr;
            auto made = make(validated());
            if (!made) throw std::runtime_error(made.error().line());
            return std::move(*made);
          }, complaints};
}

const VulkanGatherSettings kRoom{.slots = 8192, .tiles = 512, .pages = 512, .packed_bytes = 4 << 20, .entry_bytes = 8 << 20};

INSTANTIATE_TEST_SUITE_P(
    Vulkan, Ease,
    testing::Values(onDevice("Gather", 32, [](auto context) { return makeVulkanGather(context, kRoom); }),
                    // Rows in several ranges of memory.
                    onDevice("GatherInSegments", 32, [](auto context) {
                      VulkanGatherSettings room = kRoom;
                      room.entry_bytes = 1 << 18;
                      room.max_binding_bytes = 1 << 15;
                      return makeVulkanGather(context, room);
                    }),
                    onDevice("Multibounce", 16, [](auto context) { return makeVulkanDenseRecorder(context, kRoom, {.places = 512}); })),
    [](const auto& each) { return each.param.name; });

class VkShine : public ValidatedVulkan {};
class VkEase : public ValidatedVulkan {};

// With places for some of the leaves alone: the first step after a change of the cut, from light that has settled. Matrices are in fp32.
TEST_F(VkEase, MultibounceFollowsAChangeOfTheCutAsOnTheCpu) {
  const TestWorld test({.side = 32, .tile_nodes = 40, .seed = 2});
  const MultibounceSettings dense{.places = 128};
  auto vulkan = makeVulkanDenseRecorder(context_, kRoom, dense);
  ASSERT_TRUE(vulkan) << vulkan.error().line();
  auto matrix = makeCpuMultibounce(dense);
  ASSERT_TRUE(matrix) << matrix.error().line();
  const auto cpu = makeDenseSolver(std::move(*matrix), {.threads = 1});
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  uint32_t more_leaves = 0;
  for (uint64_t cut = 0; cut < 6; ++cut) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.8 + 0.05 * static_cast<double>(cut % 3), cut)));
    more_leaves += m.leaves.size() > dense.places;
    for (Solver* solver : {static_cast<Solver*>(vulkan->get()), static_cast<Solver*>(cpu.get())}) {
      solver->ease(kEaseFrames);
      ASSERT_TRUE(solver->update(m, assembler.change()) && solver->setSource(sourceOf(m)) && solver->iterate(1));
    }
    const std::vector<Vec4> a = lightOf(**vulkan, m), b = lightOf(*cpu, m);
    for (size_t i = 0; cut > 0 && i < m.leaves.size(); ++i) {
      const uint32_t s = m.leaves[i];
      ASSERT_LT(distance(a[s], b[s]), 1e-3f * (1 + b[s].x + b[s].y + b[s].z)) << "cut " << cut << ", slot " << s;
    }
    for (uint32_t frame = 0; frame <= kEaseFrames; ++frame) ASSERT_TRUE((*vulkan)->iterate(30) && cpu->iterate(30));
  }
  EXPECT_GT(more_leaves, 2u);
}

// Two observers fly through the world while its cut changes: what is at hand, near, and beyond has another pace.
TEST_F(VkEase, LightKeepsThePaceThatItKeepsOnTheCpu) {
  const TestWorld test({.side = 32, .tile_nodes = 40, .seed = 2});
  const std::vector<float> radii_m{3, 9, 16, 24, 32, 40, 50, 60};
  auto vulkan = makeVulkanGather(context_, kRoom);
  ASSERT_TRUE(vulkan) << vulkan.error().line();
  const auto cpu = makeCpuGather(1), unlimited = makeCpuGather(1);
  Solver* const solvers[] = {vulkan->get(), cpu.get(), unlimited.get()};
  MatrixAssembler assembler(test.world());
  const LocalMatrix& m = assembler.matrix();
  float limited = 0;
  LightPace pace{.radii_m = radii_m, .frame_seconds = 1.0f / 60, .most_change = 0.01f};
  for (uint64_t cut = 0; cut < 5; ++cut) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.5 + 0.1 * static_cast<double>(cut % 3), cut)));
    for (Solver* const solver : solvers) {
      solver->ease(4);
      ASSERT_TRUE(solver->update(m, assembler.change()) && solver->setSource(sourceOf(m)));
      ASSERT_TRUE(solver->iterate(cut == 0 ? 300 : 1));
    }
    for (int frame = 0; frame < 12; ++frame) {
      const float way_m = 0.1f * static_cast<float>(12 * static_cast<int>(cut) + frame);
      const stream::Observer observers[] = {{{way_m, 1, 8}, {6, 0, 0}}, {{30, 1, 31 - way_m}, {0, 0, -6}}};
      pace.observers = std::span<const stream::Observer>(observers);
      std::vector<std::vector<Vec4>> light;
      for (Solver* const solver : solvers) {
        if (solver != unlimited.get()) solver->pace(pace);
        ASSERT_TRUE(solver->iterate(1));
        light.push_back(lightOf(*solver, m));
      }
      for (const uint32_t s : m.leaves) {
        const Vec4& b = light[1][s];
        ASSERT_LT(distance(light[0][s], b), 1e-4f * (1 + b.x + b.y + b.z)) << "cut " << cut << ", frame " << frame << ", slot " << s;
        limited = std::max(limited, distance(b, light[2][s]));
      }
    }
  }
  EXPECT_GT(limited, 0.1f);
}

// What is shown is the same, to the bit, whether all emission or that of what entered is given with each cut, and what has left shows none.
TEST_F(VkShine, EmissionOfWhatEnteredIsAsGoodAsAll) {
  const TestWorld test({.side = 32, .tile_nodes = 40, .seed = 3});
  std::vector<std::vector<Vec4>> shown;
  uint32_t free = 0;
  for (const bool entered_alone : {false, true}) {
    auto made = makeVulkanRecorder(context_, kRoom);
    ASSERT_TRUE(made) << made.error().line();
    VulkanRecorder& recorder = **made;
    MatrixAssembler assembler(test.world());
    const LocalMatrix& m = assembler.matrix();
    for (uint64_t step = 0; step < 6; ++step) {
      ASSERT_TRUE(assembler.update(test.randomCut(0.5 + 0.1 * static_cast<double>(step % 3), 10 + step)));
      const MatrixChange& change = assembler.change();
      ASSERT_TRUE(recorder.update(m, change));
      ASSERT_TRUE(recorder.setSource(sourceOf(m)));
      const std::vector<Vec4> emission = sourceOf(m, 2);  // by node, and none of free slots
      ASSERT_TRUE(entered_alone && !change.renumbered ? recorder.setEnteredEmission(emission, change) : recorder.setEmission(emission));
      auto copied = Buffer::create(*context_, m.slots() * sizeof(Vec4), VK_BUFFER_USAGE_TRANSFER_DST_BIT, MemoryUse::kHost);
      ASSERT_TRUE(copied) << copied.error().line();
      Result<void> recorded;
      ASSERT_TRUE(context_->run([&](VkCommandBuffer commands) {
        recorded = recorder.record(commands, 2);
        const VkBufferCopy copy{0, 0, m.slots() * sizeof(Vec4)};
        vkCmdCopyBuffer(commands, recorder.radiosityBuffer(), copied->handle(), 1, &copy);
        barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT);
      }));
      ASSERT_TRUE(recorded);
      std::vector<Vec4>& light = shown.emplace_back(m.slots());
      std::memcpy(light.data(), copied->mapped(), m.slots() * sizeof(Vec4));
      for (uint32_t s = 0; s < m.slots(); ++s) {
        if (m.leaf[s]) continue;
        bool used = false;
        for (const SlotRange& range : m.tiles) used = used || s - range.first_slot < range.nodes;
        if (used) continue;
        ++free;
        ASSERT_EQ(light[s].x + light[s].y + light[s].z, 0) << "free slot " << s;
      }
    }
  }
  EXPECT_GT(free, 0u);
  for (size_t step = 0; step < 6; ++step) {
    ASSERT_EQ(shown[step].size(), shown[6 + step].size());
    for (size_t s = 0; s < shown[step].size(); ++s) ASSERT_EQ(distance(shown[step][s], shown[6 + step][s]), 0) << "step " << step << ", slot " << s;
  }
}

TEST_F(VkShine, WhatFadesIsSeenAsItsParentsIrradiance) {
  const TestWorld test({.side = 32, .tile_nodes = 40, .seed = 3});
  auto made = makeVulkanRecorder(context_, kRoom);
  ASSERT_TRUE(made) << made.error().line();
  VulkanRecorder& recorder = **made;
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(test.randomCut(0.5, 1)));
  const LocalMatrix& m = assembler.matrix();
  ASSERT_TRUE(recorder.update(m, assembler.change()));
  ASSERT_TRUE(recorder.setSource(sourceOf(m)));
  std::vector<Vec4> emission(m.slots());
  for (uint32_t s = 0; s < m.slots(); ++s) emission[s] = {static_cast<float>(s % 3), 0, static_cast<float>(s % 2), 0};
  ASSERT_TRUE(recorder.setEmission(emission));
  auto copied = Buffer::create(*context_, m.slots() * sizeof(Vec4), VK_BUFFER_USAGE_TRANSFER_DST_BIT, MemoryUse::kHost);
  ASSERT_TRUE(copied) << copied.error().line();
  const auto shown = [&](std::span<const shaders::FadingSlots> fading) {
    Result<void> recorded;
    EXPECT_TRUE(context_->run([&](VkCommandBuffer commands) {
      recorder.setFading(fading);
      recorded = recorder.record(commands, 3);
      const VkBufferCopy copy{0, 0, m.slots() * sizeof(Vec4)};
      vkCmdCopyBuffer(commands, recorder.radiosityBuffer(), copied->handle(), 1, &copy);
      barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT);
    }));
    EXPECT_TRUE(recorded);
    std::vector<Vec4> light(m.slots());
    std::memcpy(light.data(), copied->mapped(), m.slots() * sizeof(Vec4));
    return light;
  };
  // Of each tile two runs of slots, some of which show all that is theirs.
  std::vector<float> weights(m.slots(), 1);
  std::vector<shaders::FadingSlots> fading_slots;
  for (const SlotRange& range : m.tiles)
    for (const auto& [first, nodes] : {std::pair{0u, range.nodes / 2}, std::pair{range.nodes / 2, range.nodes - range.nodes / 2}}) {
      const size_t turn = fading_slots.size() % 4;
      const float own = turn == 0 ? 0.0f : turn == 1 ? 0.25f : turn == 2 ? 0.75f : 1.0f;
      fading_slots.push_back({range.first_slot + first, nodes, own});
      std::fill_n(weights.begin() + range.first_slot + first, nodes, own);
    }
  const std::vector<Vec4> fading = shown(fading_slots);
  std::vector<Vec4> expected = lightOf(recorder, m);  // what is reflected, past any weight
  for (size_t t = m.tiles.size(); t-- > 0;)           // parents first
    for (uint32_t s = m.tiles[t].first_slot; s < m.tiles[t].first_slot + m.tiles[t].nodes; ++s) {
      if (m.parent_slot[s] == kNoSlot) continue;
      const uint32_t parent = m.parent_slot[s];
      const float w = weights[s];
      const Vec4 above = onAlbedo(expected[parent], m.albedo[parent], m.albedo[s], expected[s]);
      expected[s] = expected[s] * Vec4{w, w, w, 0} + above * Vec4{1 - w, 1 - w, 1 - w, 0};
    }
  uint32_t blended = 0;
  for (const SlotRange& range : m.tiles)
    for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
      const Vec4 sum = expected[s] + emission[s];
      ASSERT_LT(distance(fading[s], sum), 1e-5f * (1 + sum.x + sum.y + sum.z)) << "slot " << s;
      blended += weights[s] < 1 && m.parent_slot[s] != kNoSlot;
    }
  EXPECT_GT(blended, m.leaves.size() / 2);
  // They count for one record, also where others fade then.
  const shaders::FadingSlots top{m.tiles.back().first_slot, m.tiles.back().nodes, 0};  // which has no parents
  for (const auto& others : {std::span<const shaders::FadingSlots>(), std::span(&top, 1)}) {
    const std::vector<Vec4> whole = shown(others);
    const std::vector<Vec4> own = lightOf(recorder, m);
    for (const uint32_t s : m.leaves) ASSERT_LT(distance(whole[s], own[s] + emission[s]), 1e-5f * (1 + own[s].x + own[s].y + own[s].z));
  }
}

}  // namespace
}  // namespace ff::runtime
