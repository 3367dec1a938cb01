#include "bake/surface/polygon.h"

#include <algorithm>
#include <utility>

namespace ff::bake {

Point vectorArea(PolygonView p) {
  Point n{0, 0, 0};
  for (size_t i = 1; i + 1 < p.size(); ++i) {
    const Point c = cross(p[i] - p[0], p[i + 1] - p[0]);
    n = {n.x + c.x / 2, n.y + c.y / 2, n.z + c.z / 2};
  }
  return n;
}

Point middle(PolygonView polygon) {
  Point sum;
  for (const Point& p : polygon) sum = sum + p;
  return sum * (1 / static_cast<double>(polygon.size()));
}

Extent extentOf(std::span<const Point> corners) {
  Extent e{corners[0], corners[0]};
  for (int a = 0; a < 3; ++a) {
    for (const Point& corner : corners) {
      e.lo[a] = std::min(e.lo[a], corner[a]);
      e.hi[a] = std::max(e.hi[a], corner[a]);
    }
    e.lo[a] -= 1e-9;
    e.hi[a] += 1e-9;
  }
  return e;
}

bool areApart(const Extent& a, const Extent& b, double tolerance) {
  for (int i = 0; i < 3; ++i)
    if (a.lo[i] - b.hi[i] > tolerance || b.lo[i] - a.hi[i] > tolerance) return true;
  return false;
}

bool clipInside(PolygonView polygon, Point normal, double margin, Segment& segment) {
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

std::vector<SharedBorder> sharedBorders(PolygonView p, PolygonView q, double tolerance) {
  std::vector<SharedBorder> shared;
  if (areApart(extentOf(p), extentOf(q), tolerance)) return shared;
  for (size_t i = 0; i < p.size(); ++i) shareBorder(p, i, q, tolerance, shared);
  return shared;
}

void shareBorder(PolygonView p, size_t side_p, PolygonView q, double tolerance, std::vector<SharedBorder>& shared) {
  const Point a = p[side_p], side = p[(side_p + 1) % p.size()] - a;
  const double l = length(side);
  if (!(l > 0)) return;
  const Point along = side * (1 / l);
  for (size_t k = 0; k < q.size(); ++k) {
    const Point c = q[k], d = q[(k + 1) % q.size()];
    const double from = dot(c - a, along), to = dot(d - a, along);
    const double first = std::max(0.0, std::min(from, to)), last = std::min(l, std::max(from, to));
    if (!(last - first > std::min(tolerance, 0.5 * std::min(l, std::abs(to - from))))) continue;
    if (std::abs(to - from) < 0.5 * length(d - c)) continue;  // one that is shorter than the tolerance is near to what it ends on
    const Segment line{a + along * first, a + along * last};
    // The other's line is straight too: near at both ends, near all along.
    const auto near = [&](Point at, double x) {
      const double t = (x - from) / (to - from);
      return length(c + (d - c) * t - at) <= tolerance;
    };
    if (near(line.a, first) && near(line.b, last)) shared.push_back({side_p, k, line});
  }
}

bool contains(PolygonView polygon, Point point, double tolerance) {
  const Point area = vectorArea(polygon);
  if (std::abs(dot(area, point - polygon[0])) > tolerance * length(area)) return false;
  for (size_t i = 0; i < polygon.size(); ++i)
    if (dot(cross(area, polygon[(i + 1) % polygon.size()] - polygon[i]), point - polygon[i]) < 0) return false;
  return true;
}

bool touches(PolygonView p, PolygonView q, double tolerance) {
  const Extent around_p = extentOf(p), around_q = extentOf(q);
  if (areApart(around_p, around_q, tolerance)) return false;
  const auto on = [&](PolygonView corners, PolygonView border, const Extent& around) {
    for (const Point& v : corners) {
      if (areApart({v, v}, around, tolerance)) continue;
      for (size_t i = 0; i < border.size(); ++i)
        if (distance(v, Segment{border[i], border[(i + 1) % border.size()]}) < tolerance) return true;
    }
    return false;
  };
  return on(p, q, around_q) || on(q, p, around_p);
}

}  // namespace ff::bake
