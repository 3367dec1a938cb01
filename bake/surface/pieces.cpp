#include "bake/surface/pieces.h"

#include <algorithm>
#include <cmath>

#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"

namespace ff::bake {
namespace {

// Splits `polygon` along `axis` and on along the axes after it. A polygon that lies in a grid plane belongs to the cell
// behind it, so that the faces of a voxel lie in the voxel's own cell.
void clip(PolygonView polygon, int axis, Cell cell, const Point& normal, double eps,
          std::vector<std::pair<Cell, Polygon>>& out) {
  if (axis == 3) {
    out.emplace_back(cell, Polygon(polygon.begin(), polygon.end()));
    return;
  }
  double lo = 1e300, hi = -1e300;
  for (const Point& p : polygon) {
    lo = std::min(lo, p[axis]);
    hi = std::max(hi, p[axis]);
  }
  const double first = std::floor(lo + eps), last = std::ceil(hi - eps) - 1;
  if (last <= first) {
    const double behind = normal[axis] > 0 ? -2 * eps : normal[axis] < 0 ? 2 * eps : 0;
    const bool flat = hi - lo <= 2 * eps;
    cell[axis] = static_cast<int32_t>(flat ? std::floor((lo + hi) / 2 + behind) : std::floor((lo + hi) / 2));
    clip(polygon, axis + 1, cell, normal, eps, out);
    return;
  }
  Polygon rest(polygon.begin(), polygon.end()), below, above;
  for (double k = first; k <= last; ++k) {
    cell[axis] = static_cast<int32_t>(k);
    if (k < last) {
      const double plane = k + 1;
      const auto crossing = [&](const Point& a, const Point& b) {
        const double t = (plane - a[axis]) / (b[axis] - a[axis]);
        Point c{a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z)};
        c[axis] = plane;
        return c;
      };
      split(rest, [&](const Point& p) { return p[axis] - plane; }, crossing, eps, below, above);
    } else {
      below = rest;
    }
    if (below.size() >= 3) clip(below, axis + 1, cell, normal, eps, out);
    if (k < last) std::swap(rest, above);
  }
}

}  // namespace

void PieceCutter::cut(uint32_t triangle, PieceList& out) const {
  const int fineness = finenessOf(scene_, triangle);
  const double s = static_cast<double>(cell_m_) * edgeCells(fineness);  // clipped in units of own cells
  Polygon corners;
  for (const uint32_t v : scene_.triangles[triangle].v) {
    const Vec3 p = scene_.positions[v];
    corners.push_back({static_cast<double>(p.x) / s, static_cast<double>(p.y) / s, static_cast<double>(p.z) / s});
  }
  std::vector<std::pair<Cell, Polygon>> parts;
  // A stray object far away must not make the rest coarser: by the triangle's own coordinates.
  const double rounding = static_cast<double>(largestCoordinate(scene_, triangle)) * 0x1p-24 / s;
  clip(corners, 0, {}, vectorArea(corners), std::max(1e-4, 4 * rounding), parts);
  // Slivers that only rounding made are left out.
  if (parts.size() > 1) {
    const auto sliver = [](const auto& part) {
      const Point n = vectorArea(part.second);
      return dot(n, n) < 1e-16;
    };
    const auto end = std::remove_if(parts.begin(), parts.end(), sliver);
    if (end != parts.begin()) parts.erase(end, parts.end());
  }
  std::stable_sort(parts.begin(), parts.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (auto& [cell, polygon] : parts) {
    for (Point& p : polygon) p = p * edgeCells(fineness);  // exact
    const Piece piece{cell, triangle, fineness, polygon};
    if (fences_) fences_->cut(piece, out);
    else out.add(piece);
  }
}

}  // namespace ff::bake
