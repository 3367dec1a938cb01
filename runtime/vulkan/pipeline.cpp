#include "runtime/vulkan/pipeline.h"

#include <utility>

#include "runtime/vulkan/device.h"

namespace ff::runtime {

Result<VkShaderModule> makeShaderModule(VkContext& context, std::span<const uint32_t> spirv) {
  auto info = zeroed<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
  info.codeSize = spirv.size_bytes();
  info.pCode = spirv.data();
  VkShaderModule module = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateShaderModule(context.device(), &info, nullptr, &module); r != VK_SUCCESS)
    return vkError("vkCreateShaderModule", r);
  return module;
}

Result<ComputePipeline> ComputePipeline::create(VkContext& context, std::span<const uint32_t> spirv, uint32_t buffers,
                                                uint32_t push_bytes, bool variant) {
  ComputePipeline p;
  p.context_ = &context;
  p.buffers_ = buffers;
  p.push_bytes_ = push_bytes;
  std::vector<VkDescriptorSetLayoutBinding> bindings(buffers);
  for (uint32_t i = 0; i < buffers; ++i)
    bindings[i] = {i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
  auto set = zeroed<VkDescriptorSetLayoutCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set.bindingCount = buffers;
  set.pBindings = bindings.data();
  if (const VkResult r = vkCreateDescriptorSetLayout(context.device(), &set, nullptr, &p.set_layout_); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorSetLayout", r);
  const VkPushConstantRange push{VK_SHADER_STAGE_COMPUTE_BIT, 0, push_bytes};
  auto layout = zeroed<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &p.set_layout_;
  layout.pushConstantRangeCount = push_bytes ? 1 : 0;
  layout.pPushConstantRanges = &push;
  if (const VkResult r = vkCreatePipelineLayout(context.device(), &layout, nullptr, &p.layout_); r != VK_SUCCESS)
    return vkError("vkCreatePipelineLayout", r);
  auto module = makeShaderModule(context, spirv);
  if (!module) return module.error();
  auto info = zeroed<VkComputePipelineCreateInfo>(VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO);
  info.stage = zeroed<VkPipelineShaderStageCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO);
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.module = *module;
  info.stage.pName = "main";
  const VkBool32 value = variant;
  const VkSpecializationMapEntry entry{0, 0, sizeof(value)};
  const VkSpecializationInfo constants{1, &entry, sizeof(value), &value};
  info.stage.pSpecializationInfo = &constants;
  info.layout = p.layout_;
  const VkResult r = vkCreateComputePipelines(context.device(), VK_NULL_HANDLE, 1, &info, nullptr, &p.pipeline_);
  vkDestroyShaderModule(context.device(), *module, nullptr);
  if (r != VK_SUCCESS) return vkError("vkCreateComputePipelines", r);
  return p;
}

ComputePipeline::~ComputePipeline() {
  if (!context_) return;
  vkDestroyPipeline(context_->device(), pipeline_, nullptr);
  vkDestroyPipelineLayout(context_->device(), layout_, nullptr);
  vkDestroyDescriptorSetLayout(context_->device(), set_layout_, nullptr);
}

void ComputePipeline::swap(ComputePipeline& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(set_layout_, other.set_layout_);
  std::swap(layout_, other.layout_);
  std::swap(pipeline_, other.pipeline_);
  std::swap(buffers_, other.buffers_);
  std::swap(push_bytes_, other.push_bytes_);
}

void ComputePipeline::dispatch(VkCommandBuffer commands, VkDescriptorSet set, const void* push, uint32_t groups) const {
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout_, 0, 1, &set, 0, nullptr);
  if (push_bytes_) vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_COMPUTE_BIT, 0, push_bytes_, push);
  vkCmdDispatch(commands, groups, 1, 1);
}

Result<StorageSets> StorageSets::create(VkContext& context, uint32_t max_sets, uint32_t max_buffers) {
  StorageSets s;
  s.context_ = &context;
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, max_buffers};
  auto info = zeroed<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  info.maxSets = max_sets;
  info.poolSizeCount = 1;
  info.pPoolSizes = &size;
  if (const VkResult r = vkCreateDescriptorPool(context.device(), &info, nullptr, &s.pool_); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorPool", r);
  return s;
}

StorageSets::~StorageSets() {
  if (context_) vkDestroyDescriptorPool(context_->device(), pool_, nullptr);
}

void StorageSets::swap(StorageSets& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(pool_, other.pool_);
}

Result<VkDescriptorSet> StorageSets::make(VkDescriptorSetLayout layout,
                                          std::span<const VkDescriptorBufferInfo> buffers) {
  auto info = zeroed<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  info.descriptorPool = pool_;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &layout;
  VkDescriptorSet set = VK_NULL_HANDLE;
  if (const VkResult r = vkAllocateDescriptorSets(context_->device(), &info, &set); r != VK_SUCCESS)
    return vkError("vkAllocateDescriptorSets", r);
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set;
  write.descriptorCount = static_cast<uint32_t>(buffers.size());  // consecutive bindings, one descriptor each
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = buffers.data();
  vkUpdateDescriptorSets(context_->device(), 1, &write, 0, nullptr);
  return set;
}

}  // namespace ff::runtime
