// The baselines on Vulkan (cpu_seed.h has their equations and our reading of them). Never the default.
#pragma once
#include <memory>

#include "runtime/dense/bounce_matrix.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/vulkan/context.h"

namespace ff::runtime {

// The paper's eight shaders, a patch at a time: six to update, one to delete, one to relight. Every call waits for the
// device; stats() has its times, without the copies to and fro. Errors: kUsage where 8 bytes times places^2 exceed what
// the device can bind (any device: 4096 places); kOutOfDeviceMemory.
Result<std::unique_ptr<BounceMatrix>> makeVulkanSeed(std::shared_ptr<VkContext> context,
                                                     const MultibounceSettings& settings);

// Plain local radiosity: so many products with the form factors alone, one channel, all colours in one pass.
Result<std::unique_ptr<BounceMatrix>> makeVulkanPlainLocal(std::shared_ptr<VkContext> context,
                                                           const MultibounceSettings& settings,
                                                           int bounces = kPlainBounces);

}  // namespace ff::runtime
