// Instance, physical device, device, queue. Core Vulkan 1.2, nothing beyond it is needed.
#pragma once
#include <vulkan/vulkan.h>

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "formats/result.h"
#include "runtime/vk_context.h"

namespace ff::runtime {

class VkHeap;

// A Vulkan struct with its type set and all else zero.
template <class T>
T zeroed(VkStructureType type) {
  T t{};
  t.sType = type;
  return t;
}

// "vkCreateBuffer failed: VK_ERROR_OUT_OF_DEVICE_MEMORY", kIo.
Error vkError(const char* call, VkResult result);

class VkContext {
 public:
  static Result<std::shared_ptr<VkContext>> open(const VulkanChoice& choice);
  VkContext(const VkContext&) = delete;
  VkContext& operator=(const VkContext&) = delete;
  ~VkContext();

  VkDevice device() const { return device_; }
  VkPhysicalDevice physicalDevice() const { return physical_; }
  const VkPhysicalDeviceLimits& limits() const { return properties_.limits; }
  std::string deviceName() const { return properties_.deviceName; }
  uint32_t subgroupSize() const { return subgroup_size_; }
  VkHeap& heap() { return *heap_; }
  std::vector<std::string> messages() const;

  // Records one command buffer, submits it and waits. Returns the time that the device took, ms (wall time where the
  // queue has no timestamps). Everything written before is visible to `record`'s commands, and what they write is
  // visible to the host and to the next run().
  Result<double> run(const std::function<void(VkCommandBuffer)>& record);

 private:
  VkContext() = default;
  Result<void> createInstance(const VulkanChoice& choice);
  Result<void> choosePhysicalDevice(const std::string& wanted);
  Result<void> createDevice(const VulkanChoice& choice);
  static VKAPI_ATTR VkBool32 VKAPI_CALL onMessage(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                  VkDebugUtilsMessageTypeFlagsEXT type,
                                                  const VkDebugUtilsMessengerCallbackDataEXT* data, void* user);

  VkInstance instance_ = VK_NULL_HANDLE;
  VkDebugUtilsMessengerEXT messenger_ = VK_NULL_HANDLE;
  VkPhysicalDevice physical_ = VK_NULL_HANDLE;
  VkPhysicalDeviceProperties properties_{};
  uint32_t subgroup_size_ = 0;
  uint32_t family_ = 0;
  bool has_timestamps_ = false;
  VkDevice device_ = VK_NULL_HANDLE;
  VkQueue queue_ = VK_NULL_HANDLE;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  VkFence fence_ = VK_NULL_HANDLE;
  VkQueryPool queries_ = VK_NULL_HANDLE;
  std::unique_ptr<VkHeap> heap_;
  mutable std::mutex message_mutex_;  // layers may call back from any thread
  std::vector<std::string> messages_;
};

}  // namespace ff::runtime
