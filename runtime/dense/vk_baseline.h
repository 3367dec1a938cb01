// What the baselines on Vulkan have in common: who sits where, light up and irradiance down, and how a matrix and its
// pipelines are made.
#pragma once
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "runtime/dense/places.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "runtime/vulkan/pipeline.h"

namespace ff::runtime {

class VulkanBaseline : public BounceMatrix {
 public:
  uint32_t capacity() const override { return seats_.capacity(); }
  BounceStats stats() const override { return stats_; }
  const char* name() const override { return name_.c_str(); }
  Result<uint32_t> advance(uint32_t) override { return 0u; }
  Result<void> insert(const EnteringBlock& block) override;
  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override;
  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override;

 protected:
  // name: without the device's.
  VulkanBaseline(std::shared_ptr<VkContext> context, uint32_t places, const std::string& name);

  struct WantedBuffer {
    Buffer* buffer;
    uint64_t bytes;
    MemoryUse use;
  };
  using WantedPipeline = std::pair<ComputePipeline*, std::span<const uint32_t>>;  // and its words
  // bound: in the order of the bindings. Errors: those of the device.
  Result<void> make(std::span<const WantedPipeline> pipelines, uint32_t push_bytes, std::span<const WantedBuffer> buffers,
                    std::span<const Buffer* const> bound);

  // At most kMaxBlock patches with form factors that are some. Takes their places.
  virtual Result<void> enter(const EnteringBlock& block) = 0;
  // Light for up_: black, then place by place.
  virtual void clearLight() = 0;
  virtual void putLight(uint32_t place, const Vec4& light) = 0;
  // From the light in up_ to irradiance in down_.
  virtual Result<void> multiply() = 0;
  virtual void addIrradiance(std::span<Vec4> irradiance) const = 0;

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  Places seats_;
  Buffer up_, down_;
  StorageSets sets_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
  BounceStats stats_;

 private:
  std::string name_;
};

// Errors (kUsage): no places, or more bytes than the device can bind at once.
Result<void> checkMatrixFits(const VkContext& context, const std::string& what, uint32_t places, uint64_t bytes,
                             const std::string& remedy);

}  // namespace ff::runtime
