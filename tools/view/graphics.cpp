#include "tools/view/graphics.h"

#include <map>
#include <utility>

#include "runtime/vulkan/pipeline.h"

namespace ff::view {

using runtime::vkError;
using runtime::zeroed;

namespace {
constexpr VkFormat kDepthFormat = VK_FORMAT_D32_SFLOAT;

Result<Handle<VkRenderPass, vkDestroyRenderPass>> makePass(VkContext& context, std::span<const VkFormat> colours) {
  std::vector<VkAttachmentDescription> attachments;
  std::vector<VkAttachmentReference> references;
  for (const VkFormat format : colours) {
    references.push_back({static_cast<uint32_t>(attachments.size()), VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL});
    attachments.push_back({0, format, VK_SAMPLE_COUNT_1_BIT, VK_ATTACHMENT_LOAD_OP_CLEAR, VK_ATTACHMENT_STORE_OP_STORE,
                           VK_ATTACHMENT_LOAD_OP_DONT_CARE, VK_ATTACHMENT_STORE_OP_DONT_CARE, VK_IMAGE_LAYOUT_UNDEFINED,
                           VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL});
  }
  const VkAttachmentReference depth{static_cast<uint32_t>(attachments.size()),
                                    VK_IMAGE_LAYOUT_DEPTH_STENCIL_ATTACHMENT_OPTIMAL};
  attachments.push_back({0, kDepthFormat, VK_SAMPLE_COUNT_1_BIT, VK_ATTACHMENT_LOAD_OP_CLEAR,
                         VK_ATTACHMENT_STORE_OP_STORE, VK_ATTACHMENT_LOAD_OP_DONT_CARE, VK_ATTACHMENT_STORE_OP_DONT_CARE,
                         VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL});
  VkSubpassDescription subpass{};
  subpass.pipelineBindPoint = VK_PIPELINE_BIND_POINT_GRAPHICS;
  subpass.colorAttachmentCount = static_cast<uint32_t>(references.size());
  subpass.pColorAttachments = references.data();
  subpass.pDepthStencilAttachment = &depth;
  constexpr VkPipelineStageFlags kDepthStages =
      VK_PIPELINE_STAGE_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_LATE_FRAGMENT_TESTS_BIT;
  constexpr VkPipelineStageFlags kUsers = VK_PIPELINE_STAGE_TRANSFER_BIT | VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT;
  constexpr VkPipelineStageFlags kWriters = VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | kDepthStages;
  constexpr VkAccessFlags kWrites =
      VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT;
  const VkSubpassDependency dependencies[2] = {
      // An earlier pass over the same images, and whoever read its result, are done before this one clears.
      {VK_SUBPASS_EXTERNAL, 0, kUsers | kWriters, kWriters, kWrites | VK_ACCESS_TRANSFER_READ_BIT,
       kWrites | VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_READ_BIT | VK_ACCESS_COLOR_ATTACHMENT_READ_BIT, 0},
      {0, VK_SUBPASS_EXTERNAL, kWriters, kUsers, kWrites, VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_SHADER_READ_BIT, 0}};
  auto info = zeroed<VkRenderPassCreateInfo>(VK_STRUCTURE_TYPE_RENDER_PASS_CREATE_INFO);
  info.attachmentCount = static_cast<uint32_t>(attachments.size());
  info.pAttachments = attachments.data();
  info.subpassCount = 1;
  info.pSubpasses = &subpass;
  info.dependencyCount = 2;
  info.pDependencies = dependencies;
  Handle<VkRenderPass, vkDestroyRenderPass> pass;
  if (const VkResult r = vkCreateRenderPass(context.device(), &info, nullptr, pass.create(context.device())); r != VK_SUCCESS)
    return vkError("vkCreateRenderPass", r);
  return pass;
}

}  // namespace

Result<Target> Target::create(VkContext& context, VkExtent2D extent, std::span<const VkFormat> colours) {
  Target t;
  t.extent_ = extent;
  auto pass = makePass(context, colours);
  if (!pass) return pass.error();
  t.pass_ = std::move(*pass);
  std::vector<VkImageView> views;
  for (const VkFormat format : colours) {
    auto image = Image::create(context, extent, format,
                               VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT,
                               VK_IMAGE_ASPECT_COLOR_BIT);
    if (!image) return image.error();
    t.colours_.push_back(std::move(*image));
    views.push_back(t.colours_.back().view());
  }
  auto depth = Image::create(context, extent, kDepthFormat,
                             VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT,
                             VK_IMAGE_ASPECT_DEPTH_BIT);
  if (!depth) return depth.error();
  t.depth_ = std::move(*depth);
  views.push_back(t.depth_.view());
  auto info = zeroed<VkFramebufferCreateInfo>(VK_STRUCTURE_TYPE_FRAMEBUFFER_CREATE_INFO);
  info.renderPass = t.pass_;
  info.attachmentCount = static_cast<uint32_t>(views.size());
  info.pAttachments = views.data();
  info.width = extent.width;
  info.height = extent.height;
  info.layers = 1;
  if (const VkResult r = vkCreateFramebuffer(context.device(), &info, nullptr, t.framebuffer_.create(context.device()));
      r != VK_SUCCESS)
    return vkError("vkCreateFramebuffer", r);
  return t;
}

void Target::begin(VkCommandBuffer commands, std::span<const VkClearValue> clear) const {
  auto info = zeroed<VkRenderPassBeginInfo>(VK_STRUCTURE_TYPE_RENDER_PASS_BEGIN_INFO);
  info.renderPass = pass_;
  info.framebuffer = framebuffer_;
  info.renderArea.extent = extent_;
  info.clearValueCount = static_cast<uint32_t>(clear.size());
  info.pClearValues = clear.data();
  vkCmdBeginRenderPass(commands, &info, VK_SUBPASS_CONTENTS_INLINE);
  const VkViewport viewport{0, 0, static_cast<float>(extent_.width), static_cast<float>(extent_.height), 0, 1};
  const VkRect2D scissor{{0, 0}, extent_};
  vkCmdSetViewport(commands, 0, 1, &viewport);
  vkCmdSetScissor(commands, 0, 1, &scissor);
}

void Target::copyTo(VkCommandBuffer commands, size_t colour, const Buffer& buffer) const {
  VkBufferImageCopy copy{};
  copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  copy.imageExtent = {extent_.width, extent_.height, 1};
  vkCmdCopyImageToBuffer(commands, colours_[colour].handle(), VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, buffer.handle(), 1,
                         &copy);
}

Result<GraphicsPipeline> GraphicsPipeline::create(VkContext& context, const Target& target, const GraphicsSpec& spec) {
  const VkDevice device = context.device();
  GraphicsPipeline p;
  p.push_bytes_ = spec.push_bytes;
  constexpr VkShaderStageFlags kStages = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
  std::vector<VkDescriptorSetLayoutBinding> bindings;
  for (const VkDescriptorType type : spec.bindings)
    bindings.push_back({static_cast<uint32_t>(bindings.size()), type, 1, kStages, nullptr});
  auto set = zeroed<VkDescriptorSetLayoutCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set.bindingCount = static_cast<uint32_t>(bindings.size());
  set.pBindings = bindings.data();
  if (const VkResult r = vkCreateDescriptorSetLayout(device, &set, nullptr, p.set_layout_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorSetLayout", r);
  const VkDescriptorSetLayout set_layout = p.set_layout_;
  const VkPushConstantRange push{kStages, 0, spec.push_bytes};
  auto layout = zeroed<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &set_layout;
  layout.pushConstantRangeCount = spec.push_bytes ? 1 : 0;
  layout.pPushConstantRanges = &push;
  if (const VkResult r = vkCreatePipelineLayout(device, &layout, nullptr, p.layout_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreatePipelineLayout", r);

  auto vertex_module = runtime::makeShaderModule(context, spec.vertex);
  if (!vertex_module) return vertex_module.error();
  auto fragment_module = runtime::makeShaderModule(context, spec.fragment);
  if (!fragment_module) return fragment_module.error();
  VkPipelineShaderStageCreateInfo stages[2];
  for (auto& stage : stages) {
    stage = zeroed<VkPipelineShaderStageCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO);
    stage.pName = "main";
  }
  stages[0].stage = VK_SHADER_STAGE_VERTEX_BIT;
  stages[0].module = *vertex_module;
  stages[1].stage = VK_SHADER_STAGE_FRAGMENT_BIT;
  stages[1].module = *fragment_module;
  const VkVertexInputBindingDescription binding{0, spec.vertex_stride, VK_VERTEX_INPUT_RATE_VERTEX};
  auto input = zeroed<VkPipelineVertexInputStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO);
  input.vertexBindingDescriptionCount = spec.vertex_stride ? 1 : 0;
  input.pVertexBindingDescriptions = &binding;
  input.vertexAttributeDescriptionCount = static_cast<uint32_t>(spec.attributes.size());
  input.pVertexAttributeDescriptions = spec.attributes.data();
  auto assembly = zeroed<VkPipelineInputAssemblyStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO);
  assembly.topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST;
  auto viewport = zeroed<VkPipelineViewportStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO);
  viewport.viewportCount = viewport.scissorCount = 1;
  auto raster = zeroed<VkPipelineRasterizationStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO);
  raster.cullMode = spec.cull_back ? VK_CULL_MODE_BACK_BIT : VK_CULL_MODE_NONE;
  raster.frontFace = VK_FRONT_FACE_COUNTER_CLOCKWISE;
  raster.lineWidth = 1;
  auto samples = zeroed<VkPipelineMultisampleStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO);
  samples.rasterizationSamples = VK_SAMPLE_COUNT_1_BIT;
  auto depth = zeroed<VkPipelineDepthStencilStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO);
  depth.depthTestEnable = depth.depthWriteEnable = VK_TRUE;
  depth.depthCompareOp = spec.far_is_zero ? VK_COMPARE_OP_GREATER_OR_EQUAL : VK_COMPARE_OP_LESS_OR_EQUAL;
  VkPipelineColorBlendAttachmentState opaque{};
  opaque.colorWriteMask = VK_COLOR_COMPONENT_R_BIT | VK_COLOR_COMPONENT_G_BIT | VK_COLOR_COMPONENT_B_BIT | VK_COLOR_COMPONENT_A_BIT;
  const std::vector<VkPipelineColorBlendAttachmentState> blends(target.colours(), opaque);
  auto blend = zeroed<VkPipelineColorBlendStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO);
  blend.attachmentCount = static_cast<uint32_t>(blends.size());
  blend.pAttachments = blends.data();
  const VkDynamicState dynamic_states[2] = {VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
  auto dynamic = zeroed<VkPipelineDynamicStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO);
  dynamic.dynamicStateCount = 2;
  dynamic.pDynamicStates = dynamic_states;
  auto info = zeroed<VkGraphicsPipelineCreateInfo>(VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO);
  info.stageCount = 2;
  info.pStages = stages;
  info.pVertexInputState = &input;
  info.pInputAssemblyState = &assembly;
  info.pViewportState = &viewport;
  info.pRasterizationState = &raster;
  info.pMultisampleState = &samples;
  info.pDepthStencilState = &depth;
  info.pColorBlendState = &blend;
  info.pDynamicState = &dynamic;
  info.layout = p.layout_;
  info.renderPass = target.pass();
  if (const VkResult r = vkCreateGraphicsPipelines(device, VK_NULL_HANDLE, 1, &info, nullptr, p.pipeline_.create(device));
      r != VK_SUCCESS)
    return vkError("vkCreateGraphicsPipelines", r);
  return p;
}

