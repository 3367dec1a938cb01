#include "runtime/dense/vk_multibounce.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "bounce_apply_comp.h"
#include "bounce_apply_half_comp.h"
#include "bounce_changed_comp.h"
#include "bounce_changed_half_comp.h"
#include "bounce_corner_comp.h"
#include "bounce_fold_comp.h"
#include "bounce_fold_half_comp.h"
#include "bounce_pending_comp.h"
#include "bounce_relight_comp.h"
#include "bounce_relight_half_comp.h"
#include "bounce_relight_luminance_comp.h"
#include "bounce_relight_luminance_half_comp.h"
#include "bounce_scatter_comp.h"
#include "bounce_solve_comp.h"
#include "bounce_solve_half_comp.h"
#include "bounce_tall_comp.h"
#include "bounce_tall_half_comp.h"
#include "bounce_wide_comp.h"
#include "bounce_wide_half_comp.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/places.h"
#include "runtime/vk_buffer.h"
#include "runtime/vk_device.h"
#include "runtime/vk_pipeline.h"
#include "shaders/shared.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kBuffers = 6;  // bindings of bounce.glsl
constexpr uint32_t kSharedBytes = 18 << 10;  // of bounce_solve.comp
constexpr VkPipelineStageFlags kCompute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, kCopy = VK_PIPELINE_STAGE_TRANSFER_BIT;
static_assert(shaders::kBounceBlock == kMaxBlock);

Error refusal(std::string message) {
  return Error{ErrorCode::kInvalidFile, "", "", std::move(message), "rebuild the matrix, or use the gather solver"};
}

struct Pipelines {
  ComputePipeline tall, wide, scatter, corner, solve, apply, fold, relight, pending, changed;
};

Result<Pipelines> makePipelines(VkContext& context, const MultibounceSettings& settings) {
  const bool half = settings.storage == Storage::kFloat16;
  Pipelines p;
  using Words = std::span<const uint32_t>;
  const Words relight_words = settings.luminance
                                  ? (half ? Words(bounce_relight_luminance_half_comp) : Words(bounce_relight_luminance_comp))
                                  : (half ? Words(bounce_relight_half_comp) : Words(bounce_relight_comp));
  const std::pair<ComputePipeline*, Words> list[] = {
      {&p.tall, half ? Words(bounce_tall_half_comp) : Words(bounce_tall_comp)},
      {&p.wide, half ? Words(bounce_wide_half_comp) : Words(bounce_wide_comp)},
      {&p.scatter, bounce_scatter_comp},
      {&p.corner, bounce_corner_comp},
      {&p.solve, half ? Words(bounce_solve_half_comp) : Words(bounce_solve_comp)},
      {&p.apply, half ? Words(bounce_apply_half_comp) : Words(bounce_apply_comp)},
      {&p.fold, half ? Words(bounce_fold_half_comp) : Words(bounce_fold_comp)},
      {&p.relight, relight_words},
      {&p.pending, bounce_pending_comp},
      {&p.changed, half ? Words(bounce_changed_half_comp) : Words(bounce_changed_comp)}};
  for (const auto& [pipeline, words] : list) {
    auto made = ComputePipeline::create(context, words, kBuffers, sizeof(shaders::BouncePush));
    if (!made) return made.error();
    *pipeline = std::move(*made);
  }
  return p;
}

class VulkanMultibounce final : public BounceMatrix {
 public:
  VulkanMultibounce(std::shared_ptr<VkContext> context, const MultibounceSettings& settings, Pipelines pipelines)
      : context_(std::move(context)),
        settings_(settings),
        pipelines_(std::move(pipelines)),
        stride_(roundUp(settings.places, shaders::kBounceTile)),
        planes_(settings.luminance ? 1 : 3),
        seats_(settings.places),
        colour_(settings.places),
        index_(stride_, shaders::kNotInBlock) {
    name_ = std::string("multibounce vulkan ") + (settings.storage == Storage::kFloat16 ? "fp16" : "fp32") +
            (settings.luminance ? " luminance: " : ": ") + context_->deviceName();
  }
  Result<void> allocate();

