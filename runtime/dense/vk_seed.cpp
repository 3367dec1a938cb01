#include "runtime/dense/vk_seed.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "runtime/dense/vk_baseline.h"
#include "seed_column_comp.h"
#include "seed_delete_comp.h"
#include "seed_double_comp.h"
#include "seed_outer_comp.h"
#include "seed_relight_comp.h"
#include "seed_row_comp.h"
#include "seed_triple_comp.h"
#include "seed_write_comp.h"
#include "shaders/shared.h"

namespace ff::runtime {
namespace {

constexpr uint64_t kElementBytes = 8;

class VulkanSeed final : public VulkanBaseline {
 public:
  VulkanSeed(std::shared_ptr<VkContext> context, uint32_t places)
      : VulkanBaseline(std::move(context), places, "seed vulkan"), places_(places) {}
  Result<void> start();

  uint64_t bytes() const override { return uint64_t{places_} * places_ * kElementBytes; }
  Result<void> remove(std::span<const uint32_t> places) override;
  Result<void> clear() override;

 private:
  Result<void> enter(const EnteringBlock& block) override;
  void clearLight() override { std::fill_n(reinterpret_cast<Vec4*>(up_.mapped()), seats_.used(), Vec4{}); }
  void putLight(uint32_t place, const Vec4& light) override { reinterpret_cast<Vec4*>(up_.mapped())[place] = light; }
  Result<void> multiply() override;
  void addIrradiance(std::span<Vec4> irradiance) const override;
  uint64_t vectorBytes(uint32_t number) const { return uint64_t{number} * places_ * sizeof(Vec4); }
  void formsOf(const EnteringBlock& block, uint32_t r, float* row, float* column);
  void recordPatch(VkCommandBuffer c, const shaders::SeedPush& push) const;

