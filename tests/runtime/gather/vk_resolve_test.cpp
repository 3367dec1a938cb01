// The gather on Vulkan over the cuts of a synthetic world: rows are resolved on the device, entry for entry what the
// assembler finds; radiosity agrees with the CPU through every change of the cut; frames are recorded into the caller's
// command buffers. Run once per subgroup size that lavapipe has, under synchronisation validation, which must stay silent.
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "runtime/cut/matrix_assembler.h"
#include "runtime/gather/gather_layout.h"
#include "runtime/gather/vk_recorder.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "tests/runtime/test_world.h"
#include "tests/runtime/vulkan/validated_vulkan.h"

namespace ff::runtime {
namespace {

const VulkanGatherSettings kFewSlots{
    .slots = 4096, .tiles = 512, .pages = 1024, .packed_bytes = 2 << 20, .entry_bytes = 2 << 20};

std::vector<Vec4> lightOf(const LocalMatrix& m, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<Vec4> source(m.slots());
  for (Vec4& v : source)
    v = {static_cast<float>(random() % 100), static_cast<float>(random() % 100), static_cast<float>(random() % 7), 0};
  return source;
}

void expectSameRows(VulkanRecorder& solver, const LocalMatrix& m) {
  uint64_t entries = 0;
  for (uint32_t slot = 0; slot < m.slots(); ++slot) {
    if (!m.leaf[slot]) continue;
    const auto row = resolvedRow(solver, slot);
    ASSERT_TRUE(row) << row.error().line();
    const auto want = m.row(slot);
    ASSERT_TRUE(std::equal(row->begin(), row->end(), want.begin(), want.end()))
        << "slot " << slot << ": " << row->size() << " entries, " << want.size() << " expected";
    entries += want.size();
  }
  EXPECT_EQ(entries, m.used_entries);
}

// Rows here have at most 48 * 64 quanta and so at most some hundred entries; sums of positive terms in any order, a few
// iterations, levels of means: 2e-5 is some hundred roundings. Free slots are dark whatever they held.
void expectSameLight(std::span<const Vec4> a, std::span<const Vec4> b, const LocalMatrix& m) {
  std::vector<uint8_t> in_use(m.slots(), 0);
  for (const SlotRange& t : m.tiles) std::fill_n(in_use.begin() + t.first_slot, t.nodes, uint8_t{1});
  for (uint32_t s = 0; s < m.slots(); ++s) {
    if (!in_use[s] && s != m.ambient_slot) {
      ASSERT_EQ(a[s].x + b[s].x, 0) << "slot " << s;
    }
    if (!in_use[s]) continue;
    ASSERT_NEAR(a[s].x, b[s].x, 2e-5f * b[s].x + 1e-20f) << "slot " << s;
    ASSERT_NEAR(a[s].y, b[s].y, 2e-5f * b[s].y + 1e-20f) << "slot " << s;
    ASSERT_NEAR(a[s].z, b[s].z, 2e-5f * b[s].z + 1e-20f) << "slot " << s;
  }
}

class VkResolve : public ValidatedVulkan {
 protected:
  std::unique_ptr<VulkanRecorder> make(const VulkanGatherSettings& settings) {
    auto made = makeVulkanRecorder(context_, settings);
    EXPECT_TRUE(made) << (made ? "" : made.error().line());
    return made ? std::move(*made) : nullptr;
  }
};

TEST_F(VkResolve, FindsTheAssemblersEntriesBitForBitThroughEveryChangeOfTheCut) {
  for (const FarLight far_light : {FarLight::kPyramid, FarLight::kConstant}) {
    const TestWorld test({.side = 16, .tile_nodes = 24, .equal_areas = false, .seed = 5});
    MatrixAssembler assembler(test.world(), far_light);
    const auto solver = make(kFewSlots);
    ASSERT_TRUE(solver);
    for (uint64_t step = 0; step < 8; ++step) {
      SCOPED_TRACE(step);
      ASSERT_TRUE(assembler.update(test.randomCut(step % 4 == 3 ? 0.0 : 0.6, step, step % 3 == 1)));
      if (step % 2 == 1) assembler.pack();
      const auto updated = solver->update(assembler.matrix(), assembler.change());
      ASSERT_TRUE(updated) << updated.error().line();
      expectSameRows(*solver, assembler.matrix());
    }
  }
}

TEST_F(VkResolve, CarriesLightOverEveryChangeAsTheCpuDoes) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 6});
  MatrixAssembler assembler(test.world());
  const auto vulkan = make(kFewSlots);
  ASSERT_TRUE(vulkan);
  const auto cpu = makeCpuGather(1);
  for (uint64_t step = 0; step < 12; ++step) {
    SCOPED_TRACE(step);
    ASSERT_TRUE(assembler.update(test.randomCut(step % 5 == 4 ? 1.0 : 0.5, step, step % 3 == 1)));
    const LocalMatrix& m = assembler.matrix();
    const auto source = lightOf(m, step);
    for (Solver* s : {static_cast<Solver*>(vulkan.get()), cpu.get()}) {
      const auto updated = s->update(m, assembler.change());
      ASSERT_TRUE(updated) << updated.error().line();
      ASSERT_TRUE(s->setSource(source));
      ASSERT_TRUE(s->iterate(3));  // few, so that what was carried over still shows
    }
    std::vector<Vec4> a(m.slots()), b(m.slots());
    ASSERT_TRUE(vulkan->radiosity(a) && cpu->radiosity(b));
    expectSameLight(a, b, m);
    EXPECT_GT(vulkan->lastMs(), 0);
  }
}

