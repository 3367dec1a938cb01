// The gather solver on Vulkan: sparse Jacobi iterations, one row per subgroup. No vulkan.h is needed to use it.
#pragma once
#include <cstdint>
#include <memory>

#include "runtime/solver.h"
#include "runtime/vk_context.h"

namespace ff::runtime {

struct VulkanGatherSettings {
  // Entries are bound in ranges of at most so many bytes; 0: the device's maxStorageBufferRange (128 MiB on lavapipe).
  uint64_t max_binding_bytes = 0;
};

// Every call waits for the device. The context lives as long as the solver. Errors: shaders refused, out of memory.
Result<std::unique_ptr<Solver>> makeVulkanGather(std::shared_ptr<VkContext> context,
                                                 const VulkanGatherSettings& settings = {});

}  // namespace ff::runtime
