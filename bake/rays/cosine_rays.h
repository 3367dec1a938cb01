// Where rays start on a triangle and where they go: uniformly over its area, cosine-distributed over its hemisphere.
#pragma once
#include <cmath>

#include "formats/portable_math.h"
#include "formats/vec3.h"

namespace ff::bake {

struct Frame {
  Vec3 normal, tangent, bitangent;
};

// Tom Duff et al. Building an orthonormal basis, revisited. Journal of Computer Graphics Techniques 6(1), 2017.
inline Frame frameOf(Vec3 n) {
  const float sign = std::copysign(1.0f, n.z), a = -1.0f / (sign + n.z), c = n.x * n.y * a;
  return {n, {1.0f + sign * n.x * n.x * a, sign * c, -sign * n.x}, {c, sign + n.y * n.y * a, -n.y}};
}

// u, v in [0, 1). Greg Turk. Generating random points in triangles. Graphics Gems, 1990.
inline Vec3 pointInTriangle(Vec3 a, Vec3 b, Vec3 c, float u, float v) {
  const float r = std::sqrt(u);
  return a * (1 - r) + b * (r * (1 - v)) + c * (r * v);
}

// What a cosine-distributed direction has of the axes of a frame; u, v in [0, 1). For loops of it, too.
struct AlongAxes {
  float tangent, bitangent, normal;
};
[[gnu::always_inline]] inline AlongAxes cosineAlongAxes(float u, float v) {
  const float r = std::sqrt(u);
  const auto [sine, cosine] = sineCosineOfTurn(static_cast<double>(v));
  return {r * static_cast<float>(cosine), r * static_cast<float>(sine), std::sqrt(1 - u)};
}

// Unit.
inline Vec3 directionIn(const Frame& frame, const AlongAxes& along) {
  return frame.tangent * along.tangent + frame.bitangent * along.bitangent + frame.normal * along.normal;
}
inline Vec3 cosineDirection(const Frame& frame, float u, float v) { return directionIn(frame, cosineAlongAxes(u, v)); }

}  // namespace ff::bake
