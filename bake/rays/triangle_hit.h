// Where a ray meets a triangle: the same answer, to the bit, on every processor. All operations are plain IEEE ones in double precision and
// a fixed order (our code is built with -ffp-contract=off).
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "bake/point.h"

namespace ff::bake {

struct Ray {
  Vec3 origin, direction;  // m; unit
};

using Corners = std::array<Vec3, 3>;  // m

struct TriangleHit {
  double distance_m;
  float b, c;  // weights of the second and third corner
};

inline double largestOf(const Point& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }

// How far outside a triangle's bounding box it may be met, as a share of the largest coordinate of the triangle and of the ray's origin.
inline constexpr double kOutsideBox = 0x1p-33;

// Beyond from_m. A ray through an edge or corner that triangles share meets one of them at least: the signs of the volumes between a ray
// and an edge, given in either direction, are exactly opposite.
inline std::optional<TriangleHit> meet(const Ray& ray, const Corners& corners, double from_m) {
  const Point origin = pointOf(ray.origin), d = pointOf(ray.direction), p = pointOf(corners[0]), q = pointOf(corners[1]), r = pointOf(corners[2]);
  const Point u = p - origin, v = q - origin, w = r - origin;
  const double a = dot(d, cross(v + w, r - q)), b = dot(d, cross(w + u, p - r)), c = dot(d, cross(u + v, q - p)), all = a + b + c;
  if (!((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) || all == 0) return {};
  // Where the ray passes is a mean of the corners, so that the distance is one of theirs as well.
  double t = (a * dot(u, d) + b * dot(v, d) + c * dot(w, d)) / (all * dot(d, d));
  if (!(t > from_m)) return {};

  // To a ray in the triangle's plane the volumes are rounding errors: what is met is held in the box, where a tree of boxes finds it.
  const Point lo{std::min({u.x, v.x, w.x}), std::min({u.y, v.y, w.y}), std::min({u.z, v.z, w.z})};
  const Point hi{std::max({u.x, v.x, w.x}), std::max({u.y, v.y, w.y}), std::max({u.z, v.z, w.z})};
  const double margin = kOutsideBox / 4 * std::max({largestOf(lo), largestOf(hi), largestOf(origin)});
  const auto within = [&](double at, double from, double to) { return at >= from - margin && at <= to + margin; };
  if (!(within(t * d.x, lo.x, hi.x) && within(t * d.y, lo.y, hi.y) && within(t * d.z, lo.z, hi.z))) {
    double enter = -1e300, leave = 1e300;
    const auto crosses = [&](double from, double to, double along) {
      if (along == 0) return within(0, from, to);
      const double x = (from - margin) / along, y = (to + margin) / along;
      enter = std::max(enter, std::min(x, y));
      leave = std::min(leave, std::max(x, y));
      return enter <= leave;
    };
    if (!(crosses(lo.x, hi.x, d.x) && crosses(lo.y, hi.y, d.y) && crosses(lo.z, hi.z, d.z))) return {};
    t = std::clamp(t, enter, leave);
  }
  return TriangleHit{t, static_cast<float>(b / all), static_cast<float>(c / all)};
}

}  // namespace ff::bake