  uint32_t capacity() const override { return settings_.places; }
  uint64_t bytes() const override { return planeBytes() * planes_; }
  const char* name() const override { return name_.c_str(); }
  BounceStats stats() const override {
    BounceStats s = stats_;
    s.pending_columns = pending_k_ > 0 ? used_ - frontier_ : 0;
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
  uint64_t planeBytes() const {
    return uint64_t{stride_} * stride_ * (settings_.storage == Storage::kFloat16 ? 2 : 4);
  }
  uint64_t vectorsBytes() const { return uint64_t{3} * (4 * stride_ + kMaxBlock) * sizeof(float); }
  uint64_t vectorAt(uint32_t channel, uint32_t at) const {  // bytes
    return (uint64_t{channel} * (4 * stride_ + kMaxBlock) + at) * sizeof(float);
  }
  uint32_t* upWords() { return reinterpret_cast<uint32_t*>(up_.mapped()); }
  float* upFloats() { return reinterpret_cast<float*>(up_.mapped()); }

  shaders::BouncePush push() const {
    shaders::BouncePush p{};
    p.stride = stride_;
    p.used = used_;
    p.k = pending_k_;
    p.pending = pending_k_ > 0;
    p.first = frontier_;
    p.end = used_;
    return p;
  }
  // One dispatch a plane; they touch different memory.
  void dispatch(VkCommandBuffer c, const ComputePipeline& pipeline, shaders::BouncePush push, uint32_t groups) const {
    for (uint32_t plane = 0; plane < planes_; ++plane) {
      push.channel = settings_.luminance ? shaders::kBounceMean : plane;
      push.bound = settings_.luminance ? shaders::kBounceMean : 0;
      pipeline.dispatch(c, sets_of_planes_[plane], &push, groups);
    }
  }
  void describeBlock(std::span<const uint32_t> places, std::span<const Vec4> albedo);
  uint32_t addEntries(const EnteringBlock& block);
  void recordUpload(VkCommandBuffer c, uint64_t words) const;
  void recordFold(VkCommandBuffer c, uint32_t first, uint32_t end, uint32_t k, uint32_t used) const;
  Result<void> update(uint32_t k, bool leaving, uint64_t words, uint32_t columns_at, uint32_t row_entries,
                      uint32_t column_entries, uint32_t used_after);
  Result<void> multiply(uint32_t changed_places);

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  MultibounceSettings settings_;
  Pipelines pipelines_;
  std::string name_;
  uint32_t stride_, planes_;
  uint32_t used_ = 0;                      // multiple of the tile; places from here on are free
  uint32_t frontier_ = 0, pending_k_ = 0;  // columns below it are up to date; k of the factors, 0: all are
  Buffer matrix_[3], panels_[3], block_, albedo_, vectors_, status_, up_, down_;
  StorageSets sets_;
  VkDescriptorSet sets_of_planes_[3] = {};
  Places seats_;
  std::vector<Vec4> colour_;  // albedo of each place
  std::vector<uint32_t> index_;  // per place its number in the block
  BounceStats stats_;
};

Result<void> VulkanMultibounce::allocate() {
  constexpr uint64_t kFloat = sizeof(float);
  const uint64_t block_words = shaders::kBlockIndex + stride_ + uint64_t{4} * kMaxBlock * stride_;
  struct Wanted {
    Buffer* buffer;
    uint64_t bytes;
    MemoryUse use;
  };
  std::vector<Wanted> list{{&block_, block_words * kFloat, MemoryUse::kDevice},
                           {&albedo_, uint64_t{4} * stride_ * kFloat, MemoryUse::kDevice},
                           {&vectors_, vectorsBytes(), MemoryUse::kDevice},
                           {&status_, 16, MemoryUse::kDevice},
                           {&up_, std::max(block_words, uint64_t{4} * stride_) * kFloat, MemoryUse::kHost},
                           {&down_, std::max<uint64_t>(uint64_t{3} * stride_ * kFloat, 16), MemoryUse::kHost}};
  for (uint32_t p = 0; p < planes_; ++p) {
    list.push_back({&matrix_[p], planeBytes(), MemoryUse::kDevice});
    list.push_back({&panels_[p], (uint64_t{3} * kMaxBlock * stride_ + uint64_t{2} * kMaxBlock * kMaxBlock) * kFloat,
                    MemoryUse::kDevice});
  }
  for (const Wanted& w : list) {
    auto b = Buffer::create(*context_, w.bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, w.use);
    if (!b) return b.error();
    *w.buffer = std::move(*b);
  }
  auto sets = StorageSets::create(*context_, planes_, planes_ * kBuffers);
  if (!sets) return sets.error();
  sets_ = std::move(*sets);
  for (uint32_t p = 0; p < planes_; ++p) {
    VkDescriptorBufferInfo buffers[kBuffers];
    const Buffer* const bound[kBuffers] = {&matrix_[p], &panels_[p], &block_, &albedo_, &vectors_, &status_};
    for (uint32_t b = 0; b < kBuffers; ++b) buffers[b] = {bound[b]->handle(), 0, VK_WHOLE_SIZE};
    if (!settings_.luminance) {  // a plane binds its own channel: multiples of 256 bytes, which any device can
      buffers[3] = {albedo_.handle(), uint64_t{p} * stride_ * kFloat, stride_ * kFloat};
      buffers[4] = {vectors_.handle(), vectorAt(p, 0), vectorAt(1, 0)};
    }
    auto set = sets_.make(pipelines_.tall.setLayout(), buffers);
    if (!set) return set.error();
    sets_of_planes_[p] = *set;
  }
  auto zeroed_panels = context_->run([&](VkCommandBuffer c) {
    for (uint32_t p = 0; p < planes_; ++p) vkCmdFillBuffer(c, panels_[p].handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, vectors_.handle(), 0, VK_WHOLE_SIZE, 0);
  });
  if (!zeroed_panels) return zeroed_panels.error();
  return clear();
}

Result<void> VulkanMultibounce::clear() {
  auto r = context_->run([&](VkCommandBuffer c) {
    for (uint32_t p = 0; p < planes_; ++p) vkCmdFillBuffer(c, matrix_[p].handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, albedo_.handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, status_.handle(), 0, VK_WHOLE_SIZE, 0);
  });
  if (!r) return r.error();
  seats_.clear();
  used_ = frontier_ = pending_k_ = 0;
  return {};
}

// The head of the block's buffer, in the staging buffer.
void VulkanMultibounce::describeBlock(std::span<const uint32_t> places, std::span<const Vec4> albedo) {
  uint32_t* words = upWords();
  for (uint32_t i = 0; i < places.size(); ++i) {
    words[shaders::kBlockPlaces + i] = places[i];
    index_[places[i]] = i;
    const Vec4& a = albedo[i];
    const float channels[4] = {a.x, a.y, a.z, (a.x + a.y + a.z) / 3};
    for (uint32_t c = 0; c < 4; ++c)
      words[shaders::kBlockAlbedo + c * kMaxBlock + i] = std::bit_cast<uint32_t>(channels[c]);
  }
  std::memcpy(words + shaders::kBlockIndex, index_.data(), index_.size() * sizeof(uint32_t));
  for (const uint32_t place : places) index_[place] = shaders::kNotInBlock;
}

// Its sparse lists; returns the word at which those of F_LP begin.
uint32_t VulkanMultibounce::addEntries(const EnteringBlock& block) {
  uint32_t* words = upWords();
  std::copy(block.row_start.begin(), block.row_start.end(), words + shaders::kBlockRowStart);
  std::copy(block.column_start.begin(), block.column_start.end(), words + shaders::kBlockColumnStart);
  uint32_t at = shaders::kBlockIndex + stride_;
  const auto add = [&](std::span<const uint32_t> indices, std::span<const float> values) {
    for (size_t e = 0; e < indices.size(); ++e) {
      words[at++] = indices[e];
      words[at++] = std::bit_cast<uint32_t>(values[e]);
    }
  };
  add(block.columns, block.row_values);
  const uint32_t columns_at = at;
  add(block.receivers, block.column_values);
  return columns_at;
}

void VulkanMultibounce::recordUpload(VkCommandBuffer c, uint64_t words) const {
  const VkBufferCopy copy{0, 0, words * sizeof(uint32_t)};
  vkCmdCopyBuffer(c, up_.handle(), block_.handle(), 1, &copy);
}

void VulkanMultibounce::recordFold(VkCommandBuffer c, uint32_t first, uint32_t end, uint32_t k, uint32_t used) const {
  if (k == 0 || first >= end) return;
  shaders::BouncePush p = push();
  p.used = used;
  p.k = k;
  p.first = first;
  p.end = end;
  const uint32_t across = groupsOf(end, shaders::kBounceTile) - first / shaders::kBounceTile;
  dispatch(c, pipelines_.fold, p, across * (used / shaders::kBounceTile));
}

// What insert() and remove() share: finishes the last update, finds the factors of the new one and, unless updates are
// time-sliced, folds it in.
Result<void> VulkanMultibounce::update(uint32_t k, bool leaving, uint64_t words, uint32_t columns_at,
                                       uint32_t row_entries, uint32_t column_entries, uint32_t used_after) {
  auto ms = context_->run([&](VkCommandBuffer c) {
    recordUpload(c, words);
    vkCmdFillBuffer(c, status_.handle(), 0, VK_WHOLE_SIZE, 0);
    separate(c);
    context_->beginTimed(c);
    recordFold(c, frontier_, used_, pending_k_, used_);
    separate(c);
    shaders::BouncePush p = push();
    p.used = used_after;
    p.k = k;
    p.leaving = leaving;
    p.columns_at = columns_at;
    p.count = row_entries;
    const uint32_t wide_groups = k * groupsOf(used_after / 4, shaders::kBounceGroup);
    dispatch(c, pipelines_.tall, p, used_after);
    dispatch(c, pipelines_.wide, p, wide_groups);
    separate(c);
    dispatch(c, pipelines_.scatter, p, groupsOf(std::max(k, row_entries + column_entries), shaders::kBounceGroup));
    separate(c);
    dispatch(c, pipelines_.corner, p, groupsOf(k * k, shaders::kBounceGroup / std::max(1u, context_->subgroupSize())));
    separate(c);
    dispatch(c, pipelines_.solve, p, 1);
    separate(c);
    dispatch(c, pipelines_.apply, p, wide_groups);
    if (!settings_.time_slice) {
      separate(c);
      recordFold(c, 0, used_after, k, used_after);
    }
    context_->endTimed(c);
    separate(c);
    const VkBufferCopy copy{0, 0, sizeof(uint32_t)};
    vkCmdCopyBuffer(c, status_.handle(), down_.handle(), 1, &copy);
  });
  if (!ms) return ms.error();
  stats_.last_update_ms = context_->timedMs();
  frontier_ = pending_k_ = 0;
  uint32_t status = 0;
  std::memcpy(&status, down_.mapped(), sizeof(status));
  if (status != 0)
    return refusal(leaving ? "the matrix has lost its precision: I + G C is singular"
                           : "light would be caught among the nodes that enter: I - S C is singular to working precision");
  used_ = used_after;
  if (settings_.time_slice) pending_k_ = k;
  return {};
}

Result<void> VulkanMultibounce::insert(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  FF_CHECK_LT(0u, k);
  FF_CHECK_LE(k, kMaxBlock);
  FF_CHECK_LE(block.columns.size(), size_t{k} * settings_.places);
  FF_CHECK_LE(block.receivers.size(), size_t{k} * settings_.places);
  if (!hasValidFormFactors(block)) return refusal("a form factor is not a finite number >= 0");
  Vec4 albedo[kMaxBlock];
  uint64_t clamped = 0;
  uint32_t used_after = used_;
  for (uint32_t i = 0; i < k; ++i) {
    FF_CHECK_LT(block.places[i], settings_.places);
    FF_CHECK_EQ(seats_.taken(block.places[i]), false);
    used_after = std::max(used_after, roundUp(block.places[i] + 1, shaders::kBounceTile));
    const Vec4& a = block.albedo[i];
    if (!(std::isfinite(a.x + a.y + a.z) && std::min({a.x, a.y, a.z}) >= 0))
      return refusal("an albedo is not a finite number >= 0");
    albedo[i] = {std::min(a.x, kMostKept), std::min(a.y, kMostKept), std::min(a.z, kMostKept), 0};
    clamped += std::max({a.x, a.y, a.z}) > kMostKept;
  }
  describeBlock(block.places, std::span<const Vec4>(albedo, k));
  const uint32_t columns_at = addEntries(block);
  const auto rows = static_cast<uint32_t>(block.columns.size()), columns = static_cast<uint32_t>(block.receivers.size());
  if (auto r = update(k, false, columns_at + uint64_t{2} * columns, columns_at, rows, columns, used_after); !r) return r;
  for (uint32_t i = 0; i < k; ++i) {
    seats_.take(block.places[i]);
    colour_[block.places[i]] = albedo[i];
  }
  stats_.entered += k;
  stats_.clamped += clamped;
  return {};
}

Result<void> VulkanMultibounce::remove(std::span<const uint32_t> places) {
  for (size_t first = 0; first < places.size(); first += kMaxBlock) {
    const auto some = places.subspan(first, std::min<size_t>(kMaxBlock, places.size() - first));
    Vec4 albedo[kMaxBlock];
    for (uint32_t i = 0; i < some.size(); ++i) {
      FF_CHECK_EQ(seats_.taken(some[i]), true);
      albedo[i] = colour_[some[i]];
    }
    describeBlock(some, std::span<const Vec4>(albedo, some.size()));
    if (auto r = update(static_cast<uint32_t>(some.size()), true, shaders::kBlockIndex + stride_, 0, 0, 0, used_); !r)
      return r;
    for (const uint32_t place : some) seats_.give(place);
    stats_.left += some.size();
  }
  return {};
}

Result<uint32_t> VulkanMultibounce::advance(uint32_t columns) {
  if (pending_k_ == 0) return 0u;
  const uint32_t end = frontier_ + std::min(columns, used_ - frontier_);
  if (end > frontier_) {
    auto ms = context_->run([&](VkCommandBuffer c) { recordFold(c, frontier_, end, pending_k_, used_); });
    if (!ms) return ms.error();
    stats_.last_update_ms = *ms;
    frontier_ = end;
  }
  if (frontier_ == used_) frontier_ = pending_k_ = 0;
  return pending_k_ > 0 ? used_ - frontier_ : 0;
}

// Multiplies the light in the staging buffer, [channel][place]; irradiance arrives in the other one in the same order.
// changed_places: 0, or that many places lie behind the light and only their columns are multiplied.
Result<void> VulkanMultibounce::multiply(uint32_t changed_places) {
  auto ms = context_->run([&](VkCommandBuffer c) {
    const uint64_t channel_bytes = uint64_t{stride_} * sizeof(float);
    VkBufferCopy up[3], down[3];
    for (uint32_t channel = 0; channel < 3; ++channel) {
      up[channel] = {channel * channel_bytes, vectorAt(channel, 0), channel_bytes};
      down[channel] = {vectorAt(channel, 3 * stride_), channel * channel_bytes, channel_bytes};
    }
    vkCmdCopyBuffer(c, up_.handle(), vectors_.handle(), 3, up);
    if (changed_places > 0) {
      const VkBufferCopy places{3 * channel_bytes, 0, uint64_t{changed_places} * sizeof(uint32_t)};
      vkCmdCopyBuffer(c, up_.handle(), block_.handle(), 1, &places);
    }
    separate(c);
    context_->beginTimed(c);
    const uint32_t subgroups = shaders::kBounceGroup / std::max(1u, context_->subgroupSize());
    const int products = settings_.luminance ? kLuminanceProducts : 1;
    for (int i = 0; i < products; ++i) {
      shaders::BouncePush p = push();
      p.x_at = static_cast<uint32_t>(i) * stride_;
      p.next_at = i + 1 < products ? p.x_at + stride_ : 0;
      if (pending_k_ > 0) {
        p.count = settings_.luminance ? 3 : 1;
        dispatch(c, pipelines_.pending, p, groupsOf(pending_k_ * p.count, subgroups));
        separate(c);
      }
      p.count = changed_places;
      if (changed_places > 0)
        dispatch(c, pipelines_.changed, p, groupsOf(used_, subgroups));
      else
        dispatch(c, pipelines_.relight, p, groupsOf(used_, subgroups * shaders::kBounceRows));
      separate(c);
    }
    context_->endTimed(c);
    vkCmdCopyBuffer(c, vectors_.handle(), down_.handle(), 3, down);
  });
  if (!ms) return ms.error();
  stats_.last_relight_ms = context_->timedMs();
  return {};
}

Result<void> VulkanMultibounce::relight(std::span<const Vec4> source, std::span<Vec4> irradiance) {
  seats_.checkLight(source, irradiance);
  std::fill(irradiance.begin(), irradiance.end(), Vec4{});
  if (used_ == 0) return {};
  std::memset(up_.mapped(), 0, uint64_t{3} * stride_ * sizeof(float));
  for (uint32_t i = 0; i < settings_.places; ++i) {
    if (!seats_.taken(i)) continue;
    upFloats()[i] = source[i].x;
    upFloats()[stride_ + i] = source[i].y;
    upFloats()[2 * stride_ + i] = source[i].z;
  }
  if (auto r = multiply(0); !r) return r;
  const auto* e = reinterpret_cast<const float*>(down_.mapped());
  for (uint32_t i = 0; i < settings_.places; ++i)
    if (seats_.taken(i)) irradiance[i] = {e[i], e[stride_ + i], e[2 * stride_ + i], 0};
  return {};
}

Result<void> VulkanMultibounce::relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                                               std::span<Vec4> irradiance) {
  seats_.checkChange(places, difference, irradiance);
  if (used_ == 0 || places.empty()) return {};
  std::memset(up_.mapped(), 0, uint64_t{3} * stride_ * sizeof(float));
  for (size_t i = 0; i < places.size(); ++i) {
    FF_CHECK_LT(places[i], settings_.places);
    if (!seats_.taken(places[i])) continue;
    upFloats()[places[i]] = difference[i].x;
    upFloats()[stride_ + places[i]] = difference[i].y;
    upFloats()[2 * stride_ + places[i]] = difference[i].z;
  }
  // Columns are read 4 bytes at a time, and luminance needs all of them after the first product.
  const bool few = !settings_.luminance && places.size() < used_ / 8;
  for (size_t i = 0; few && i < places.size(); ++i) upWords()[3 * stride_ + i] = places[i];
  if (auto r = multiply(few ? static_cast<uint32_t>(places.size()) : 0); !r) return r;
  const auto* e = reinterpret_cast<const float*>(down_.mapped());
  for (uint32_t i = 0; i < settings_.places; ++i) {
    if (!seats_.taken(i)) continue;
    irradiance[i].x += e[i];
    irradiance[i].y += e[stride_ + i];
    irradiance[i].z += e[2 * stride_ + i];
  }
  return {};
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeVulkanMultibounce(std::shared_ptr<VkContext> context,
                                                            const MultibounceSettings& settings) {
  const auto refused = [](const std::string& message, const std::string& remedy) {
    return Error{ErrorCode::kUsage, "", "multibounce vulkan", message, remedy};
  };
  if (settings.places == 0) return refused("a matrix needs at least one place", "set places");
  const auto& limits = context->limits();
  const uint64_t element = settings.storage == Storage::kFloat16 ? 2 : 4, stride = roundUp(settings.places, shaders::kBounceTile);
  if (stride * stride * element > limits.maxStorageBufferRange) {
    const auto most = static_cast<uint64_t>(std::sqrt(static_cast<double>(limits.maxStorageBufferRange) / static_cast<double>(element)));
    return refused(std::to_string(settings.places) + " places take " + std::to_string((stride * stride * element) >> 20) +
                       " MiB a channel, the device binds at most " + std::to_string(limits.maxStorageBufferRange >> 20) + " MiB",
                   "use at most " + std::to_string(most / shaders::kBounceTile * shaders::kBounceTile) + " places" +
                       (element == 4 ? ", or fp16 storage" : ""));
  }
  if (limits.maxComputeSharedMemorySize < kSharedBytes)
    return refused("the device lacks " + std::to_string(kSharedBytes >> 10) + " KiB of shared memory", "use the CPU solver");
  auto pipelines = makePipelines(*context, settings);
  if (!pipelines) return pipelines.error();
  auto m = std::make_unique<VulkanMultibounce>(std::move(context), settings, std::move(*pipelines));
  if (auto r = m->allocate(); !r) return r.error();
  return std::unique_ptr<BounceMatrix>(std::move(m));
}

}  // namespace ff::runtime
