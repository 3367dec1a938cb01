#include "bake/rays/triangle_block.h"

#include <limits>

#include "bake/wide.h"

namespace ff::bake {
namespace {

// Let u = 2^-24, e the cosine to the normal, p the triangle's largest coordinate, o the origin's. A distance along the ray of at most
// sqrt(3) (o + p) errs by 4 u / e of itself for e's errors and by 3 u for its own; 4 sqrt(3) u o / e and sqrt(3) u p / e come from the
// distance to the plane. As e is above 64 u (level, in mayMeet), 7 % more covers its own error: together 1.22e-6 o / e + 0.89e-6 p / e.
// Under a surface's offset, 3e-6, so that the triangle that a ray starts on is told apart.
constexpr float kErrorOfTriangle = 1e-6f, kErrorOfOrigin = 1.3e-6f;
// The point errs by 1.25 of that, its products with a plane's three numbers by 0.6, one minus two weights by 0.6 and 0.83 more.
constexpr double kErrorOfWeight = 4;
constexpr double kSliver = 1e6;  // longest side squared over area, where single precision says nothing

void put(TriangleBlock::Plane& plane, size_t i, const Point& across, double at) {
  plane.x[i] = static_cast<float>(across.x);
  plane.y[i] = static_cast<float>(across.y);
  plane.z[i] = static_cast<float>(across.z);
  plane.at[i] = static_cast<float>(at);
}

}  // namespace

void TriangleBlock::set(size_t i, uint32_t number, const Corners& corners) {
  triangle[i] = number;
  const Point p = pointOf(corners[0]), s = pointOf(corners[1]) - p, t = pointOf(corners[2]) - p, n = cross(s, t);
  const double square = dot(n, n);
  const Point unit = n / std::sqrt(square), to_b = cross(t, n) / square, to_c = cross(n, s) / square;
  put(distance, i, unit, -dot(unit, p));
  put(b, i, to_b, -dot(to_b, p));
  put(c, i, to_c, -dot(to_c, p));
  float largest = 0;
  for (const Vec3& v : corners) largest = std::max({largest, std::abs(v.x), std::abs(v.y), std::abs(v.z)});
  const Point to_a = to_b + to_c;
  error[i] = kErrorOfTriangle * largest;
  weight_error[i] = static_cast<float>(kErrorOfWeight * std::sqrt(std::max({dot(to_a, to_a), dot(to_b, to_b), dot(to_c, to_c)})));
  if (!(std::max({dot(s, s), dot(t, t), dot(t - s, t - s)}) < kSliver * std::sqrt(square))) error[i] = weight_error[i] = kInfinity;
}

void TriangleBlock::clear(size_t i) {
  triangle[i] = kNone;
  for (Plane* plane : {&distance, &b, &c}) put(*plane, i, {1, 1, 1}, 0);
  error[i] = 1;
  weight_error[i] = -kInfinity;  // never met
}

BlockRay::BlockRay(const Ray& ray)
    : origin{_mm_set1_ps(ray.origin.x), _mm_set1_ps(ray.origin.y), _mm_set1_ps(ray.origin.z)},
      direction{_mm_set1_ps(ray.direction.x), _mm_set1_ps(ray.direction.y), _mm_set1_ps(ray.direction.z)},
      error(_mm_set1_ps(originError(ray.origin))) {}

namespace {

struct TryAll {
  [[gnu::always_inline]] static uint32_t run(const TriangleBlock* block, const RayPacket* packet, uint32_t* may_meet) {
    const RayPacket& rays = *packet;
    alignas(64) uint32_t may[RayPacket::kRays] = {};
    for (size_t i = 0; i < TriangleBlock::kTriangles; ++i) {
      const auto along = [i](const TriangleBlock::Plane& p, float x, float y, float z) { return p.x[i] * x + p.y[i] * y + p.z[i] * z; };
      for (size_t k = 0; k < RayPacket::kRays; ++k) {
        const float x = rays.x[k], y = rays.y[k], z = rays.z[k], dx = rays.along_x[k], dy = rays.along_y[k], dz = rays.along_z[k];
        const float steep = along(block->distance, dx, dy, dz), slow = 1 / steep;
        const float t = -(along(block->distance, x, y, z) + block->distance.at[i]) * slow;
        const float error = (block->error[i] + rays.error[k]) * std::abs(slow), outside = -error * block->weight_error[i];
        const float at_x = x + dx * t, at_y = y + dy * t, at_z = z + dz * t;
        const float b = along(block->b, at_x, at_y, at_z) + block->b.at[i], c = along(block->c, at_x, at_y, at_z) + block->c.at[i], a = 1 - b - c;
        const uint32_t apart = uint32_t{t + error < rays.from_m[k]} | uint32_t{t - error > rays.to_m[k]};
        const uint32_t beside = uint32_t{a < outside} | uint32_t{b < outside} | uint32_t{c < outside};
        may[k] |= (1 - ((apart | beside) & uint32_t{std::abs(steep) > kLevel})) << i;
      }
    }
    uint32_t any = 0;
    for (size_t k = 0; k < RayPacket::kRays; ++k) {
      may_meet[k] = may[k] & static_cast<uint32_t>(rays.valid[k]);
      any |= may_meet[k] != 0 ? 1u << k : 0u;
    }
    return any;
  }
};

}  // namespace

uint32_t mayMeet(const TriangleBlock& block, const RayPacket& rays, uint32_t (&may_meet)[RayPacket::kRays]) {
  return onWidest<TryAll>(&block, &rays, &may_meet[0]);
}

float originError(Vec3 origin) { return kErrorOfOrigin * std::max({std::abs(origin.x), std::abs(origin.y), std::abs(origin.z)}); }

}  // namespace ff::bake
