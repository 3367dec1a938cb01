// All bounces in a recorded step: the correction by a dense matrix (dense_solver.h), every part of it on the device.
// With B' = M + C F B, what the sparse rows give, and r = B' - B:  B <- B' + C G r  at the leaves that have places.
// That is C times that file's E <- E + r + G C r.
//
// The host does not wait to learn whether a block was refused: it goes on as if it had entered. Its rows and columns of
// G are zero then, and later blocks that name its places make G that of a matrix F with some entries left out: still a
// regular splitting, so what is shown stays right and converges. frames_in_flight records later the host reads of it
// and takes those places back. Where nodes could not leave, or the product is not finite, the device itself stops using
// the matrix (shaders/bounce.glsl: corrupt) until the host has it built anew.
//
// The residual probe (bounce_monitor.h) runs all the while: y = G x on the device, at the end of a record; what the sparse
// rows say of it on the host, frames_in_flight records later, if no node has left until then. One is on its way at a time.
#pragma once
#include "runtime/gather/gather_correction.h"

namespace ff::runtime {

// Blocks that enter a frame: at most `blocks`, and what fits into one staging region, which has room for the largest
// block there may be; other leaves wait. Leaves that leave do so at once; where most of them leave, the matrix starts
// anew. Errors: as makeVulkanMultibounce. MultibounceSettings::time_slice is not used.
Result<std::unique_ptr<GatherCorrection>> makeVulkanDenseStep(std::shared_ptr<VkContext> context,
                                                              const MultibounceSettings& settings,
                                                              uint32_t blocks = kRebuildBlocks);

}  // namespace ff::runtime
