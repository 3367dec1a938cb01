// Convex polygons in space, in units of cells: cut by planes, clipped, compared border to border.
#pragma once
#include <span>
#include <vector>

#include "bake/point.h"

namespace ff::bake {

using Polygon = std::vector<Point>;  // convex, counter-clockwise seen from the front
using PolygonView = std::span<const Point>;
struct Segment {
  Point a, b;
};
struct Extent {  // a box
  Point lo, hi;
};

Point vectorArea(PolygonView polygon);  // along the normal, as long as the area
Point middle(PolygonView polygon);      // of the corners: a point inside
Extent extentOf(std::span<const Point> corners);  // wider by 1e-9, so that rounding does not part what touches
bool areApart(const Extent& a, const Extent& b, double tolerance);  // by more than the tolerance

// Cuts a polygon by a plane that corners are `distance` from. Those within eps belong to both parts. crossing(lo, hi): where the
// side from below to above meets the plane; in this order always, so that two triangles cut their common side at the same point.
template <class Distance, class Crossing>
void split(PolygonView polygon, Distance distance, Crossing crossing, double eps, Polygon& below, Polygon& above) {
  below.clear();
  above.clear();
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Point& p = polygon[i];
    const Point& q = polygon[(i + 1) % polygon.size()];
    const double dp = distance(p), dq = distance(q);
    if (dp <= eps) below.push_back(p);
    if (dp >= -eps) above.push_back(p);
    if ((dp < -eps && dq > eps) || (dp > eps && dq < -eps)) {
      const Point c = dp < dq ? crossing(p, q) : crossing(q, p);
      below.push_back(c);
      above.push_back(c);
    }
  }
}

// Shortens a segment in the plane of the polygon, whose unit normal is given, to what lies at least `margin` inside of the border;
// false where nothing does.
bool clipInside(PolygonView polygon, Point normal, double margin, Segment& segment);

double distance(Point p, const Segment& s);
double distance(const Segment& s, const Segment& t);  // of segments in one plane: 0 where they cross

// Where a side of one polygon and a side of another lie within `tolerance` of each other, over more than `tolerance` or half the
// shorter one, and run the same way within 60 degrees.
struct SharedBorder {
  size_t side_p, side_q;  // from corner side_p to the next one
  Segment line;
};
std::vector<SharedBorder> sharedBorders(PolygonView p, PolygonView q, double tolerance);
// The same of one side of p; what is found is appended.
void shareBorder(PolygonView p, size_t side_p, PolygonView q, double tolerance, std::vector<SharedBorder>& shared);

// Whether a point less than `tolerance` off the plane of a polygon lies in it.
bool contains(PolygonView polygon, Point point, double tolerance);

// Whether a corner of one lies on the border of the other.
bool touches(PolygonView p, PolygonView q, double tolerance);

}  // namespace ff::bake
