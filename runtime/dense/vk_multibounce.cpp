#include "runtime/dense/vk_multibounce.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "runtime/dense/places.h"
#include "runtime/dense/vk_bounce_steps.h"
#include "runtime/vulkan/device.h"

namespace ff::runtime {
namespace {

Error refusal(bool leaving) {
  return Error{ErrorCode::kInvalidFile, "", "",
               whyRefused(leaving),
               "rebuild the matrix, or use the gather solver"};
}

class VulkanMultibounce final : public BounceMatrix {
 public:
  VulkanMultibounce(std::shared_ptr<VkContext> context, std::unique_ptr<VulkanBounceSteps> steps)
      : context_(std::move(context)), steps_(std::move(steps)), seats_(steps_->settings().places) {}
  Result<void> allocate();

  uint32_t capacity() const override { return seats_.capacity(); }
  uint64_t bytes() const override { return steps_->bytes(); }
  const char* name() const override { return steps_->name().c_str(); }
  BounceStats stats() const override {
    BounceStats s = stats_;
    s.pending_columns = steps_->pending();
    return s;
  }
  Result<void> insert(const EnteringBlock& block) override;
  Result<void> remove(std::span<const uint32_t> places) override;
  Result<void> clear() override;
  Result<uint32_t> advance(uint32_t columns) override;
  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override;
  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override;

