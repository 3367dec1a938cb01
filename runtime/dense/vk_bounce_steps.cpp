#include "runtime/dense/vk_bounce_steps.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <utility>

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
#include "runtime/vulkan/device.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kBuffers = 6;             // bindings of bounce.glsl
constexpr uint32_t kSharedBytes = 18 << 10;  // of bounce_solve.comp
static_assert(shaders::kBounceBlock == kMaxBlock);

Error refusal(std::string message) {
  return Error{ErrorCode::kInvalidFile, "", "", std::move(message), "rebuild the matrix, or use the gather solver"};
}

}  // namespace

const char* whyRefused(bool leaving) {
  return leaving ? "the matrix has lost its precision: I + G C is singular"
                 : "light would be caught among the nodes that enter: I - S C is singular to working precision";
}

VulkanBounceSteps::VulkanBounceSteps(std::shared_ptr<VkContext> context, const MultibounceSettings& settings)
    : context_(std::move(context)),
      settings_(settings),
      stride_(roundUp(settings.places, shaders::kBounceTile)),
      planes_(settings.luminance ? 1 : 3),
      colour_(settings.places),
      index_(stride_, shaders::kNotInBlock) {
  name_ = std::string("multibounce vulkan ") + (settings.storage == Storage::kFloat16 ? "fp16" : "fp32") +
          (settings.luminance ? " luminance: " : ": ") + context_->deviceName();
}

Result<std::unique_ptr<VulkanBounceSteps>> VulkanBounceSteps::create(std::shared_ptr<VkContext> context,
                                                                     const MultibounceSettings& settings) {
  const auto refused = [](const std::string& message, const std::string& remedy) {
    return Error{ErrorCode::kUsage, "", "multibounce vulkan", message, remedy};
  };
  if (settings.places == 0) return refused("a matrix needs at least one place", "set places");
  const auto& limits = context->limits();
  const uint64_t element = settings.storage == Storage::kFloat16 ? 2 : 4,
                 stride = roundUp(settings.places, shaders::kBounceTile);
  if (stride * stride * element > limits.maxStorageBufferRange) {
    const auto most = static_cast<uint64_t>(
        std::sqrt(static_cast<double>(limits.maxStorageBufferRange) / static_cast<double>(element)));
    return refused(std::to_string(settings.places) + " places take " +
                       std::to_string((stride * stride * element) >> 20) + " MiB a channel, the device binds at most " +
                       std::to_string(limits.maxStorageBufferRange >> 20) + " MiB",
                   "use at most " + std::to_string(most / shaders::kBounceTile * shaders::kBounceTile) + " places" +
                       (element == 4 ? ", or fp16 storage" : ""));
  }
  if (limits.maxComputeSharedMemorySize < kSharedBytes)
    return refused("the device lacks " + std::to_string(kSharedBytes >> 10) + " KiB of shared memory",
                   "use the CPU solver");
  auto steps = std::unique_ptr<VulkanBounceSteps>(new VulkanBounceSteps(std::move(context), settings));
  if (auto r = steps->makePipelines(); !r) return r.error();
  if (auto r = steps->makeBuffers(); !r) return r.error();
  return steps;
}

Result<void> VulkanBounceSteps::makePipelines() {
  const bool half = settings_.storage == Storage::kFloat16;
  Pipelines& p = pipelines_;
  using Words = std::span<const uint32_t>;
  const Words relight_words =
      settings_.luminance ? (half ? Words(bounce_relight_luminance_half_comp) : Words(bounce_relight_luminance_comp))
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
    auto made = ComputePipeline::create(*context_, words, kBuffers, sizeof(shaders::BouncePush));
    if (!made) return made.error();
    *pipeline = std::move(*made);
  }
  return {};
}

