#include "runtime/vulkan/pipeline.h"

#include "runtime/vulkan/device.h"

namespace ff::runtime {

Result<ShaderModule> makeShaderModule(VkContext& context, std::span<const uint32_t> spirv) {
  auto info = zeroed<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
  info.codeSize = spirv.size_bytes();
  info.pCode = spirv.data();
  ShaderModule module;
  if (const VkResult r = vkCreateShaderModule(context.device(), &info, nullptr, module.create(context.device())); r != VK_SUCCESS)
    return vkError("vkCreateShaderModule", r);
  return module;
}

Result<ComputePipeline> ComputePipeline::create(VkContext& context, std::span<const uint32_t> spirv, uint32_t buffers,
                                                uint32_t push_bytes, bool variant) {
  const VkDevice device = context.device();
  ComputePipeline p;
  p.buffers_ = buffers;
  p.push_bytes_ = push_bytes;
  std::vector<VkDescriptorSetLayoutBinding> bindings(buffers);
  for (uint32_t i = 0; i < buffers; ++i)
    bindings[i] = {i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
  auto set = zeroed<VkDescriptorSetLayoutCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set.bindingCount = buffers;
  set.pBindings = bindings.data();
  if (const VkResult r = vkCreateDescriptorSetLayout(device, &set, nullptr, p.set_layout_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorSetLayout", r);
  const VkDescriptorSetLayout set_layout = p.set_layout_;
  const VkPushConstantRange push{VK_SHADER_STAGE_COMPUTE_BIT, 0, push_bytes};
  auto layout = zeroed<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &set_layout;
  layout.pushConstantRangeCount = push_bytes ? 1 : 0;
  layout.pPushConstantRanges = &push;
  if (const VkResult r = vkCreatePipelineLayout(device, &layout, nullptr, p.layout_.create(device)); r != VK_SUCCESS)
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
  if (const VkResult r = vkCreateComputePipelines(device, VK_NULL_HANDLE, 1, &info, nullptr, p.pipeline_.create(device));
      r != VK_SUCCESS)
    return vkError("vkCreateComputePipelines", r);
  return p;
}

void ComputePipeline::dispatch(VkCommandBuffer commands, VkDescriptorSet set, const void* push, uint32_t groups) const {
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout_, 0, 1, &set, 0, nullptr);
  if (push_bytes_) vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_COMPUTE_BIT, 0, push_bytes_, push);
  vkCmdDispatch(commands, groups, 1, 1);
}

Result<StorageSets> StorageSets::create(VkContext& context, uint32_t max_sets, uint32_t max_buffers) {
  StorageSets s;
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, max_buffers};
  auto info = zeroed<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  info.maxSets = max_sets;
  info.poolSizeCount = 1;
  info.pPoolSizes = &size;
  if (const VkResult r = vkCreateDescriptorPool(context.device(), &info, nullptr, s.pool_.create(context.device())); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorPool", r);
  return s;
}

Result<VkDescriptorSet> StorageSets::make(VkDescriptorSetLayout layout,
                                          std::span<const VkDescriptorBufferInfo> buffers) {
  auto info = zeroed<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  info.descriptorPool = pool_;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &layout;
  VkDescriptorSet set = VK_NULL_HANDLE;
  if (const VkResult r = vkAllocateDescriptorSets(pool_.device(), &info, &set); r != VK_SUCCESS)
    return vkError("vkAllocateDescriptorSets", r);
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set;
  write.descriptorCount = static_cast<uint32_t>(buffers.size());  // consecutive bindings, one descriptor each
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = buffers.data();
  vkUpdateDescriptorSets(pool_.device(), 1, &write, 0, nullptr);
  return set;
}

}  // namespace ff::runtime