TEST_F(VkResolve, UploadsOnlyWhatEntered) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 7});
  MatrixAssembler assembler(test.world());
  const auto solver = make(kFewSlots);
  ASSERT_TRUE(solver);
  Cut cut = test.randomCut(1.0, 1);
  ASSERT_TRUE(assembler.update(cut));
  ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
  const uint64_t everything = solver->uploaded().rows;
  const auto without = cut;
  cut.erase(cut.begin());  // one tile of the finest level
  for (const Cut& next : {cut, without}) {
    const uint64_t before = solver->uploaded().rows;
    ASSERT_TRUE(assembler.update(next));
    ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
    EXPECT_LT(solver->uploaded().rows - before, everything / 4);
    expectSameRows(*solver, assembler.matrix());
  }
}

// Of what surfaces reflect without a bounce, and of what they emit: all where the light changes, else what entered.
TEST_F(VkResolve, UploadsTheLightOfWhatEnteredAlone) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 7});
  MatrixAssembler assembler(test.world());
  const auto solver = make(kFewSlots);
  ASSERT_TRUE(solver);
  const LocalMatrix& m = assembler.matrix();
  uint64_t before = 0;
  const auto uploaded = [&] { return solver->uploaded().light - std::exchange(before, solver->uploaded().light); };
  ASSERT_TRUE(assembler.update(test.randomCut(0.6, 1)));
  ASSERT_TRUE(solver->update(m, assembler.change()));
  ASSERT_TRUE(solver->setSource(lightOf(m, 1)) && solver->setEmission(lightOf(m, 2)) && solver->iterate(1));
  EXPECT_EQ(uploaded(), 2 * m.slots() * sizeof(Vec4));
  uint64_t entered = 0;
  for (uint64_t step = 2; step < 8; ++step) {
    ASSERT_TRUE(assembler.update(test.randomCut(0.6, step)));
    const MatrixChange& change = assembler.change();
    ASSERT_FALSE(change.renumbered);
    ASSERT_TRUE(solver->update(m, change));
    ASSERT_TRUE(solver->setEnteredSource(lightOf(m, step), change, false) && solver->setEnteredEmission(lightOf(m, step), change) && solver->iterate(1));
    uint64_t nodes = 0;
    for (const uint32_t t : change.entered) nodes += m.tiles[t].nodes;
    EXPECT_EQ(uploaded(), 2 * nodes * sizeof(Vec4)) << "step " << step;
    entered += nodes;
    ASSERT_TRUE(solver->iterate(1));
    EXPECT_EQ(uploaded(), 0u);
  }
  EXPECT_GT(entered, 0u);
  ASSERT_TRUE(solver->setSource(lightOf(m, 9)) && solver->iterate(1));
  EXPECT_EQ(uploaded(), m.slots() * sizeof(Vec4));
}

