#include "tools/view/graphics.h"

#include <map>
#include <utility>

#include "runtime/vulkan/pipeline.h"

namespace ff::view {

using runtime::vkError;
using runtime::zeroed;

namespace {
constexpr VkFormat kDepthFormat = VK_FORMAT_D32_SFLOAT;

Result<VkRenderPass> makePass(VkContext& context, std::span<const VkFormat> colours) {
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
  VkRenderPass pass = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateRenderPass(context.device(), &info, nullptr, &pass); r != VK_SUCCESS)
    return vkError("vkCreateRenderPass", r);
  return pass;
}

}  // namespace

Result<Target> Target::create(VkContext& context, VkExtent2D extent, std::span<const VkFormat> colours) {
  Target t;
  t.context_ = &context;
  t.extent_ = extent;
  auto pass = makePass(context, colours);
  if (!pass) return pass.error();
  t.pass_ = *pass;
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
  if (const VkResult r = vkCreateFramebuffer(context.device(), &info, nullptr, &t.framebuffer_); r != VK_SUCCESS)
    return vkError("vkCreateFramebuffer", r);
  return t;
}

Target::~Target() {
  if (!context_) return;
  vkDestroyFramebuffer(context_->device(), framebuffer_, nullptr);
  vkDestroyRenderPass(context_->device(), pass_, nullptr);
}

void Target::swap(Target& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(extent_, other.extent_);
  std::swap(colours_, other.colours_);
  std::swap(depth_, other.depth_);
  std::swap(pass_, other.pass_);
  std::swap(framebuffer_, other.framebuffer_);
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
  GraphicsPipeline p;
  p.context_ = &context;
  p.push_bytes_ = spec.push_bytes;
  constexpr VkShaderStageFlags kStages = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
  std::vector<VkDescriptorSetLayoutBinding> bindings;
  for (const VkDescriptorType type : spec.bindings)
    bindings.push_back({static_cast<uint32_t>(bindings.size()), type, 1, kStages, nullptr});
  auto set = zeroed<VkDescriptorSetLayoutCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set.bindingCount = static_cast<uint32_t>(bindings.size());
  set.pBindings = bindings.data();
  if (const VkResult r = vkCreateDescriptorSetLayout(context.device(), &set, nullptr, &p.set_layout_); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorSetLayout", r);
  const VkPushConstantRange push{kStages, 0, spec.push_bytes};
  auto layout = zeroed<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &p.set_layout_;
  layout.pushConstantRangeCount = spec.push_bytes ? 1 : 0;
  layout.pPushConstantRanges = &push;
  if (const VkResult r = vkCreatePipelineLayout(context.device(), &layout, nullptr, &p.layout_); r != VK_SUCCESS)
    return vkError("vkCreatePipelineLayout", r);

  auto vertex_module = runtime::makeShaderModule(context, spec.vertex);
  if (!vertex_module) return vertex_module.error();
  auto fragment_module = runtime::makeShaderModule(context, spec.fragment);
  if (!fragment_module) {
    vkDestroyShaderModule(context.device(), *vertex_module, nullptr);
    return fragment_module.error();
  }
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
  const VkResult r = vkCreateGraphicsPipelines(context.device(), VK_NULL_HANDLE, 1, &info, nullptr, &p.pipeline_);
  vkDestroyShaderModule(context.device(), *vertex_module, nullptr);
  vkDestroyShaderModule(context.device(), *fragment_module, nullptr);
  if (r != VK_SUCCESS) return vkError("vkCreateGraphicsPipelines", r);
  return p;
}

GraphicsPipeline::~GraphicsPipeline() {
  if (!context_) return;
  vkDestroyPipeline(context_->device(), pipeline_, nullptr);
  vkDestroyPipelineLayout(context_->device(), layout_, nullptr);
  vkDestroyDescriptorSetLayout(context_->device(), set_layout_, nullptr);
}

void GraphicsPipeline::swap(GraphicsPipeline& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(set_layout_, other.set_layout_);
  std::swap(layout_, other.layout_);
  std::swap(pipeline_, other.pipeline_);
  std::swap(push_bytes_, other.push_bytes_);
}

void GraphicsPipeline::bind(VkCommandBuffer commands, VkDescriptorSet set, const void* push) const {
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline_);
  if (set) vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, layout_, 0, 1, &set, 0, nullptr);
  if (push_bytes_)
    vkCmdPushConstants(commands, layout_, VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT, 0, push_bytes_, push);
}

Result<DrawingSet> DrawingSet::create(VkContext& context, VkDescriptorSetLayout layout,
                                      std::span<const VkDescriptorType> bindings) {
  DrawingSet d;
  d.context_ = &context;
  std::map<VkDescriptorType, uint32_t> counts;
  for (const VkDescriptorType type : bindings) ++counts[type];
  std::vector<VkDescriptorPoolSize> sizes;
  for (const auto& [type, count] : counts) sizes.push_back({type, count});
  auto pool = zeroed<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  pool.maxSets = 1;
  pool.poolSizeCount = static_cast<uint32_t>(sizes.size());
  pool.pPoolSizes = sizes.data();
  if (const VkResult r = vkCreateDescriptorPool(context.device(), &pool, nullptr, &d.pool_); r != VK_SUCCESS)
    return vkError("vkCreateDescriptorPool", r);
  auto info = zeroed<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  info.descriptorPool = d.pool_;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &layout;
  if (const VkResult r = vkAllocateDescriptorSets(context.device(), &info, &d.set_); r != VK_SUCCESS)
    return vkError("vkAllocateDescriptorSets", r);
  auto sampler = zeroed<VkSamplerCreateInfo>(VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO);
  sampler.addressModeU = sampler.addressModeV = sampler.addressModeW = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  if (const VkResult r = vkCreateSampler(context.device(), &sampler, nullptr, &d.sampler_); r != VK_SUCCESS)
    return vkError("vkCreateSampler", r);
  return d;
}

DrawingSet::~DrawingSet() {
  if (!context_) return;
  vkDestroySampler(context_->device(), sampler_, nullptr);
  vkDestroyDescriptorPool(context_->device(), pool_, nullptr);
}

void DrawingSet::swap(DrawingSet& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(pool_, other.pool_);
  std::swap(sampler_, other.sampler_);
  std::swap(set_, other.set_);
}

void DrawingSet::setBuffer(uint32_t binding, const Buffer& buffer) {
  const VkDescriptorBufferInfo range{buffer.handle(), 0, VK_WHOLE_SIZE};
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set_;
  write.dstBinding = binding;
  write.descriptorCount = 1;
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = &range;
  vkUpdateDescriptorSets(context_->device(), 1, &write, 0, nullptr);
}

void DrawingSet::setImage(uint32_t binding, const Image& image) {
  const VkDescriptorImageInfo sampled{sampler_, image.view(), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
  auto write = zeroed<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set_;
  write.dstBinding = binding;
  write.descriptorCount = 1;
  write.descriptorType = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
  write.pImageInfo = &sampled;
  vkUpdateDescriptorSets(context_->device(), 1, &write, 0, nullptr);
}

}  // namespace ff::view
