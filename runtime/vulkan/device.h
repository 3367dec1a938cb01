// Instance, physical device, device, queue: our own or the caller's. Core Vulkan 1.2, nothing beyond it is needed; of
// its optional parts: timelineSemaphore and subgroup arithmetic in compute shaders.
#pragma once
#include <vulkan/vulkan.h>

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "formats/result.h"
#include "runtime/vulkan/context.h"

namespace ff::runtime {

class VkHeap;

// A Vulkan struct with its type set and all else zero.
template <class T>
T zeroed(VkStructureType type) {
  T t{};
  t.sType = type;
  return t;
}

// "vkCreateBuffer failed: VK_ERROR_OUT_OF_DEVICE_MEMORY", kIo; cause tells a lost and a full device apart from the
// rest.
Error vkError(const char* call, VkResult result);

class VkContext {
 public:
  static Result<std::shared_ptr<VkContext>> open(const VulkanChoice& choice);
  // Runs on the caller's device and destroys nothing of it. The instance's and the device's API version must be at
  // least 1.2, `timelineSemaphore` must have been enabled, and queue_family must be able to compute (graphics is not
  // needed). The caller does not use the queue while a call that waits runs (Vulkan's rule: queues are externally
  // synchronised), and destroys the device only after the context. memory_bytes: as VulkanChoice.
  static Result<std::shared_ptr<VkContext>> adopt(VkInstance instance, VkPhysicalDevice physical, VkDevice device,
                                                  uint32_t queue_family, VkQueue queue, uint64_t memory_bytes = 0);
  VkContext(const VkContext&) = delete;
  VkContext& operator=(const VkContext&) = delete;
  ~VkContext();

  VkInstance instance() const { return instance_; }
  VkDevice device() const { return device_; }
  VkPhysicalDevice physicalDevice() const { return physical_; }
  const VkPhysicalDeviceLimits& limits() const { return properties_.limits; }
  std::string deviceName() const { return properties_.deviceName; }
  bool isSoftware() const { return properties_.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU; }
  uint32_t subgroupSize() const { return subgroup_size_; }
  uint32_t queueFamily() const { return family_; }
  bool hasTimestamps() const { return has_timestamps_; }
  uint64_t memoryBytes() const { return memory_bytes_; }  // VulkanChoice::memory_bytes
  VkHeap& heap() { return *heap_; }
  std::vector<std::string> messages() const;

  // Records one command buffer, submits it and waits. Returns the time that the device took, ms (wall time where the
  // queue has no timestamps). Everything written before is visible to `record`'s commands, and what they write is
  // visible to the host and to the next run().
  template <class Record>  // void(VkCommandBuffer)
  Result<double> run(const Record& record) {
    if (auto r = beginRun(); !r) return r.error();
    record(commands_);
    return finishRun();
  }

  // Inside `record`: the commands between the two are timed apart from the rest, timedMs() after the run. At most once.
  void beginTimed(VkCommandBuffer commands);
  void endTimed(VkCommandBuffer commands);
  double timedMs() const { return timed_ms_; }  // of the last run that had a timed part; wall time as for run()

  // Our submissions are numbered 1, 2, ...; a timeline semaphore counts those that have finished. A submission that the
  // device does not finish within two minutes counts as a lost device.
  Result<uint64_t> submit(VkCommandBuffer commands);
  Result<void> wait(uint64_t submission);
  uint64_t submissions() const { return submitted_; }
  // The device reported VK_ERROR_DEVICE_LOST: every later submission fails with it at once.
  bool lost() const { return lost_; }
  // For tests of what follows: so many more submissions succeed, then the device counts as lost.
  void loseDeviceAfter(uint64_t submissions) { submissions_until_lost_ = submissions; }

 private:
  VkContext() = default;
  Result<void> createInstance(const VulkanChoice& choice);
  Result<void> choosePhysicalDevice(const std::string& wanted);
  Result<void> createDevice(const VulkanChoice& choice);
  Result<void> beginRun();
  Result<double> finishRun();
  void readProperties();
  Result<void> createOwnObjects();
  Error failed(const char* call, VkResult result);
  static VKAPI_ATTR VkBool32 VKAPI_CALL onMessage(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                  VkDebugUtilsMessageTypeFlagsEXT type,
                                                  const VkDebugUtilsMessengerCallbackDataEXT* data, void* user);

  bool owns_device_ = true;
  uint64_t memory_bytes_ = 0;
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
  VkSemaphore timeline_ = VK_NULL_HANDLE;
  uint64_t submitted_ = 0;
  bool lost_ = false;
  uint64_t submissions_until_lost_ = UINT64_MAX;
  VkQueryPool queries_ = VK_NULL_HANDLE;  // start and end of a run, start and end of its timed part
  bool timed_ = false;
  double timed_ms_ = 0;
  std::unique_ptr<VkHeap> heap_;
  mutable std::mutex message_mutex_;  // layers may call back from any thread
  std::vector<std::string> messages_;
};

}  // namespace ff::runtime