Result<void> VulkanBounceSteps::makeBuffers() {
  constexpr uint64_t kFloat = sizeof(float);
  struct Wanted {
    Buffer* buffer;
    uint64_t bytes;
  };
  std::vector<Wanted> list{{&block_, maxWords() * kFloat},
                           {&albedo_, uint64_t{4} * stride_ * kFloat},
                           {&vectors_, vectorAt(3, 0)},
                           {&status_, 16}};
  for (uint32_t p = 0; p < planes_; ++p) {
    list.push_back({&matrix_[p], planeBytes()});
    list.push_back({&panels_[p], (uint64_t{3} * kMaxBlock * stride_ + uint64_t{2} * kMaxBlock * kMaxBlock) * kFloat});
  }
  for (const Wanted& w : list) {
    auto b = Buffer::create(*context_, w.bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
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
  auto zeroed_all = context_->run([&](VkCommandBuffer c) {
    for (uint32_t p = 0; p < planes_; ++p) vkCmdFillBuffer(c, panels_[p].handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, vectors_.handle(), 0, VK_WHOLE_SIZE, 0);
    recordClear(c);
  });
  if (!zeroed_all) return zeroed_all.error();
  return {};
}

uint64_t VulkanBounceSteps::maxWords() const {
  return shaders::kBlockIndex + stride_ + uint64_t{4} * kMaxBlock * stride_;
}

uint64_t VulkanBounceSteps::wordsOf(const EnteringBlock& block) const {
  return shaders::kBlockIndex + stride_ + 2 * (block.columns.size() + block.receivers.size());
}

void VulkanBounceSteps::recordClear(VkCommandBuffer c) {
  for (uint32_t p = 0; p < planes_; ++p) vkCmdFillBuffer(c, matrix_[p].handle(), 0, VK_WHOLE_SIZE, 0);
  vkCmdFillBuffer(c, albedo_.handle(), 0, VK_WHOLE_SIZE, 0);
  vkCmdFillBuffer(c, status_.handle(), 0, VK_WHOLE_SIZE, 0);
  used_ = frontier_ = pending_k_ = 0;
}

void VulkanBounceSteps::recordFill(VkCommandBuffer c, float value) const {
  for (uint32_t p = 0; p < planes_; ++p)
    vkCmdFillBuffer(c, matrix_[p].handle(), 0, VK_WHOLE_SIZE, std::bit_cast<uint32_t>(value));
}

// Places, albedos and the way back from place to number.
void VulkanBounceSteps::describeHead(std::span<const uint32_t> places, uint32_t* words) {
  for (uint32_t i = 0; i < places.size(); ++i) {
    words[shaders::kBlockPlaces + i] = places[i];
    index_[places[i]] = i;
    const Vec4& a = colour_[places[i]];
    const float channels[4] = {a.x, a.y, a.z, (a.x + a.y + a.z) / 3};
    for (uint32_t c = 0; c < 4; ++c)
      words[shaders::kBlockAlbedo + c * kMaxBlock + i] = std::bit_cast<uint32_t>(channels[c]);
  }
  std::memcpy(words + shaders::kBlockIndex, index_.data(), index_.size() * sizeof(uint32_t));
  for (const uint32_t place : places) index_[place] = shaders::kNotInBlock;
}

Result<VulkanBounceSteps::Block> VulkanBounceSteps::describe(const EnteringBlock& block, uint32_t* words) {
  Block b;
  b.k = static_cast<uint32_t>(block.places.size());
  FF_CHECK_LT(0u, b.k);
  FF_CHECK_LE(b.k, kMaxBlock);
  FF_CHECK_LE(block.columns.size(), size_t{b.k} * settings_.places);
  FF_CHECK_LE(block.receivers.size(), size_t{b.k} * settings_.places);
  if (!hasValidFormFactors(block)) return refusal("a form factor is not a finite number >= 0");
  for (const Vec4& a : block.albedo)
    if (!(std::isfinite(a.x + a.y + a.z) && std::min({a.x, a.y, a.z}) >= 0))
      return refusal("an albedo is not a finite number >= 0");
  b.used = used_;
  for (uint32_t i = 0; i < b.k; ++i) {
    FF_CHECK_LT(block.places[i], settings_.places);
    const Vec4& a = block.albedo[i];
    colour_[block.places[i]] = {std::min(a.x, kMaxKept), std::min(a.y, kMaxKept), std::min(a.z, kMaxKept), 0};
    b.clamped += std::max({a.x, a.y, a.z}) > kMaxKept;
    b.used = std::max(b.used, roundUp(block.places[i] + 1, shaders::kBounceTile));
  }
  describeHead(block.places, words);
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
  b.columns_at = at;
  add(block.receivers, block.column_values);
  b.words = at;
  b.row_entries = static_cast<uint32_t>(block.columns.size());
  b.column_entries = static_cast<uint32_t>(block.receivers.size());
  return b;
}

VulkanBounceSteps::Block VulkanBounceSteps::describe(std::span<const uint32_t> leaving, uint32_t* words) {
  FF_CHECK_LE(leaving.size(), size_t{kMaxBlock});
  describeHead(leaving, words);
  Block b;
  b.k = static_cast<uint32_t>(leaving.size());
  b.leaving = true;
  b.words = shaders::kBlockIndex + stride_;
  b.used = used_;
  return b;
}

shaders::BouncePush VulkanBounceSteps::push() const {
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
void VulkanBounceSteps::dispatch(VkCommandBuffer c, const ComputePipeline& pipeline, shaders::BouncePush push,
                                 uint32_t groups) const {
  for (uint32_t plane = 0; plane < planes_; ++plane) {
    push.channel = settings_.luminance ? shaders::kBounceMean : plane;
    push.bound = settings_.luminance ? shaders::kBounceMean : 0;
    pipeline.dispatch(c, sets_of_planes_[plane], &push, groups);
  }
}

void VulkanBounceSteps::recordUpload(VkCommandBuffer c, const Block& block, VkBuffer from, uint64_t offset) const {
  const VkBufferCopy copy{offset, 0, block.words * sizeof(uint32_t)};
  vkCmdCopyBuffer(c, from, block_.handle(), 1, &copy);
  vkCmdFillBuffer(c, status_.handle(), 0, sizeof(uint32_t), 0);
}

void VulkanBounceSteps::recordFold(VkCommandBuffer c, uint32_t first, uint32_t end, uint32_t k) const {
  if (k == 0 || first >= end) return;
  shaders::BouncePush p = push();
  p.k = k;
  p.first = first;
  p.end = end;
  const uint32_t across = groupsOf(end, shaders::kBounceTile) - first / shaders::kBounceTile;
  dispatch(c, pipelines_.fold, p, across * (used_ / shaders::kBounceTile));
}

// Finishes the last update, finds the factors of the new one and, unless updates are time-sliced, folds it in.
void VulkanBounceSteps::recordChange(VkCommandBuffer c, const Block& block) {
  recordFold(c, frontier_, used_, pending_k_);
  separate(c);
  used_ = block.used;
  const uint32_t k = block.k;
  shaders::BouncePush p = push();
  p.k = k;
  p.leaving = block.leaving;
  p.columns_at = block.columns_at;
  p.count = block.row_entries;
  const uint32_t wide_groups = k * groupsOf(used_ / 4, shaders::kBounceGroup);
  dispatch(c, pipelines_.tall, p, used_);
  dispatch(c, pipelines_.wide, p, wide_groups);
  separate(c);
  const uint32_t entries = block.row_entries + block.column_entries;
  dispatch(c, pipelines_.scatter, p, groupsOf(std::max(k, entries), shaders::kBounceGroup));
  separate(c);
  dispatch(c, pipelines_.corner, p, groupsOf(k * k, shaders::kBounceGroup / std::max(1u, context_->subgroupSize())));
  separate(c);
  dispatch(c, pipelines_.solve, p, 1);
  separate(c);
  dispatch(c, pipelines_.apply, p, wide_groups);
  if (!settings_.time_slice) {
    separate(c);
    recordFold(c, 0, used_, k);
  }
  frontier_ = 0;
  pending_k_ = settings_.time_slice ? k : 0;
}

void VulkanBounceSteps::recordAdvance(VkCommandBuffer c, uint32_t columns) {
  const uint32_t end = frontier_ + std::min(columns, used_ - frontier_);
  recordFold(c, frontier_, end, pending_k_);
  frontier_ = end;
  if (frontier_ == used_) forgetPending();
}

void VulkanBounceSteps::recordLight(VkCommandBuffer c, VkBuffer from, uint64_t offset, uint32_t changed_places) const {
  const uint64_t channel_bytes = uint64_t{stride_} * sizeof(float);
  VkBufferCopy copies[3];
  for (uint32_t channel = 0; channel < 3; ++channel)
    copies[channel] = {offset + channel * channel_bytes, vectorAt(channel, 0), channel_bytes};
  vkCmdCopyBuffer(c, from, vectors_.handle(), 3, copies);
  if (changed_places == 0) return;
  const VkBufferCopy places{offset + 3 * channel_bytes, 0, uint64_t{changed_places} * sizeof(uint32_t)};
  vkCmdCopyBuffer(c, from, block_.handle(), 1, &places);
}

void VulkanBounceSteps::recordIrradiance(VkCommandBuffer c, VkBuffer to, uint64_t offset) const {
  const uint64_t channel_bytes = uint64_t{stride_} * sizeof(float);
  VkBufferCopy copies[3];
  for (uint32_t channel = 0; channel < 3; ++channel)
    copies[channel] = {vectorAt(channel, irradianceAt()), offset + channel * channel_bytes, channel_bytes};
  vkCmdCopyBuffer(c, vectors_.handle(), to, 3, copies);
}

void VulkanBounceSteps::recordProduct(VkCommandBuffer c, uint32_t changed_places) const {
  const uint32_t subgroups = shaders::kBounceGroup / std::max(1u, context_->subgroupSize());
  const uint32_t products = settings_.luminance ? kLuminanceProducts : 1;
  for (uint32_t i = 0; i < products; ++i) {
    shaders::BouncePush p = push();
    p.x_at = i * stride_;
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
}

}  // namespace ff::runtime
