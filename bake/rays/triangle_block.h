// Four triangles side by side, and which of them a ray may meet: in single precision, a quick test before that of triangle_hit.h.
// What it lets through depends on nothing that differs between processors, and it never stops what meet() would meet.
#pragma once
#include <xmmintrin.h>

#include <limits>

#include "bake/scene.h"
#include "bake/rays/triangle_hit.h"

namespace ff::bake {

inline constexpr float kInfinity = std::numeric_limits<float>::infinity();
inline constexpr float kLevel = 0x1p-18f;  // cosine to a triangle's normal, below which a ray counts as in its plane

struct alignas(16) TriangleBlock {
  static constexpr size_t kTriangles = 4;
  struct Plane {  // x * point.x + y * point.y + z * point.z + at
    float x[kTriangles], y[kTriangles], z[kTriangles], at[kTriangles];
  };

  Plane distance;      // from the triangle's plane, m
  Plane b, c;          // weights of the second and third corner
  float error[kTriangles];         // of the distance, m: the triangle's part
  float weight_error[kTriangles];  // of the weights, over that of the distance along the ray, 1/m
  uint32_t triangle[kTriangles];   // of the scene, or kNone

  void set(size_t place, uint32_t number, const Corners& corners);
  void clear(size_t place);
};

// A ray as blocks are tried against it.
struct BlockRay {
  struct Fours {
    __m128 x, y, z;
  };
  Fours origin, direction;
  __m128 error;  // of the distance from a plane, m: the origin's part

  explicit BlockRay(const Ray& ray);
};

// Bit i: triangle i may be met beyond from_m and no farther than to_m.
inline unsigned mayMeet(const TriangleBlock& block, const BlockRay& ray, float from_m, float to_m) {
  const __m128 sign = _mm_set1_ps(-0.0f), one = _mm_set1_ps(1), level = _mm_set1_ps(kLevel);
  const auto along = [](const TriangleBlock::Plane& p, const BlockRay::Fours& v) {
    return _mm_load_ps(p.x) * v.x + _mm_load_ps(p.y) * v.y + _mm_load_ps(p.z) * v.z;
  };
  const __m128 steep = along(block.distance, ray.direction), slow = one / steep;
  const __m128 t = -(along(block.distance, ray.origin) + _mm_load_ps(block.distance.at)) * slow;
  const __m128 error = (_mm_load_ps(block.error) + ray.error) * _mm_andnot_ps(sign, slow);
  const BlockRay::Fours at{ray.origin.x + ray.direction.x * t, ray.origin.y + ray.direction.y * t, ray.origin.z + ray.direction.z * t};
  const __m128 b = along(block.b, at) + _mm_load_ps(block.b.at), c = along(block.c, at) + _mm_load_ps(block.c.at);
  const __m128 least = _mm_min_ps(_mm_min_ps(b, c), one - b - c);
  // Comparisons with what is no number are false: nothing is known then.
  const __m128 apart = _mm_or_ps(_mm_cmplt_ps(t + error, _mm_set1_ps(from_m)), _mm_cmpgt_ps(t - error, _mm_set1_ps(to_m)));
  const __m128 beside = _mm_cmplt_ps(least + error * _mm_load_ps(block.weight_error), _mm_setzero_ps());
  const __m128 missed = _mm_and_ps(_mm_or_ps(apart, beside), _mm_cmpgt_ps(_mm_andnot_ps(sign, steep), level));
  return ~static_cast<unsigned>(_mm_movemask_ps(missed)) & 15u;
}

// Of the distance of an origin from a plane, m.
float originError(Vec3 origin);

// Rays side by side.
struct RayPacket {
  static constexpr size_t kRays = 16;
  const float *x, *y, *z, *along_x, *along_y, *along_z;
  const float *from_m, *to_m;
  const float* error;  // originError()
  const int* valid;    // -1: there is such a ray; 0: there is none
};

// The same test of all of them, on registers as wide as the processor has. Returns a bit for each ray that may meet a triangle; may_meet[k] has those of ray k.
uint32_t mayMeet(const TriangleBlock& block, const RayPacket& rays, uint32_t (&may_meet)[RayPacket::kRays]);

}  // namespace ff::bake
