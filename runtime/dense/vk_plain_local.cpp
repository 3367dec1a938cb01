// Plain local radiosity on Vulkan: the buffers of bounce.glsl with one plane that holds F itself. Its products are those of
// the luminance matrix with a mean albedo of zero: what is multiplied next is M + C E.
#include <algorithm>
#include <bit>
#include <cstring>
#include <string>
#include <utility>

#include "bounce_relight_luminance_comp.h"
#include "bounce_relight_luminance_half_comp.h"
#include "plain_delete_comp.h"
#include "plain_delete_half_comp.h"
#include "plain_scatter_comp.h"
#include "plain_scatter_half_comp.h"
#include "runtime/dense/vk_baseline.h"
#include "runtime/dense/vk_seed.h"
#include "shaders/shared.h"

namespace ff::runtime {
namespace {

class VulkanPlainLocal final : public VulkanBaseline {
 public:
  VulkanPlainLocal(std::shared_ptr<VkContext> context, const MultibounceSettings& settings, int bounces)
      : VulkanBaseline(std::move(context), settings.places,
                       "plain local vulkan, " + std::to_string(bounces) + " products, " +
                           (settings.storage == Storage::kFloat16 ? "fp16" : "fp32")),
        places_(settings.places),
        stride_(roundUp(settings.places, shaders::kBounceTile)),
        half_(settings.storage == Storage::kFloat16),
        bounces_(bounces) {}
  Result<void> start();

  uint64_t bytes() const override { return uint64_t{stride_} * stride_ * (half_ ? 2 : 4); }
  Result<void> remove(std::span<const uint32_t> places) override;
  Result<void> clear() override;

 private:
  Result<void> enter(const EnteringBlock& block) override;
  void clearLight() override { std::memset(up_.mapped(), 0, uint64_t{3} * stride_ * sizeof(float)); }
  void putLight(uint32_t place, const Vec4& light) override;
  Result<void> multiply() override;
  void addIrradiance(std::span<Vec4> irradiance) const override;
  uint64_t vectorAt(uint32_t channel, uint32_t at) const {  // bytes
    return (uint64_t{channel} * (4 * stride_ + kMaxBlock) + at) * sizeof(float);
  }
  shaders::BouncePush push() const {
    shaders::BouncePush p{};
    p.stride = stride_;
    p.used = used_;
    p.channel = p.bound = shaders::kBounceMean;
    return p;
  }
  Result<void> recordBlock(const ComputePipeline& pipeline, const shaders::BouncePush& push, uint32_t groups, uint64_t words);

