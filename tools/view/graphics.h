// Offscreen drawing: a target of colour images and a depth image, graphics pipelines for it, descriptor sets of storage
// buffers and sampled images. Plain Vulkan 1.2; waits for nothing, VkContext::run does.
#pragma once
#include <vulkan/vulkan.h>

#include <span>
#include <vector>

#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"

namespace ff::view {

using runtime::Buffer;
using runtime::Handle;
using runtime::Image;
using runtime::VkContext;

// Colour images end ready to be copied from, the depth image ready to be sampled. Move-only.
class Target {
 public:
  static Result<Target> create(VkContext& context, VkExtent2D extent, std::span<const VkFormat> colours);

  // clear: one per colour image, then depth.
  void begin(VkCommandBuffer commands, std::span<const VkClearValue> clear) const;
  void copyTo(VkCommandBuffer commands, size_t colour, const Buffer& buffer) const;  // after the end of the pass

  VkRenderPass pass() const { return pass_; }
  VkExtent2D extent() const { return extent_; }
  size_t colours() const { return colours_.size(); }
  const Image& depth() const { return depth_; }

 private:
  VkExtent2D extent_{};
  std::vector<Image> colours_;
  Image depth_;
  Handle<VkRenderPass, vkDestroyRenderPass> pass_;
  Handle<VkFramebuffer, vkDestroyFramebuffer> framebuffer_;
};

struct GraphicsSpec {
  std::span<const uint32_t> vertex, fragment;
  uint32_t vertex_stride = 0;  // 0: no vertex buffer
  std::vector<VkVertexInputAttributeDescription> attributes;
  bool cull_back = true;
  bool far_is_zero = false;  // reversed depth: 1 is nearest, 0 infinitely far. Even precision with floats.
  uint32_t push_bytes = 0;
  std::vector<VkDescriptorType> bindings;  // of set 0; empty: no set
};

// Triangles, depth-tested (equal passes). Draws into targets that are compatible with the one named at creation; viewport
// and scissor are the target's. Move-only.
class GraphicsPipeline {
 public:
  static Result<GraphicsPipeline> create(VkContext& context, const Target& target, const GraphicsSpec& spec);

  VkDescriptorSetLayout setLayout() const { return set_layout_; }
  void bind(VkCommandBuffer commands, VkDescriptorSet set, const void* push) const;

 private:
  Handle<VkDescriptorSetLayout, vkDestroyDescriptorSetLayout> set_layout_;
  Handle<VkPipelineLayout, vkDestroyPipelineLayout> layout_;
  Handle<VkPipeline, vkDestroyPipeline> pipeline_;
  uint32_t push_bytes_ = 0;
};

// One descriptor set with its pool, and a sampler for its images (nearest, clamped).
class DrawingSet {
 public:
  static Result<DrawingSet> create(VkContext& context, VkDescriptorSetLayout layout,
                                   std::span<const VkDescriptorType> bindings);
  VkDescriptorSet handle() const { return set_; }
  void setBuffer(uint32_t binding, const Buffer& buffer);
  void setImage(uint32_t binding, const Image& image);  // in VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL when used

 private:
  Handle<VkDescriptorPool, vkDestroyDescriptorPool> pool_;
  Handle<VkSampler, vkDestroySampler> sampler_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
};

}  // namespace ff::view
