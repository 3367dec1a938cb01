// The version of what the baker makes.
#pragma once
#include <cstdint>

namespace ff::bake {

// Raised whenever the same scene and settings come to give other bytes.
inline constexpr uint32_t kBakeCode = 29;

}  // namespace ff::bake
