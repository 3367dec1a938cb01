// The multi-bounce matrix on the CPU: exact block updates of G = (I - F C)^-1 F (bounce_matrix.h). The mathematics and the
// matrices themselves are in bounce_planes.h; here is which node sits where, and light.
#pragma once
#include <memory>

#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

// A product of albedo and row sum above this is taken to reach 1; the albedo is lowered to it: light is multiplied by
// at most 2048, which fp32 and the scaled fp16 hold.
inline constexpr float kMaxKept = 1 - 1.0f / 2048;

// luminance: one matrix G with the mean albedo. A channel's own G_c obeys G_c = G + G (C_c - C) G_c, so
// E <- G (M + (C_c - C) E) is repeated: this many products, each reading the one matrix once for all channels. With
// colours drawn evenly from 0.2 to 0.8 a channel, 512 patches, the relative L2 error is 3.8e-2 after one
// product, 2.4e-3 after two and 1.4e-4 after three; with colours 0.3 times as strong 1.1e-2, 2.2e-4 and 3.8e-6.
inline constexpr int kLuminanceProducts = 2;

// Errors (kUsage): no places, or too little memory for them.
Result<std::unique_ptr<BounceMatrix>> makeCpuMultibounce(const MultibounceSettings& settings);

}  // namespace ff::runtime
