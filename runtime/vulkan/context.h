// A Vulkan device to run on, without vulkan.h: for callers that only want a Solver. device.h is the inside.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "formats/result.h"

namespace ff::runtime {

struct VulkanChoice {
  std::string device = "auto";  // "auto": discrete, integrated, virtual, CPU in that order; "cpu": a software device
                                // (lavapipe); else part of a device's name, any case
  bool validate = false;        // Khronos layer with synchronisation validation; messages are kept, see below
  bool gpu_assisted = false;    // with validate: also instruments the shaders (slow)
  uint64_t memory_bytes = 0;    // device memory to take at most, past it kOutOfDeviceMemory; 0: the size of the heap
};

// Instance, device and one queue with compute and graphics. Not thread-safe. Lives as long as anything made from it.
// A caller that has a device already uses VkContext::adopt (device.h).
class VkContext;

// Errors (kIo): no driver, no such device (the line lists those that exist), a missing feature, no validation layer.
Result<std::shared_ptr<VkContext>> openVulkan(const VulkanChoice& choice = {});

std::string deviceName(const VkContext& context);
bool isSoftwareDevice(const VkContext& context);  // lavapipe and the like: for tests, no measure of a GPU
// What the device copies between two buffers of so many bytes each, bytes read and written a second: the median of nine
// copies by its own clock. Takes two such buffers for the time of the call.
Result<double> deviceCopyBandwidth(VkContext& context, uint64_t bytes = uint64_t{64} << 20);
// Warnings and errors of the validation layers so far, in order. A correct program has none.
std::vector<std::string> validationMessages(const VkContext& context);

}  // namespace ff::runtime
