// Numbers, points and directions that the path tracer draws.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "formats/vec3.h"

namespace ff::chart {

// Vigna. An experimental exploration of Marsaglia's xorshift generators, scrambled. 2016 (splitmix64).
class Random {
 public:
  explicit Random(uint64_t seed) : state_(seed) {}
  uint64_t bits() {
    uint64_t z = state_ += 0x9e3779b97f4a7c15ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
  }
  float unit() { return static_cast<float>(bits() >> 40) * 0x1p-24f; }

 private:
  uint64_t state_;
};

// Points that fill the unit cube in four dimensions evenly, shifted at random. Roberts. The Unreasonable Effectiveness
// of Quasirandom Sequences. 2018; Cranley, Patterson. Randomization of Number Theoretic Methods. 1976.
struct EvenPoints {
  std::array<double, 4> shift;
  explicit EvenPoints(Random& random) {
    for (double& s : shift) s = static_cast<double>(random.bits() >> 11) * 0x1p-53;
  }
  std::array<float, 4> point(uint32_t i) const {
    constexpr double g = 1.1673039782614187;  // root of g^5 = g + 1
    constexpr double step[4] = {1 / g, 1 / (g * g), 1 / (g * g * g), 1 / (g * g * g * g)};
    std::array<float, 4> p{};
    for (size_t d = 0; d < 4; ++d) {
      const double x = shift[d] + step[d] * (i + 1);
      p[d] = std::min(static_cast<float>(x - std::floor(x)), 0x1.fffffep-1f);
    }
    return p;
  }
};

// Malley's way: the unit disc lifted to the hemisphere.
inline Vec3 cosineDirection(Vec3 normal, float u, float v) {
  const Vec3 other = std::abs(normal.x) > 0.7f ? Vec3{0, 1, 0} : Vec3{1, 0, 0};
  const Vec3 t = normalized(cross(normal, other)), b = cross(normal, t);
  const float r = std::sqrt(u), angle = 2 * std::numbers::pi_v<float> * v;
  return t * (r * std::cos(angle)) + b * (r * std::sin(angle)) + normal * std::sqrt(std::max(0.0f, 1 - u));
}

// The i-th of `count` directions that cover the sphere evenly. Gonzalez. Measurement of Areas on a Sphere Using Fibonacci
// and Latitude-Longitude Lattices. 2010.
inline Vec3 sphereDirection(uint32_t i, uint32_t count) {
  const double y = 1 - (2.0 * i + 1) / count, turn = i * 0.6180339887498949;
  const double r = std::sqrt(1 - y * y), angle = 2 * std::numbers::pi * (turn - std::floor(turn));
  return {static_cast<float>(r * std::cos(angle)), static_cast<float>(y), static_cast<float>(r * std::sin(angle))};
}

}  // namespace ff::chart
