// The multi-bounce matrix's memory on a device and the commands that change and multiply it (vk_multibounce.h has the
// formulas): what the matrix that waits (makeVulkanMultibounce) and the recorder (vk_dense_step.h) have in common.
// Nothing here submits or waits but create().
#pragma once
#include <vulkan/vulkan.h>

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "runtime/dense/bounce_matrix.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/pipeline.h"
#include "shaders/shared.h"

namespace ff::runtime {

class VkContext;

// Why status() is not 0, of a block that leaves or enters.
const char* whyRefused(bool leaving);

class VulkanBounceSteps {
 public:
  // A block that enters or leaves, as it was described.
  struct Block {
    uint32_t k = 0;
    bool leaving = false;
    uint64_t words = 0;  // of the description
    uint32_t columns_at = 0, row_entries = 0, column_entries = 0;
    uint32_t used = 0;     // places in use lie below it, this block's among them
    uint32_t clamped = 0;  // albedos that were lowered
  };

  // Errors: as makeVulkanMultibounce.
  static Result<std::unique_ptr<VulkanBounceSteps>> create(std::shared_ptr<VkContext> context,
                                                           const MultibounceSettings& settings);

  const MultibounceSettings& settings() const { return settings_; }
  const std::string& name() const { return name_; }  // "multibounce vulkan fp32: DEVICE"
  uint32_t stride() const { return stride_; }
  uint64_t bytes() const { return planeBytes() * planes_; }
  uint64_t maxWords() const;  // of a description
  // Words that describing a block that enters takes; one that leaves takes those of an empty one.
  uint64_t wordsOf(const EnteringBlock& block) const;

  // Describe a block in wordsOf() words. The places must be free, or taken. Errors (kInvalidFile): a form factor or an
  // albedo that is none; nothing has changed then.
  Result<Block> describe(const EnteringBlock& block, uint32_t* words);
  Block describe(std::span<const uint32_t> leaving, uint32_t* words);

  // In the order that commands need: upload, separate(), change. A change finishes the last one first; unless updates
  // are time-sliced it is folded in. Afterwards status() says whether the block was refused.
  void recordUpload(VkCommandBuffer c, const Block& block, VkBuffer from, uint64_t offset) const;
  void recordChange(VkCommandBuffer c, const Block& block);
  void forgetPending() { frontier_ = pending_k_ = 0; }  // the last block was refused
  // Brings up to so many columns up to date; pending() then says how many are left.
  void recordAdvance(VkCommandBuffer c, uint32_t columns);
  uint32_t pending() const { return pending_k_ > 0 ? used_ - frontier_ : 0; }
  // Light to the vectors, [channel][place], 3 * stride() floats; behind it lie that many places, for recordProduct().
  void recordLight(VkCommandBuffer c, VkBuffer from, uint64_t offset, uint32_t changed_places) const;
  // E = G x from the vectors to the vectors. changed_places: 0, or the block's buffer holds that many places and only
  // their columns are multiplied. Separates its own steps and ends separated.
  void recordProduct(VkCommandBuffer c, uint32_t changed_places) const;
  // Irradiance from the vectors, in the order of the light.
  void recordIrradiance(VkCommandBuffer c, VkBuffer to, uint64_t offset) const;
  // All nodes are gone.
  void recordClear(VkCommandBuffer c);
  void recordFill(VkCommandBuffer c, float value) const;  // for tests: every word of the matrix

  uint32_t used() const { return used_; }
  const Buffer& block() const { return block_; }
  const Buffer& status() const { return status_; }  // shaders/bounce.glsl
  const Buffer& vectors() const { return vectors_; }
  uint64_t vectorAt(uint32_t channel, uint32_t at) const {  // bytes; x is at 0, E at irradianceAt()
    return (uint64_t{channel} * (4 * stride_ + kMaxBlock) + at) * sizeof(float);
  }
  uint32_t irradianceAt() const { return 3 * stride_; }

 private:
  struct Pipelines {
    ComputePipeline tall, wide, scatter, corner, solve, apply, fold, relight, pending, changed;
  };
  VulkanBounceSteps(std::shared_ptr<VkContext> context, const MultibounceSettings& settings);
  Result<void> makePipelines();
  Result<void> makeBuffers();
  uint64_t planeBytes() const { return uint64_t{stride_} * stride_ * (settings_.storage == Storage::kFloat16 ? 2 : 4); }
  shaders::BouncePush push() const;
  void dispatch(VkCommandBuffer c, const ComputePipeline& pipeline, shaders::BouncePush push, uint32_t groups) const;
  void describeHead(std::span<const uint32_t> places, uint32_t* words);
  void recordFold(VkCommandBuffer c, uint32_t first, uint32_t end, uint32_t k) const;

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  MultibounceSettings settings_;
  std::string name_;
  uint32_t stride_, planes_;
  uint32_t used_ = 0;                      // multiple of the tile; places from here on are free
  uint32_t frontier_ = 0, pending_k_ = 0;  // columns below it are up to date; k of the factors, 0: all are
  Pipelines pipelines_;
  Buffer matrix_[3], panels_[3], block_, albedo_, vectors_, status_;
  StorageSets sets_;
  VkDescriptorSet sets_of_planes_[3] = {};
  std::vector<Vec4> colour_;     // albedo of each place
  std::vector<uint32_t> index_;  // per place its number in the block
};

}  // namespace ff::runtime