// Vectors of entries that the tiles of a matrix take, as GatherLayout counts them.
uint64_t vectorsOf(const LocalMatrix& m) {
  uint64_t vectors = 0;
  for (const auto& p : m.packed) vectors += (p.strip->row_start.back() + 3) / 4 + p.strip->nodes.size();
  return vectors;
}

// Room that is just enough becomes fragmented; then all tiles are placed anew, those that nobody has packed too, and nothing else changes.
TEST_F(VkResolve, SurvivesFragmentedRoomAndSeveralSegments) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 8});
  constexpr uint64_t kSteps = 12;
  const auto cutAt = [&](uint64_t step) { return test.randomCut(0.8 + 0.05 * static_cast<double>(step % 4), step); };
  VulkanGatherSettings tight = kFewSlots;
  uint64_t most = 0;
  {
    MatrixAssembler assembler(test.world());
    for (uint64_t step = 0; step < kSteps; ++step) {
      ASSERT_TRUE(assembler.update(cutAt(step)));
      most = std::max(most, vectorsOf(assembler.matrix()));
    }
  }
  int placed_anew = 0;
  for (const uint64_t binding : {uint64_t{64} << 10, uint64_t{128} << 20}) {
    // One binding: hardly more than the largest cut takes. Several: what is lost at their ends, too.
    const bool several = binding < most * 16;
    tight.max_binding_bytes = binding;
    tight.entry_bytes = several ? (most * 16 * 11 / 10 / binding + 1) * binding : (most * 16 / 256 + 1) * 256;
    MatrixAssembler assembler(test.world());
    const auto cpu = makeCpuGather(1);
    const auto vulkan = make(tight);
    ASSERT_TRUE(vulkan);
    const uint64_t segment = std::min(binding, tight.entry_bytes);
    GatherLayout layout({tight.packed_bytes / 4, segment / 16, static_cast<uint32_t>(tight.entry_bytes / segment), tight.tiles});
    for (uint64_t step = 0; step < kSteps; ++step) {
      ASSERT_TRUE(assembler.update(cutAt(step)));
      if (step % 2 == 1) assembler.pack();
      const LocalMatrix& m = assembler.matrix();
      const auto source = lightOf(m, step);
      for (Solver* s : {static_cast<Solver*>(vulkan.get()), cpu.get()}) {
        const auto updated = s->update(m, assembler.change());
        ASSERT_TRUE(updated) << updated.error().line();
        ASSERT_TRUE(s->setSource(source) && s->iterate(2));
      }
      std::vector<Vec4> a(m.slots()), b(m.slots());
      ASSERT_TRUE(vulkan->radiosity(a) && cpu->radiosity(b));
      expectSameLight(a, b, m);
      if (step % 4 == 1) expectSameRows(*vulkan, m);
      ASSERT_TRUE(layout.update(m, assembler.change(), step == 0));
      placed_anew += std::any_of(layout.tiles().begin(), layout.tiles().end(),
                                 [](const GatherLayout::Tile& t) { return t.placed && !t.entered; });
    }
  }
  EXPECT_GT(placed_anew, 0);
  MatrixAssembler assembler(test.world());
  ASSERT_TRUE(assembler.update(cutAt(0)));
  tight.entry_bytes = 8 << 10;
  const auto too_small = make(tight);
  ASSERT_TRUE(too_small);
  const auto refused = too_small->update(assembler.matrix(), {.any = true, .renumbered = true});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().cause, ErrorCause::kOutOfDeviceMemory);
}