  uint32_t places_, stride_;
  bool half_;
  int bounces_;
  ComputePipeline scatter_, delete_, relight_;
  Buffer matrix_, unused_, block_, albedo_, vectors_;
  uint32_t used_ = 0;  // multiple of the tile
};

Result<void> VulkanPlainLocal::start() {
  using Words = std::span<const uint32_t>;
  const WantedPipeline pipelines[] = {
      {&scatter_, half_ ? Words(plain_scatter_half_comp) : Words(plain_scatter_comp)},
      {&delete_, half_ ? Words(plain_delete_half_comp) : Words(plain_delete_comp)},
      {&relight_, half_ ? Words(bounce_relight_luminance_half_comp) : Words(bounce_relight_luminance_comp)}};
  const uint64_t block_bytes = (shaders::kBlockIndex + stride_ + uint64_t{4} * kMaxBlock * stride_) * sizeof(uint32_t);
  const uint64_t vector_bytes = uint64_t{3} * stride_ * sizeof(float);
  const WantedBuffer buffers[] = {{&matrix_, bytes(), MemoryUse::kDevice},
                                  {&unused_, 16, MemoryUse::kDevice},
                                  {&block_, block_bytes, MemoryUse::kDevice},
                                  {&albedo_, uint64_t{4} * stride_ * sizeof(float), MemoryUse::kDevice},
                                  {&vectors_, vectorAt(3, 0), MemoryUse::kDevice},
                                  {&up_, std::max(block_bytes, vector_bytes), MemoryUse::kHost},
                                  {&down_, vector_bytes, MemoryUse::kHost}};
  const Buffer* const bound[] = {&matrix_, &unused_, &block_, &albedo_, &vectors_, &unused_};  // bindings of bounce.glsl
  if (auto made = make(pipelines, sizeof(shaders::BouncePush), buffers, bound); !made) return made;
  return clear();
}

Result<void> VulkanPlainLocal::clear() {
  auto r = context_->run([&](VkCommandBuffer c) {
    for (const Buffer* b : {&matrix_, &albedo_, &vectors_}) vkCmdFillBuffer(c, b->handle(), 0, VK_WHOLE_SIZE, 0);
  });
  if (!r) return r.error();
  seats_.clear();
  used_ = 0;
  return {};
}

Result<void> VulkanPlainLocal::recordBlock(const ComputePipeline& pipeline, const shaders::BouncePush& push, uint32_t groups,
                                           uint64_t words) {
  auto ms = context_->run([&](VkCommandBuffer c) {
    const VkBufferCopy copy{0, 0, words * sizeof(uint32_t)};
    vkCmdCopyBuffer(c, up_.handle(), block_.handle(), 1, &copy);
    separate(c);
    context_->beginTimed(c);
    pipeline.dispatch(c, set_, &push, groups);
    context_->endTimed(c);
  });
  if (!ms) return ms.error();
  stats_.last_update_ms = context_->timedMs();
  return {};
}

Result<void> VulkanPlainLocal::enter(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  FF_CHECK_LE(block.columns.size(), size_t{k} * places_);
  FF_CHECK_LE(block.receivers.size(), size_t{k} * places_);
  auto* words = reinterpret_cast<uint32_t*>(up_.mapped());
  for (uint32_t i = 0; i < k; ++i) {
    seats_.take(block.places[i]);
    used_ = std::max(used_, roundUp(block.places[i] + 1, shaders::kBounceTile));
    words[shaders::kBlockPlaces + i] = block.places[i];
    const float channels[3] = {block.albedo[i].x, block.albedo[i].y, block.albedo[i].z};
    for (uint32_t c = 0; c < 3; ++c)
      words[shaders::kBlockAlbedo + c * kMaxBlock + i] = std::bit_cast<uint32_t>(channels[c]);
  }
  std::copy(block.row_start.begin(), block.row_start.end(), words + shaders::kBlockRowStart);
  std::copy(block.column_start.begin(), block.column_start.end(), words + shaders::kBlockColumnStart);
  uint32_t at = shaders::kBlockIndex + stride_;
  for (size_t e = 0; e < block.columns.size(); ++e, at += 2) {
    words[at] = block.columns[e];
    words[at + 1] = std::bit_cast<uint32_t>(block.row_values[e]);
  }
  shaders::BouncePush p = push();
  p.k = k;
  p.columns_at = at;
  p.count = static_cast<uint32_t>(block.columns.size());
  for (size_t e = 0; e < block.receivers.size(); ++e, at += 2) {
    words[at] = block.receivers[e];
    words[at + 1] = std::bit_cast<uint32_t>(block.column_values[e]);
  }
  const uint32_t entries = p.count + static_cast<uint32_t>(block.receivers.size());
  return recordBlock(scatter_, p, groupsOf(std::max(k, entries), shaders::kBounceGroup), at);
}

Result<void> VulkanPlainLocal::remove(std::span<const uint32_t> places) {
  for (size_t first = 0; first < places.size(); first += kMaxBlock) {
    const auto some = places.subspan(first, std::min<size_t>(kMaxBlock, places.size() - first));
    std::memcpy(up_.mapped(), some.data(), some.size_bytes());
    shaders::BouncePush p = push();
    p.k = static_cast<uint32_t>(some.size());
    if (auto r = recordBlock(delete_, p, groupsOf(p.k * used_, shaders::kBounceGroup), some.size()); !r) return r;
    for (const uint32_t place : some) seats_.give(place);
    stats_.left += some.size();
  }
  return {};
}

// Light and irradiance: [channel][place].
Result<void> VulkanPlainLocal::multiply() {
  auto ms = context_->run([&](VkCommandBuffer c) {
    const uint64_t channel_bytes = uint64_t{stride_} * sizeof(float);
    VkBufferCopy up[6], down[3];
    for (uint32_t channel = 0; channel < 3; ++channel) {
      up[channel] = {channel * channel_bytes, vectorAt(channel, 0), channel_bytes};
      up[3 + channel] = {channel * channel_bytes, vectorAt(channel, stride_), channel_bytes};
      down[channel] = {vectorAt(channel, 3 * stride_), channel * channel_bytes, channel_bytes};
    }
    vkCmdCopyBuffer(c, up_.handle(), vectors_.handle(), 6, up);
    separate(c);
    context_->beginTimed(c);
    const uint32_t subgroups = shaders::kBounceGroup / std::max(1u, context_->subgroupSize());
    for (int i = 0; i < bounces_; ++i) {
      shaders::BouncePush p = push();
      p.x_at = (1 + static_cast<uint32_t>(i) % 2) * stride_;  // the light itself stays at 0
      p.next_at = i + 1 < bounces_ ? (1 + static_cast<uint32_t>(i + 1) % 2) * stride_ : 0;
      relight_.dispatch(c, set_, &p, groupsOf(used_, subgroups * shaders::kBounceRows));
      separate(c);
    }
    context_->endTimed(c);
    vkCmdCopyBuffer(c, vectors_.handle(), down_.handle(), 3, down);
  });
  if (!ms) return ms.error();
  stats_.last_relight_ms = context_->timedMs();
  return {};
}

void VulkanPlainLocal::putLight(uint32_t place, const Vec4& light) {
  auto* channels = reinterpret_cast<float*>(up_.mapped());
  channels[place] = light.x;
  channels[stride_ + place] = light.y;
  channels[2 * stride_ + place] = light.z;
}

void VulkanPlainLocal::addIrradiance(std::span<Vec4> irradiance) const {
  const auto* e = reinterpret_cast<const float*>(down_.mapped());
  for (uint32_t i = 0; i < places_; ++i) {
    if (!seats_.taken(i)) continue;
    irradiance[i].x += e[i];
    irradiance[i].y += e[stride_ + i];
    irradiance[i].z += e[2 * stride_ + i];
  }
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeVulkanPlainLocal(std::shared_ptr<VkContext> context,
                                                           const MultibounceSettings& settings, int bounces) {
  FF_CHECK_LT(0, bounces);
  const uint64_t stride = roundUp(settings.places, shaders::kBounceTile);
  const uint64_t bytes = stride * stride * (settings.storage == Storage::kFloat16 ? 2 : 4);
  if (auto fits = checkMatrixFits(*context, "plain local vulkan", settings.places, bytes, "use fewer places, or fp16 storage");
      !fits)
    return fits.error();
  auto plain = std::make_unique<VulkanPlainLocal>(std::move(context), settings, bounces);
  if (auto r = plain->start(); !r) return r.error();
  return std::unique_ptr<BounceMatrix>(std::move(plain));
}

}  // namespace ff::runtime
