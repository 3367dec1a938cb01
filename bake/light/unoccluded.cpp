#include "bake/light/unoccluded.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>

#include "formats/portable_math.h"

namespace ff::bake {
namespace {

using Facet = PatchShape::Facet;

// From here on points of either patch stand for it, and one a facet: how far apart the middles are, by the sum of both radii.
constexpr double kPoints = 1.4, kMiddles = 6;
constexpr double kThin = 0.1;     // of the smaller radius: a gap between facets, in which points are too few
constexpr size_t kMostNear = 16, kMostFar = 64;  // facets of one times those of the other

// A point of a facet, by the weights of its corners, and the share of the area that it stands for.
struct QuadraturePoint {
  double a, b, c, share;
};
constexpr QuadraturePoint kOnePoint[] = {{1.0 / 3, 1.0 / 3, 1.0 / 3, 1}};
constexpr QuadraturePoint kThreePoints[] = {{2.0 / 3, 1.0 / 6, 1.0 / 6, 1.0 / 3}, {1.0 / 6, 2.0 / 3, 1.0 / 6, 1.0 / 3}, {1.0 / 6, 1.0 / 6, 2.0 / 3, 1.0 / 3}};
// Of degree 5. Gilbert Strang, George Fix. An Analysis of the Finite Element Method. 1973.
constexpr double kA = 0.059715871789770, kB = 0.470142064105115, kC = 0.797426985353087, kD = 0.101286507323456;
constexpr double kInner = 0.132394152788506, kOuter = 0.125939180544827;
constexpr QuadraturePoint kSevenPoints[] = {{1.0 / 3, 1.0 / 3, 1.0 / 3, 0.225}, {kA, kB, kB, kInner}, {kB, kA, kB, kInner}, {kB, kB, kA, kInner},
                                            {kC, kD, kD, kOuter}, {kD, kC, kD, kOuter}, {kD, kD, kC, kOuter}};

// f(point, area that it stands for) for all points of a facet, triangle by triangle.
template <class F>
void eachPoint(const Facet& facet, std::span<const QuadraturePoint> points, F f) {
  const Point& a = facet.corner[0];
  for (size_t i = 2; i < facet.corners; ++i) {
    const Point &b = facet.corner[i - 1], &c = facet.corner[i];
    const double area = facet.corners == 3 ? facet.area_m2 : length(cross(b - a, c - a)) / 2;
    for (const QuadraturePoint& p : points) f(a * p.a + b * p.b + c * p.c, p.share * area);
  }
}

// The share of a hemisphere that the front of a facet covers, nothing in between.
double covered(const Point& from, const Point& normal, const Facet& facet) {
  if (dot(facet.normal, facet.corner[0] - from) >= 0) return 0;
  std::array<Point, PatchShape::kMostCorners + 2> above;
  size_t corners = 0;
  for (size_t i = 0; i < facet.corners; ++i) {
    const Point p = facet.corner[i] - from, q = facet.corner[i + 1 < facet.corners ? i + 1 : 0] - from;
    const double height_p = dot(p, normal), height_q = dot(q, normal);
    if (height_p >= 0) above[corners++] = p;
    if ((height_p > 0 && height_q < 0) || (height_p < 0 && height_q > 0)) above[corners++] = p + (q - p) * (height_p / (height_p - height_q));
  }
  double sum = 0;
  for (size_t i = 0; i < corners; ++i) {
    const Point &p = above[i], &q = above[i + 1 < corners ? i + 1 : 0], across = cross(p, q);
    const double sine = length(across);
    if (sine > 0) sum -= arcTangent(sine, dot(p, q)) * dot(across, normal) / sine;
  }
  return std::max(0.0, sum / (2 * std::numbers::pi));
}

double fromPoints(const PatchShape& a, const PatchShape& b) {
  const auto points = a.facets.size() <= 4 ? std::span<const QuadraturePoint>(kSevenPoints) : std::span<const QuadraturePoint>(kThreePoints);
  double sum = 0;
  for (const Facet& f : a.facets)
    eachPoint(f, points, [&](const Point& from, double area_m2) {
      for (const Facet& g : b.facets) sum += covered(from, f.normal, g) * area_m2;
    });
  return sum;
}

// Whether points of one tell badly of the other: where they cross, and in thin gaps.
bool isHard(const Facet& f, const Facet& g, double thin_m) {
  const auto heights = [](const Facet& over, const Facet& of) {
    double least = 1e300, most = -1e300;
    for (const Point& corner : of.outline()) {
      const double height = dot(corner - over.corner[0], over.normal);
      least = std::min(least, height);
      most = std::max(most, height);
    }
    return std::pair(least, most);
  };
  const auto [f_least, f_most] = heights(g, f);
  const auto [g_least, g_most] = heights(f, g);
  if (f_most <= 0 || g_most <= 0) return false;  // one is behind the other
  const double crumb = 1e-2 * thin_m;
  if (f_least < -crumb && f_most > crumb && g_least < -crumb && g_most > crumb) return true;
  return dot(f.normal, g.normal) < -0.7 && g_most < thin_m;
}

double betweenPoints(const PatchShape& a, std::span<const PatchShape::Sample> from_a, const PatchShape& b, std::span<const PatchShape::Sample> from_b) {
  double sum = 0;
  for (const PatchShape::Sample& from : from_a)
    for (const PatchShape::Sample& to : from_b) {
      const Point r = to.at - from.at;
      const double cosines = std::max(0.0, dot(r, a.facets[from.facet].normal)) * std::max(0.0, -dot(r, b.facets[to.facet].normal)), square = dot(r, r);
      if (cosines > 0) sum += cosines / (square * square) * from.area_m2 * to.area_m2;
    }
  return sum / std::numbers::pi;
}

// Makes a triangle a part of a facet that it goes on from in the same plane, where the whole is convex.
bool join(Facet& facet, const Facet& triangle) {
  constexpr double kFlat = 1e-9;  // squared sine of an angle
  if (facet.corners == PatchShape::kMostCorners || dot(facet.normal, triangle.normal) <= 0) return false;
  const Point bend = cross(facet.normal, triangle.normal);
  if (dot(bend, bend) > kFlat) return false;
  const auto same = [](const Point& p, const Point& q) { return p.x == q.x && p.y == q.y && p.z == q.z; };
  for (size_t i = 0; i < facet.corners; ++i)
    for (size_t k = 0; k < 3; ++k) {
      const size_t next = i + 1 < facet.corners ? i + 1 : 0;
      const Point &p = facet.corner[i], &q = facet.corner[next], &apex = triangle.corner[(k + 2) % 3];
      if (!same(p, triangle.corner[(k + 1) % 3]) || !same(q, triangle.corner[k])) continue;
      const Point &before = facet.corner[i > 0 ? i - 1 : facet.corners - 1], &after = facet.corner[next + 1 < facet.corners ? next + 1 : 0];
      const auto leftTurn = [&](const Point& u, const Point& v) {
        return dot(cross(u, v), facet.normal) >= -kFlat * (dot(u, u) + dot(v, v));
      };
      if (!leftTurn(p - before, apex - p) || !leftTurn(q - apex, after - q)) return false;
      std::copy_backward(facet.corner.begin() + static_cast<ptrdiff_t>(i) + 1, facet.corner.begin() + static_cast<ptrdiff_t>(facet.corners),
                         facet.corner.begin() + static_cast<ptrdiff_t>(facet.corners) + 1);
      facet.corner[i + 1] = apex;
      ++facet.corners;
      facet.area_m2 += triangle.area_m2;
      return true;
    }
  return false;
}

}  // namespace

void PatchShape::assign(const PatchSet& set, uint32_t patch) {
  const Patch& p = set.patches[patch];
  facets.clear();
  centre = pointOf(p.centroid);
  radius_m = area_m2 = 0;
  for (const PatchTriangle& t : std::span(set.triangles).subspan(p.first_triangle, p.triangles)) {
    Facet f;
    f.corner = {pointOf(t.a), pointOf(t.b), pointOf(t.c)};
    f.corners = 3;
    const Point normal = cross(f.corner[1] - f.corner[0], f.corner[2] - f.corner[0]);
    const double twice = length(normal);
    if (!(twice > 0)) continue;
    f.normal = normal / twice;
    f.area_m2 = twice / 2;
    area_m2 += f.area_m2;
    for (const Point& corner : f.outline()) radius_m = std::max(radius_m, length(corner - centre));
    if (facets.empty() || !join(facets.back(), f)) facets.push_back(f);
  }
  middles.clear();
  thirds.clear();
  for (uint32_t f = 0; f < facets.size(); ++f) {
    eachPoint(facets[f], kOnePoint, [&](const Point& at, double of_m2) { middles.push_back({at, of_m2, f}); });
    eachPoint(facets[f], kThreePoints, [&](const Point& at, double of_m2) { thirds.push_back({at, of_m2, f}); });
  }
}

std::optional<double> unoccludedExchange(const PatchShape& a, const PatchShape& b) {
  const double apart = length(a.centre - b.centre), radii = a.radius_m + b.radius_m;
  if (a.facets.size() * b.facets.size() > (apart > kPoints * radii ? kMostFar : kMostNear)) return {};
  if (apart > kMiddles * radii) return betweenPoints(a, a.middles, b, b.middles);
  if (apart > kPoints * radii) return betweenPoints(a, a.thirds, b, b.thirds);
  for (const Facet& f : a.facets)
    for (const Facet& g : b.facets)
      if (isHard(f, g, kThin * std::min(a.radius_m, b.radius_m))) return {};
  return a.area_m2 <= b.area_m2 ? fromPoints(a, b) : fromPoints(b, a);
}

double farExchange(const Patch& a, const Patch& b) {
  const Point r = pointOf(b.centroid) - pointOf(a.centroid);
  const auto area_a = static_cast<double>(a.area_m2), area_b = static_cast<double>(b.area_m2);
  return area_a * area_b / std::max(std::numbers::pi * dot(r, r), std::max(area_a, area_b));
}

}  // namespace ff::bake