// An engine: two command buffers in flight, one submission a frame, nobody waits but for the frame before last.
TEST_F(VkResolve, RecordsFramesIntoTheCallersCommandBuffers) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 9});
  MatrixAssembler assembler(test.world());
  const auto vulkan = make(kFewSlots);
  ASSERT_TRUE(vulkan);
  const auto cpu = makeCpuGather(1);
  constexpr uint32_t kFrames = 2;
  auto pool_info = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.queueFamilyIndex = context_->queueFamily();
  pool_info.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
  VkCommandPool pool = VK_NULL_HANDLE;
  ASSERT_EQ(vkCreateCommandPool(context_->device(), &pool_info, nullptr, &pool), VK_SUCCESS);
  auto info = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  info.commandPool = pool;
  info.commandBufferCount = kFrames;
  VkCommandBuffer commands[kFrames];
  ASSERT_EQ(vkAllocateCommandBuffers(context_->device(), &info, commands), VK_SUCCESS);
  auto copied = Buffer::create(*context_, 4096 * sizeof(Vec4), 0, MemoryUse::kHost);
  ASSERT_TRUE(copied);
  uint64_t submission[kFrames] = {};
  const uint64_t blocks = context_->heap().allocatedBytes();
  for (uint32_t frame = 0; frame < 16; ++frame) {
    const uint32_t f = frame % kFrames;
    if (submission[f]) {
      ASSERT_TRUE(context_->wait(submission[f]));
    }
    // The cut changes in some frames, the light in others.
    if (frame % 3 != 2) {
      ASSERT_TRUE(assembler.update(test.randomCut(0.5, frame)));
      for (Solver* s : {static_cast<Solver*>(vulkan.get()), cpu.get()})
        ASSERT_TRUE(s->update(assembler.matrix(), assembler.change()));
    }
    const LocalMatrix& m = assembler.matrix();
    const auto source = lightOf(m, frame);
    for (Solver* s : {static_cast<Solver*>(vulkan.get()), cpu.get()}) ASSERT_TRUE(s->setSource(source));
    ASSERT_TRUE(cpu->iterate(2));
    auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    ASSERT_EQ(vkBeginCommandBuffer(commands[f], &begin), VK_SUCCESS);
    const auto recorded = vulkan->record(commands[f], 2);
    ASSERT_TRUE(recorded) << recorded.error().line();
    const VkBufferCopy copy{0, 0, m.slots() * sizeof(Vec4)};  // what the engine does with it
    vkCmdCopyBuffer(commands[f], vulkan->radiosityBuffer(), copied->handle(), 1, &copy);
    barrier(commands[f], VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
            VK_ACCESS_HOST_READ_BIT);
    ASSERT_EQ(vkEndCommandBuffer(commands[f]), VK_SUCCESS);
    auto submitted = context_->submit(commands[f]);
    ASSERT_TRUE(submitted);
    submission[f] = *submitted;
    if (frame % 4 != 3) continue;
    ASSERT_TRUE(context_->wait(*submitted));
    std::vector<Vec4> want(m.slots());
    ASSERT_TRUE(cpu->radiosity(want));
    expectSameLight({reinterpret_cast<const Vec4*>(copied->mapped()), m.slots()}, want, m);
  }
  for (const uint64_t s : submission) ASSERT_TRUE(context_->wait(s));
  EXPECT_EQ(context_->heap().allocatedBytes(), blocks);  // no block of device memory was added
  vkDestroyCommandPool(context_->device(), pool, nullptr);
}

TEST_F(VkResolve, GivesTheSameBitsEveryTime) {
  const TestWorld test({.side = 32, .tile_nodes = 32, .seed = 10});
  std::vector<Vec4> first;
  for (int repeat = 0; repeat < 20; ++repeat) {
    MatrixAssembler assembler(test.world());
    const auto solver = make(kFewSlots);
    ASSERT_TRUE(solver);
    for (uint64_t step = 0; step < 3; ++step) {
      ASSERT_TRUE(assembler.update(test.randomCut(0.6, step)));
      ASSERT_TRUE(solver->update(assembler.matrix(), assembler.change()));
      ASSERT_TRUE(solver->setSource(lightOf(assembler.matrix(), step)));
      ASSERT_TRUE(solver->iterate(5));
    }
    std::vector<Vec4> b(assembler.matrix().slots());
    ASSERT_TRUE(solver->radiosity(b));
    if (first.empty()) first = b;
    for (uint32_t s = 0; s < b.size(); ++s)
      ASSERT_TRUE(b[s].x == first[s].x && b[s].y == first[s].y && b[s].z == first[s].z) << "slot " << s;
  }
}

}  // namespace
}  // namespace ff::runtime
