#include "bake/rays/triangle_block.h"

#include <limits>

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
      error(_mm_set1_ps(kErrorOfOrigin * std::max({std::abs(ray.origin.x), std::abs(ray.origin.y), std::abs(ray.origin.z)}))) {}

}  // namespace ff::bake
