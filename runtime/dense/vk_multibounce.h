// The multi-bounce matrix on Vulkan: the same exact block updates as the CPU's (bounce_matrix.h), a plane a channel, in
// fp32 or in fp16 packed two to a word (no 16-bit storage feature is needed). No vulkan.h is needed to use it.
//
// An update of G by a block is one product tall * wide (both of k vectors), for either direction:
//   entering: U = F_LP + G C F_LP, V = F_PL + F_PL C G, S = F_PP + F_PL C U, K = (I - S C_P)^-1. The block's rows become
//     K [V S]; the other rows change by U (C_P K [V S] + [0 I]). (In the block's columns that is U (I - C_P S)^-1.)
//   leaving: the other rows change by G_LP times -C_P (I + G_PP C_P)^-1 G_PL, in the block's columns by -G_LP.
// relight() is exact while the product is only folded into some of the columns: the rest is applied through the factors.
#pragma once
#include <memory>

#include "runtime/dense/bounce_matrix.h"
#include "runtime/vulkan/context.h"

namespace ff::runtime {

// Every call waits for the device; stats() has the device's own times, without the copies of light to and fro.
// MultibounceSettings::threads is not used. Albedos above 1 - 1/4096 are lowered to it and counted.
// Errors: kUsage where a plane exceeds what the device can bind; kOutOfDeviceMemory.
Result<std::unique_ptr<BounceMatrix>> makeVulkanMultibounce(std::shared_ptr<VkContext> context,
                                                            const MultibounceSettings& settings);

}  // namespace ff::runtime