  uint32_t places_;
  ComputePipeline double_, triple_, column_, row_, outer_, write_, delete_, relight_;
  Buffer matrix_, vectors_, forms_;
};

Result<void> VulkanSeed::start() {
  const WantedPipeline pipelines[] = {{&double_, seed_double_comp}, {&triple_, seed_triple_comp},
                                      {&column_, seed_column_comp}, {&row_, seed_row_comp},
                                      {&outer_, seed_outer_comp},   {&write_, seed_write_comp},
                                      {&delete_, seed_delete_comp}, {&relight_, seed_relight_comp}};
  const uint64_t forms_bytes = uint64_t{2} * kMaxBlock * places_ * sizeof(float);
  const WantedBuffer buffers[] = {{&matrix_, bytes(), MemoryUse::kDevice},
                                  {&vectors_, vectorBytes(shaders::kSeedDouble) + sizeof(Vec4), MemoryUse::kDevice},
                                  {&forms_, forms_bytes, MemoryUse::kDevice},
                                  {&up_, std::max(forms_bytes, vectorBytes(1)), MemoryUse::kHost},
                                  {&down_, vectorBytes(1), MemoryUse::kHost}};
  const Buffer* const bound[] = {&matrix_, &vectors_, &forms_};  // bindings of seed.glsl
  if (auto made = make(pipelines, sizeof(shaders::SeedPush), buffers, bound); !made) return made;
  return clear();
}

Result<void> VulkanSeed::clear() {
  auto r = context_->run([&](VkCommandBuffer c) {
    vkCmdFillBuffer(c, matrix_.handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, vectors_.handle(), 0, VK_WHOLE_SIZE, 0);
  });
  if (!r) return r.error();
  seats_.clear();
  return {};
}

// f_row and f_col of the block's patch r, densely; of its own block it sees those that entered before it.
void VulkanSeed::formsOf(const EnteringBlock& block, uint32_t r, float* row, float* column) {
  std::fill_n(row, places_, 0.0f);
  std::fill_n(column, places_, 0.0f);
  for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e)
    if (seats_.taken(block.columns[e])) row[block.columns[e]] = block.row_values[e];
  for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
    column[block.receivers[e]] = block.column_values[e];
  for (uint32_t i = 0; i < r; ++i)
    for (uint32_t e = block.row_start[i]; e < block.row_start[i + 1]; ++e)
      if (block.columns[e] == block.places[r]) column[block.places[i]] = block.row_values[e];
}

// The six update shaders. The third and the fourth need nothing of each other.
void VulkanSeed::recordPatch(VkCommandBuffer c, const shaders::SeedPush& push) const {
  const uint32_t rows_a_group = std::max(1u, shaders::kSeedGroup / std::max(1u, context_->subgroupSize()));
  const uint32_t across = groupsOf(push.used, shaders::kSeedGroup);
  double_.dispatch(c, set_, &push, 1);
  separate(c);
  triple_.dispatch(c, set_, &push, across);
  separate(c);
  column_.dispatch(c, set_, &push, groupsOf(push.used, rows_a_group));
  row_.dispatch(c, set_, &push, groupsOf(push.used, shaders::kSeedColumns));
  separate(c);
  outer_.dispatch(c, set_, &push, across * groupsOf(push.used, shaders::kSeedRows));
  separate(c);
  write_.dispatch(c, set_, &push, across);
  separate(c);
}

Result<void> VulkanSeed::enter(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  auto* forms = reinterpret_cast<float*>(up_.mapped());
  std::array<shaders::SeedPush, kMaxBlock> patches;
  for (uint32_t r = 0; r < k; ++r) {
    const uint32_t place = block.places[r];
    const uint32_t first = 2 * r * places_;
    formsOf(block, r, forms + first, forms + first + places_);
    seats_.take(place);
    patches[r] = {places_, seats_.used(), place, first, block.albedo[r].x, block.albedo[r].y, block.albedo[r].z};
  }
  auto ms = context_->run([&](VkCommandBuffer c) {
    const VkBufferCopy copy{0, 0, uint64_t{2} * k * places_ * sizeof(float)};
    vkCmdCopyBuffer(c, up_.handle(), forms_.handle(), 1, &copy);
    separate(c);
    context_->beginTimed(c);
    for (uint32_t r = 0; r < k; ++r) recordPatch(c, patches[r]);
    context_->endTimed(c);
  });
  if (!ms) return ms.error();
  stats_.last_update_ms = context_->timedMs();
  return {};
}

Result<void> VulkanSeed::remove(std::span<const uint32_t> places) {
  constexpr size_t kPatchesPerSubmit = 1024;
  double ms = 0;
  for (size_t first = 0; first < places.size(); first += kPatchesPerSubmit) {
    const auto some = places.subspan(first, std::min(kPatchesPerSubmit, places.size() - first));
    auto took = context_->run([&](VkCommandBuffer c) {
      for (const uint32_t place : some) {  // each writes elements that others write, too: the same zeros
        const shaders::SeedPush push{places_, seats_.used(), place, 0, 0, 0, 0};
        delete_.dispatch(c, set_, &push, groupsOf(seats_.used(), shaders::kSeedGroup));
      }
    });
    if (!took) return took.error();
    ms += *took;
  }
  for (const uint32_t place : places) seats_.give(place);
  stats_.left += places.size();
  stats_.last_update_ms = ms;
  return {};
}

Result<void> VulkanSeed::multiply() {
  const shaders::SeedPush push{places_, seats_.used(), 0, 0, 0, 0, 0};
  const uint32_t rows_a_group = std::max(1u, shaders::kSeedGroup / std::max(1u, context_->subgroupSize()));
  const uint64_t bytes = seats_.used() * sizeof(Vec4);
  auto ms = context_->run([&](VkCommandBuffer c) {
    const VkBufferCopy up{0, vectorBytes(shaders::kSeedLight), bytes}, down{vectorBytes(shaders::kSeedIrradiance), 0, bytes};
    vkCmdCopyBuffer(c, up_.handle(), vectors_.handle(), 1, &up);
    separate(c);
    context_->beginTimed(c);
    relight_.dispatch(c, set_, &push, groupsOf(seats_.used(), rows_a_group));
    context_->endTimed(c);
    separate(c);
    vkCmdCopyBuffer(c, vectors_.handle(), down_.handle(), 1, &down);
  });
  if (!ms) return ms.error();
  stats_.last_relight_ms = context_->timedMs();
  return {};
}

void VulkanSeed::addIrradiance(std::span<Vec4> irradiance) const {
  const auto* e = reinterpret_cast<const Vec4*>(down_.mapped());
  for (uint32_t i = 0; i < seats_.used(); ++i) {
    irradiance[i].x += e[i].x;
    irradiance[i].y += e[i].y;
    irradiance[i].z += e[i].z;
  }
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeVulkanSeed(std::shared_ptr<VkContext> context,
                                                     const MultibounceSettings& settings) {
  const uint64_t most = context->limits().maxStorageBufferRange / kElementBytes;
  const auto places = static_cast<uint32_t>(std::sqrt(static_cast<double>(most)));
  if (auto fits = checkMatrixFits(*context, "seed vulkan", settings.places,
                                  uint64_t{settings.places} * settings.places * kElementBytes,
                                  "use 1 to " + std::to_string(places) + " places");
      !fits)
    return fits.error();
  auto seed = std::make_unique<VulkanSeed>(std::move(context), settings.places);
  if (auto r = seed->start(); !r) return r.error();
  return std::unique_ptr<BounceMatrix>(std::move(seed));
}

}  // namespace ff::runtime
