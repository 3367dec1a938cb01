// Compute pipelines from embedded SPIR-V, and descriptor sets of storage buffers.
#pragma once
#include <vulkan/vulkan.h>

#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "formats/result.h"
#include "runtime/vulkan/handle.h"

namespace ff::runtime {

class VkContext;

// Work groups for so many items; multiples of a tile.
template <class Count>
Count groupsOf(Count items, std::type_identity_t<Count> a_group) {
  return (items + a_group - 1) / a_group;
}
template <class Count>
Count roundUp(Count value, std::type_identity_t<Count> multiple) {
  return groupsOf(value, multiple) * multiple;
}

using ShaderModule = Handle<VkShaderModule, vkDestroyShaderModule>;
Result<ShaderModule> makeShaderModule(VkContext& context, std::span<const uint32_t> spirv);

// One descriptor set of `buffers` storage buffers at bindings 0, 1, ...; one push constant block from offset 0.
class ComputePipeline {
 public:
  // variant: of the shader's specialization constant 0, a bool; ignored where it has none.
  static Result<ComputePipeline> create(VkContext& context, std::span<const uint32_t> spirv, uint32_t buffers,
                                        uint32_t push_bytes, bool variant = false);
  VkDescriptorSetLayout setLayout() const { return set_layout_; }
  uint32_t buffers() const { return buffers_; }
  // Records bind, push and dispatch; groups must not exceed maxComputeWorkGroupCount[0].
  void dispatch(VkCommandBuffer commands, VkDescriptorSet set, const void* push, uint32_t groups) const;

 private:
  Handle<VkDescriptorSetLayout, vkDestroyDescriptorSetLayout> set_layout_;
  Handle<VkPipelineLayout, vkDestroyPipelineLayout> layout_;
  Handle<VkPipeline, vkDestroyPipeline> pipeline_;
  uint32_t buffers_ = 0, push_bytes_ = 0;
};

// Descriptor sets of storage buffers that live and die together.
class StorageSets {
 public:
  static Result<StorageSets> create(VkContext& context, uint32_t max_sets, uint32_t max_buffers);
  Result<VkDescriptorSet> make(VkDescriptorSetLayout layout, std::span<const VkDescriptorBufferInfo> buffers);

 private:
  Handle<VkDescriptorPool, vkDestroyDescriptorPool> pool_;
};

}  // namespace ff::runtime
