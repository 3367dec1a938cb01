#include "runtime/dense/vk_baseline.h"

#include <algorithm>

namespace ff::runtime {

VulkanBaseline::VulkanBaseline(std::shared_ptr<VkContext> context, uint32_t places, const std::string& name)
    : context_(std::move(context)), seats_(places), name_(name + ": " + context_->deviceName()) {}

Result<void> VulkanBaseline::make(std::span<const WantedPipeline> pipelines, uint32_t push_bytes,
                                  std::span<const WantedBuffer> buffers, std::span<const Buffer* const> bound) {
  const auto bindings = static_cast<uint32_t>(bound.size());
  for (const auto& [pipeline, words] : pipelines) {
    auto made = ComputePipeline::create(*context_, words, bindings, push_bytes);
    if (!made) return made.error();
    *pipeline = std::move(*made);
  }
  for (const WantedBuffer& w : buffers) {
    auto b = Buffer::create(*context_, w.bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, w.use);
    if (!b) return b.error();
    *w.buffer = std::move(*b);
  }
  auto sets = StorageSets::create(*context_, 1, bindings);
  if (!sets) return sets.error();
  sets_ = std::move(*sets);
  std::vector<VkDescriptorBufferInfo> whole;
  for (const Buffer* b : bound) whole.push_back({b->handle(), 0, VK_WHOLE_SIZE});
  auto set = sets_.make(pipelines.front().first->setLayout(), whole);
  if (!set) return set.error();
  set_ = *set;
  return {};
}

Result<void> VulkanBaseline::insert(const EnteringBlock& block) {
  if (auto sound = checkFormFactors(block); !sound) return sound;
  FF_CHECK_LE(block.places.size(), size_t{kMaxBlock});
  if (auto entered = enter(block); !entered) return entered;
  stats_.entered += block.places.size();
  return {};
}

Result<void> VulkanBaseline::relight(std::span<const Vec4> source, std::span<Vec4> irradiance) {
  seats_.checkLight(source, irradiance);
  std::fill(irradiance.begin(), irradiance.end(), Vec4{});
  if (seats_.used() == 0) return {};
  clearLight();
  for (uint32_t i = 0; i < seats_.used(); ++i)
    if (seats_.taken(i)) putLight(i, source[i]);
  if (auto r = multiply(); !r) return r;
  addIrradiance(irradiance);
  return {};
}

// All columns are multiplied whatever changed, as in the paper.
Result<void> VulkanBaseline::relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                                            std::span<Vec4> irradiance) {
  seats_.checkChange(places, difference, irradiance);
  if (seats_.used() == 0) return {};
  clearLight();
  for (size_t i = 0; i < places.size(); ++i)
    if (seats_.taken(places[i])) putLight(places[i], difference[i]);
  if (auto r = multiply(); !r) return r;
  addIrradiance(irradiance);
  return {};
}

Result<void> checkMatrixFits(const VkContext& context, const std::string& what, uint32_t places, uint64_t bytes,
                             const std::string& remedy) {
  const uint64_t most = context.limits().maxStorageBufferRange;
  if (places > 0 && bytes <= most) return {};
  return Error{ErrorCode::kUsage, "", what,
               std::to_string(places) + " places: the matrix takes " + std::to_string(bytes >> 20) +
                   " MiB, the device binds at most " + std::to_string(most >> 20) + " MiB",
               remedy};
}

}  // namespace ff::runtime