void GraphicsPipeline::bind(VkCommandBuffer commands, VkDescriptorSet set, const void* push) const {
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline_);
  if (set) vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, layout_, 0, 1, &set, 0, nullptr);
  if (push_bytes_)
    vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT, 0, push_bytes_, push);
}

Result<DrawingSet> DrawingSet::create(VkContext& context, VkDescriptorSetLayout layout,
                                      std::span<const VkDescriptorType> bindings) {
  const VkDevice device = context.device();
  DrawingSet d;
  std::map<VkDescriptorType, uint32_t> counts;
  for (const VkDescriptorType type : bindings) ++counts[type];
  std::vector<VkDescriptorPoolSize> sizes;
  for (const auto& [type, count] : counts) sizes.push_back({type, count});
  auto pool = zeroed<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  pool.maxSets = 1;
  pool.poolSizeCount = static_cast<uint32_t>(sizes.size());
  pool.pPoolSizes = sizes.data();
  if (const VkResult r = vkCreateDescriptorPool(device, &pool, nullptr, d.pool_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorPool", r);
  auto info = zeroed<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  info.descriptorPool = d.pool_;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &layout;
  if (const VkResult r = vkAllocateDescriptorSets(device, &info, &d.set_); r != VK_SUCCESS)
    return vkError("vkAllocateDescriptorSets", r);
  auto sampler = zeroed<VkSamplerCreateInfo>(VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO);
  sampler.addressModeU = sampler.addressModeV = sampler.addressModeW = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  if (const VkResult r = vkCreateSampler(device, &sampler, nullptr, d.sampler_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateSampler", r);
  return d;
}

void DrawingSet::setBuffer(uint32_t binding, const Buffer& buffer) {
  const VkDescriptorBufferInfo range{buffer.handle(), 0, VK_WHOLE_SIZE};
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set_;
  write.dstBinding = binding;
  write.descriptorCount = 1;
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = &range;
  vkUpdateDescriptorSets(pool_.device(), 1, &write, 0, nullptr);
}

void DrawingSet::setImage(uint32_t binding, const Image& image) {
  const VkDescriptorImageInfo sampled{sampler_, image.view(), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set_;
  write.dstBinding = binding;
  write.descriptorCount = 1;
  write.descriptorType = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
  write.pImageInfo = &sampled;
  vkUpdateDescriptorSets(pool_.device(), 1, &write, 0, nullptr);
}

}  // namespace ff::view
