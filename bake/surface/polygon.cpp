#include "bake/surface/polygon.h"

#include <algorithm>
#include <utility>

namespace ff::bake {

Point vectorArea(const Polygon& p) {
  Point n{0, 0, 0};
  for (size_t i = 1; i + 1 < p.size(); ++i) {
    const Point c = cross(p[i] - p[0], p[i + 1] - p[0]);
    n = {n.x + c.x / 2, n.y + c.y / 2, n.z + c.z / 2};
  }
  return n;
}

Point middle(const Polygon& polygon) {
  Point sum;
  for (const Point& p : polygon) sum = sum + p;
  return sum * (1 / static_cast<double>(polygon.size()));
}

bool clipInside(const Polygon& polygon, Point normal, double margin, Segment& segment) {
  const Point along = segment.b - segment.a;
  double first = 0, last = 1;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Point side = polygon[(i + 1) % polygon.size()] - polygon[i];
    const double l = length(side);
    if (!(l > 0)) continue;
    const Point inward = cross(normal, side) * (1 / l);
    const double at = dot(inward, segment.a - polygon[i]) - margin, step = dot(inward, along);
    if (step > 0) {
      first = std::max(first, -at / step);
    } else if (step < 0) {
      last = std::min(last, -at / step);
    } else if (at < 0) {
      return false;
    }
  }
  if (!(first <= last)) return false;
  segment = {segment.a + along * first, segment.a + along * last};
  return true;
}

double distance(Point p, const Segment& s) {
  const Point ab = s.b - s.a, ap = p - s.a;
  const double l = dot(ab, ab);
  const double t = l > 0 ? std::clamp(dot(ap, ab) / l, 0.0, 1.0) : 0;
  return length(ap - ab * t);
}

double distance(const Segment& s, const Segment& t) {
  const Point u = s.b - s.a, v = t.b - t.a, n = cross(u, v);
  const auto parted = [&](const Segment& of, Point along, Point p, Point q) {  // p and q on different sides of `of`
    return dot(cross(along, p - of.a), n) * dot(cross(along, q - of.a), n) < 0;
  };
  if (dot(n, n) > 0 && parted(s, u, t.a, t.b) && parted(t, v, s.a, s.b)) return 0;
  return std::min({distance(s.a, t), distance(s.b, t), distance(t.a, s), distance(t.b, s)});
}

namespace {

// Whether the boxes around two polygons are farther apart than the tolerance: most pairs, at once.
bool areApart(const Polygon& p, const Polygon& q, double tolerance) {
  for (int a = 0; a < 3; ++a) {
    const auto range = [a](const Polygon& polygon) {
      double least = 1e300, most = -1e300;
      for (const Point& corner : polygon) {
        least = std::min(least, corner[a]);
        most = std::max(most, corner[a]);
      }
      return std::pair(least - 1e-9, most + 1e-9);  // rounding must not part what touches
    };
    const auto [p_least, p_most] = range(p);
    const auto [q_least, q_most] = range(q);
    if (q_least - p_most > tolerance || p_least - q_most > tolerance) return true;
  }
  return false;
}

}  // namespace

std::vector<SharedBorder> sharedBorders(const Polygon& p, const Polygon& q, double tolerance) {
  std::vector<SharedBorder> shared;
  if (areApart(p, q, tolerance)) return shared;
  for (size_t i = 0; i < p.size(); ++i) {
    const Point a = p[i], side = p[(i + 1) % p.size()] - a;
    const double l = length(side);
    if (!(l > 0)) continue;
    const Point along = side * (1 / l);
    for (size_t k = 0; k < q.size(); ++k) {
      const Point c = q[k], d = q[(k + 1) % q.size()];
      const double from = dot(c - a, along), to = dot(d - a, along);
      const double first = std::max(0.0, std::min(from, to)), last = std::min(l, std::max(from, to));
      if (!(last - first > std::min(tolerance, 0.5 * std::min(l, std::abs(to - from))))) continue;
      const Segment line{a + along * first, a + along * last};
      // The other's line is straight too: near at both ends, near all along.
      const auto near = [&](Point at, double x) {
        const double t = (x - from) / (to - from);
        return length(c + (d - c) * t - at) <= tolerance;
      };
      if (near(line.a, first) && near(line.b, last)) shared.push_back({i, k, line});
    }
  }
  return shared;
}

bool contains(const Polygon& polygon, Point point, double tolerance) {
  const Point area = vectorArea(polygon);
  if (std::abs(dot(area, point - polygon[0])) > tolerance * length(area)) return false;
  for (size_t i = 0; i < polygon.size(); ++i)
    if (dot(cross(area, polygon[(i + 1) % polygon.size()] - polygon[i]), point - polygon[i]) < 0) return false;
  return true;
}

bool touches(const Polygon& p, const Polygon& q, double tolerance) {
  if (areApart(p, q, tolerance)) return false;
  const auto on = [&](const Polygon& corners, const Polygon& border) {
    for (const Point& v : corners)
      for (size_t i = 0; i < border.size(); ++i)
        if (distance(v, Segment{border[i], border[(i + 1) % border.size()]}) < tolerance) return true;
    return false;
  };
  return on(p, q) || on(q, p);
}

}  // namespace ff::bake
