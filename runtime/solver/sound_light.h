// Which numbers are light. What a caller gives is looked at where it comes in, and refused or taken for zero; what a
// solver holds is looked at in every step, so that nothing that is not finite stays or spreads.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>

#include "runtime/cut/local_matrix.h"
#include "shaders/shared.h"

namespace ff::runtime {

// W/m2, of a caller's radiance W/(m2 sr).
inline constexpr float kMaxLight = formats::kMaxEmission;
// A number this far below zero is somebody's rounding (1e-6 of 1000 W/m2) and zero; below it is wrong.
inline constexpr float kRoundingLight = -1e-3f;

// Why a caller's number is no light; null: it is, or is zero but for rounding.
inline const char* whyNoLight(float x) {
  if (!std::isfinite(x)) return "is not finite";
  if (x > kMaxLight) return "is above 1e12 W/m2, past anything physical";
  return x < kRoundingLight ? "is negative" : nullptr;
}
inline const char* whyNoLight(Vec3 v) {
  for (int c = 0; c < 3; ++c)
    if (const char* why = whyNoLight(v[c])) return why;
  return nullptr;
}

// Whether a solver may hold it; false for NaN.
inline bool isSound(float x) { return std::abs(x) <= shaders::kMaxRadiosity; }
inline bool isSound(const Vec4& v) { return isSound(v.x) & isSound(v.y) & isSound(v.z); }

// Copies light, zero where it is not sound and in w; returns how many values were not. The spans may be the same.
inline uint32_t copySound(std::span<const Vec4> from, std::span<Vec4> to) {
  uint32_t unsound = 0;
  for (size_t s = 0; s < from.size(); ++s) {
    const bool sound = isSound(from[s]);
    unsound += !sound;
    to[s] = sound ? Vec4{from[s].x, from[s].y, from[s].z, 0} : Vec4{};
  }
  return unsound;
}

}  // namespace ff::runtime