 private:
  uint32_t* upWords() { return reinterpret_cast<uint32_t*>(up_.mapped()); }
  float* upFloats() { return reinterpret_cast<float*>(up_.mapped()); }
  Result<void> update(const VulkanBounceSteps::Block& block);
  Result<void> multiply(uint32_t changed_places);

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  std::unique_ptr<VulkanBounceSteps> steps_;
  Buffer up_, down_;
  Places seats_;
  BounceStats stats_;
};

Result<void> VulkanMultibounce::allocate() {
  const uint64_t stride = steps_->stride();
  const std::pair<Buffer*, uint64_t> list[] = {{&up_, std::max(steps_->maxWords(), 4 * stride) * sizeof(float)},
                                               {&down_, 3 * stride * sizeof(float)}};
  for (const auto& [buffer, bytes] : list) {
    auto b = Buffer::create(*context_, bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, MemoryUse::kHost);
    if (!b) return b.error();
    *buffer = std::move(*b);
  }
  return {};
}

Result<void> VulkanMultibounce::clear() {
  auto r = context_->run([&](VkCommandBuffer c) { steps_->recordClear(c); });
  if (!r) return r.error();
  seats_.clear();
  return {};
}

// The block that the staging buffer describes.
Result<void> VulkanMultibounce::update(const VulkanBounceSteps::Block& block) {
  auto ms = context_->run([&](VkCommandBuffer c) {
    steps_->recordUpload(c, block, up_.handle(), 0);
    separate(c);
    context_->beginTimed(c);
    steps_->recordChange(c, block);
    context_->endTimed(c);
    separate(c);
    const VkBufferCopy copy{0, 0, sizeof(uint32_t)};
    vkCmdCopyBuffer(c, steps_->status().handle(), down_.handle(), 1, &copy);
  });
  if (!ms) return ms.error();
  stats_.last_update_ms = context_->timedMs();
  uint32_t status = 0;
  std::memcpy(&status, down_.mapped(), sizeof(status));
  if (status == 0) return {};
  steps_->forgetPending();
  return refusal(block.leaving);
}

Result<void> VulkanMultibounce::insert(const EnteringBlock& block) {
  for (const uint32_t place : block.places) FF_CHECK_EQ(seats_.taken(place), false);
  const auto described = steps_->describe(block, upWords());
  if (!described) return described.error();
  if (auto r = update(*described); !r) return r;
  for (const uint32_t place : block.places) seats_.take(place);
  stats_.entered += described->k;
  stats_.clamped += described->clamped;
  return {};
}

Result<void> VulkanMultibounce::remove(std::span<const uint32_t> places) {
  for (size_t first = 0; first < places.size(); first += kMaxBlock) {
    const auto some = places.subspan(first, std::min<size_t>(kMaxBlock, places.size() - first));
    for (const uint32_t place : some) FF_CHECK_EQ(seats_.taken(place), true);
    if (auto r = update(steps_->describe(some, upWords())); !r) return r;
    for (const uint32_t place : some) seats_.give(place);
    stats_.left += some.size();
  }
  return {};
}

Result<uint32_t> VulkanMultibounce::advance(uint32_t columns) {
  if (steps_->pending() == 0 || columns == 0) return steps_->pending();
  auto ms = context_->run([&](VkCommandBuffer c) { steps_->recordAdvance(c, columns); });
  if (!ms) return ms.error();
  stats_.last_update_ms = *ms;
  return steps_->pending();
}

// Multiplies the light in the staging buffer, [channel][place]; irradiance arrives in the other one in the same order.
// changed_places: 0, or that many places lie behind the light and only their columns are multiplied.
Result<void> VulkanMultibounce::multiply(uint32_t changed_places) {
  auto ms = context_->run([&](VkCommandBuffer c) {
    steps_->recordLight(c, up_.handle(), 0, changed_places);
    separate(c);
    context_->beginTimed(c);
    steps_->recordProduct(c, changed_places);
    context_->endTimed(c);
    steps_->recordIrradiance(c, down_.handle(), 0);
  });
  if (!ms) return ms.error();
  stats_.last_relight_ms = context_->timedMs();
  return {};
}

Result<void> VulkanMultibounce::relight(std::span<const Vec4> source, std::span<Vec4> irradiance) {
  seats_.checkLight(source, irradiance);
  std::fill(irradiance.begin(), irradiance.end(), Vec4{});
  if (steps_->used() == 0) return {};
  const uint32_t stride = steps_->stride();
  std::memset(up_.mapped(), 0, uint64_t{3} * stride * sizeof(float));
  for (uint32_t i = 0; i < capacity(); ++i) {
    if (!seats_.taken(i)) continue;
    upFloats()[i] = source[i].x;
    upFloats()[stride + i] = source[i].y;
    upFloats()[2 * stride + i] = source[i].z;
  }
  if (auto r = multiply(0); !r) return r;
  const auto* e = reinterpret_cast<const float*>(down_.mapped());
  for (uint32_t i = 0; i < capacity(); ++i)
    if (seats_.taken(i)) irradiance[i] = {e[i], e[stride + i], e[2 * stride + i], 0};
  return {};
}

Result<void> VulkanMultibounce::relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                                               std::span<Vec4> irradiance) {
  seats_.checkChange(places, difference, irradiance);
  if (steps_->used() == 0 || places.empty()) return {};
  const uint32_t stride = steps_->stride();
  std::memset(up_.mapped(), 0, uint64_t{3} * stride * sizeof(float));
  for (size_t i = 0; i < places.size(); ++i) {
    FF_CHECK_LT(places[i], capacity());
    if (!seats_.taken(places[i])) continue;
    upFloats()[places[i]] = difference[i].x;
    upFloats()[stride + places[i]] = difference[i].y;
    upFloats()[2 * stride + places[i]] = difference[i].z;
  }
  // Columns are read 4 bytes at a time, and luminance needs all of them after the first product.
  const bool few = !steps_->settings().luminance && places.size() < steps_->used() / 8;
  for (size_t i = 0; few && i < places.size(); ++i) upWords()[3 * stride + i] = places[i];
  if (auto r = multiply(few ? static_cast<uint32_t>(places.size()) : 0); !r) return r;
  const auto* e = reinterpret_cast<const float*>(down_.mapped());
  for (uint32_t i = 0; i < capacity(); ++i) {
    if (!seats_.taken(i)) continue;
    irradiance[i].x += e[i];
    irradiance[i].y += e[stride + i];
    irradiance[i].z += e[2 * stride + i];
  }
  return {};
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeVulkanMultibounce(std::shared_ptr<VkContext> context,
                                                            const MultibounceSettings& settings) {
  auto steps = VulkanBounceSteps::create(context, settings);
  if (!steps) return steps.error();
  auto m = std::make_unique<VulkanMultibounce>(std::move(context), std::move(*steps));
  if (auto r = m->allocate(); !r) return r.error();
  return std::unique_ptr<BounceMatrix>(std::move(m));
}

}  // namespace ff::runtime
