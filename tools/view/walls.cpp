#include "tools/view/walls.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace ff::view {
namespace {

GridCell cellOf(Vec3 p, float step_m) {
  return {static_cast<int32_t>(std::floor(p.x / step_m)), static_cast<int32_t>(std::floor(p.y / step_m)),
          static_cast<int32_t>(std::floor(p.z / step_m))};
}

// Tomas Moeller, Ben Trumbore. Fast, minimum storage ray-triangle intersection. Journal of Graphics Tools 2(1), 1997.
bool crosses(Vec3 from, Vec3 to, Vec3 a, Vec3 b, Vec3 c) {
  const Vec3 way = to - from, e = b - a, f = c - a, p = cross(way, f);
  const float det = dot(e, p);
  if (std::abs(det) < 1e-30f) return false;
  const Vec3 s = from - a, q = cross(s, e);
  const float u = dot(s, p) / det, v = dot(way, q) / det, t = dot(f, q) / det;
  return u >= 0 && v >= 0 && u + v <= 1 && t >= 0 && t <= 1;
}

}  // namespace

Walls::Walls(std::span<const Vec3> corners, std::span<const uint32_t> patches, float cell_m, float tolerance)
    : corners_(corners), patches_(patches), step_m_(cell_m / 3), tolerance_(tolerance) {
  for (uint32_t t = 0; t < patches.size(); ++t) {
    Box box;
    for (size_t k = 3 * t; k < 3 * t + 3; ++k) box.add(corners[k]);
    const Vec3 margin = Vec3{1, 1, 1} * (8 * tolerance);  // farther than eyes are from their side
    const GridCell lo = cellOf(box.lo - margin, step_m_), hi = cellOf(box.hi + margin, step_m_);
    for (int32_t x = lo[0]; x <= hi[0]; ++x)
      for (int32_t y = lo[1]; y <= hi[1]; ++y)
        for (int32_t z = lo[2]; z <= hi[2]; ++z) triangles_[{x, y, z}].push_back(t);
  }
}

std::vector<std::vector<uint32_t>> Walls::split(std::span<const uint32_t> alike) const {
  const size_t n = alike.size();
  std::vector<uint32_t> group(n);
  std::iota(group.begin(), group.end(), 0u);
  const auto join = [&](size_t i, size_t j) {
    const uint32_t from = std::max(group[i], group[j]), to = std::min(group[i], group[j]);
    std::replace(group.begin(), group.end(), from, to);
  };
  // Welding takes the area of slivers, along a wall above all: on which side of it they lay is not to be seen.
  std::vector<bool> has_area(n);
  for (size_t i = 0; i < n; ++i) {
    const size_t first = alike[i] / 3 * 3;
    has_area[i] = !(cross(corners_[first + 1] - corners_[first], corners_[first + 2] - corners_[first]) == Vec3{});
  }
  bool wall = false;
  for (size_t i = 0; i < n; ++i)
    for (size_t j = 0; j < i; ++j)
      if (patches_[alike[i] / 3] == patches_[alike[j] / 3]) join(i, j);
  for (size_t i = 0; i < n; ++i)
    for (size_t j = 0; j < i; ++j) {
      if (group[i] == group[j] || !has_area[i] || !has_area[j]) continue;
      const uint32_t first[2] = {alike[i] / 3 * 3, alike[j] / 3 * 3};
      const Vec3 at = corners_[alike[i]];
      for (uint32_t k = 1; k < 3; ++k)
        for (uint32_t m = 1; m < 3; ++m) {
          const Vec3 a = corners_[first[0] + (alike[i] + k - first[0]) % 3] - at, b = corners_[first[1] + (alike[j] + m - first[1]) % 3] - at;
          const Vec3 &shorter = dot(a, a) < dot(b, b) ? a : b, along = normalized(dot(a, a) < dot(b, b) ? b : a);
          const float shared = dot(shorter, along);
          if (!(shared > 0) || length(shorter - along * shared) > 2 * tolerance_) continue;
          if (wallBetween(alike[i], alike[j], at + along * (shared / 2), along)) {
            wall = true;
          } else {
            join(i, j);
          }
        }
    }
  if (!wall) return {std::vector<uint32_t>(alike.begin(), alike.end())};
  std::vector<std::vector<uint32_t>> groups;
  for (uint32_t g = 0; g < n; ++g) {
    std::vector<uint32_t> members;
    for (size_t i = 0; i < n; ++i)
      if (group[i] == g) members.push_back(alike[i]);
    if (!members.empty()) groups.push_back(std::move(members));
  }
  return groups;
}

// From two eyes, above the faces and on either side of their common side, one to the other.
bool Walls::wallBetween(uint32_t c, uint32_t d, Vec3 on_side, Vec3 along) const {
  const auto eye = [&](uint32_t corner) {
    const uint32_t t = corner / 3;
    const Vec3 a = corners_[3 * t], normal = normalized(cross(corners_[3 * t + 1] - a, corners_[3 * t + 2] - a));
    Vec3 inward = normalized(cross(normal, along));
    const Vec3 middle = (a + corners_[3 * t + 1] + corners_[3 * t + 2]) / 3.0f;
    if (dot(inward, middle - on_side) < 0) inward *= -1;
    return on_side + inward * (2 * tolerance_) + normal * (4 * tolerance_);
  };
  const Vec3 from = eye(c), to = eye(d), lo = min(from, to), hi = max(from, to);
  const auto here = triangles_.find(cellOf(on_side, step_m_));
  if (here == triangles_.end()) return false;
  return std::any_of(here->second.begin(), here->second.end(), [&](uint32_t t) {
    const Vec3 &p = corners_[3 * t], &q = corners_[3 * t + 1], &r = corners_[3 * t + 2];
    for (int k = 0; k < 3; ++k)
      if (std::max({p[k], q[k], r[k]}) < lo[k] || std::min({p[k], q[k], r[k]}) > hi[k]) return false;
    return t != c / 3 && t != d / 3 && crosses(from, to, p, q, r);
  });
}

}  // namespace ff::view
