#include "bake/pieces.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "bake/cosine_rays.h"
#include "bake/surface_sampling.h"

namespace ff::bake {
namespace {

// Cuts a convex polygon at coordinate `plane` of axis a. Corners within eps of the plane belong to both sides.
void split(const Polygon& in, int a, double plane, double eps, Polygon& below, Polygon& above) {
  below.clear();
  above.clear();
  for (size_t i = 0; i < in.size(); ++i) {
    const Point& p = in[i];
    const Point& q = in[(i + 1) % in.size()];
    const double dp = p[a] - plane, dq = q[a] - plane;
    if (dp <= eps) below.push_back(p);
    if (dp >= -eps) above.push_back(p);
    if ((dp < -eps && dq > eps) || (dp > eps && dq < -eps)) {
      // From the lower end always, so that two triangles cut their common edge at the same point.
      const Point& lo = dp < dq ? p : q;
      const Point& hi = dp < dq ? q : p;
      const double t = (plane - lo[a]) / (hi[a] - lo[a]);
      Point c{lo.x + t * (hi.x - lo.x), lo.y + t * (hi.y - lo.y), lo.z + t * (hi.z - lo.z)};
      c[a] = plane;
      below.push_back(c);
      above.push_back(c);
    }
  }
}

// Splits `polygon` along `axis` and on along the axes after it. A polygon that lies in a grid plane belongs to the cell
// behind it, so that the faces of a voxel lie in the voxel's own cell.
void clip(const Polygon& polygon, int axis, Cell cell, const Point& normal, double eps,
          std::vector<std::pair<Cell, Polygon>>& out) {
  if (axis == 3) {
    out.emplace_back(cell, polygon);
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
  Polygon rest = polygon, below, above;
  for (double k = first; k <= last; ++k) {
    cell[axis] = static_cast<int32_t>(k);
    if (k < last) {
      split(rest, axis, k + 1, eps, below, above);
    } else {
      below = rest;
    }
    if (below.size() >= 3) clip(below, axis + 1, cell, normal, eps, out);
    if (k < last) std::swap(rest, above);
  }
}

// Clips to the grid whose cells are 1 / scale large. Slivers that only rounding made are left out; at least one piece stays.
std::vector<std::pair<Cell, Polygon>> clipToGrid(const Polygon& polygon, double scale, double eps) {
  Polygon scaled = polygon;
  for (Point& p : scaled) p = {p.x * scale, p.y * scale, p.z * scale};
  std::vector<std::pair<Cell, Polygon>> parts;
  clip(scaled, 0, {}, vectorArea(scaled), eps * scale, parts);
  const auto sliver = [](const std::pair<Cell, Polygon>& part) {
    const Point n = vectorArea(part.second);
    return dot(n, n) < 1e-16;
  };
  if (parts.size() > 1) {
    const auto end = std::remove_if(parts.begin(), parts.end(), sliver);
    if (end != parts.begin()) parts.erase(end, parts.end());
  }
  for (auto& [cell, part] : parts)
    for (Point& p : part) p = {p.x / scale, p.y / scale, p.z / scale};
  return parts;
}

// Rays are cast until it is clear what a piece is: kFew that all go far say that it is open; of all (kOfCrumbs of a crumb) the
// share that ends within kNear cells makes a crevice. Between kOpen and kClosed a piece may be of two kinds, and is looked at in parts,
// unless it is a crumb anyway. Past kClosed, kWalks random walks of kBounces look for a way out, kOut cells from where they
// start, or a lamp: without one, it is a pocket. (What is sealed and reflects nearly all would be filled with light by the
// least that seeps in.)
// Nearer than 1 - kTouch of the way to where rays start, two surfaces are one to rounding, and neither is covered.
constexpr float kTouch = 0.9f;
constexpr uint32_t kFew = 8, kOfCrumbs = 16, kWalks = 4, kBounces = 64;
constexpr float kNear = 1, kOut = 4;
constexpr double kOpen = 0.15, kCrevice = 0.8, kClosed = 0.95, kLeastCells = 0.05;

bool isCrumb(const Piece& piece) {
  const Point area = vectorArea(piece.polygon);
  return dot(area, area) < kLeastCells * kLeastCells;
}

float uniform(uint64_t seed) { return static_cast<float>(mix64(seed) >> 40) * 0x1p-24f; }

}  // namespace

Point vectorArea(const Polygon& p) {
  Point n{0, 0, 0};
  for (size_t i = 1; i + 1 < p.size(); ++i) {
    const Point c = cross(p[i] - p[0], p[i + 1] - p[0]);
    n = {n.x + c.x / 2, n.y + c.y / 2, n.z + c.z / 2};
  }
  return n;
}

// A stray object far away must not make the rest coarser: by the triangle's own coordinates.
double PieceCutter::eps(uint32_t triangle) const {
  return std::max(1e-4, 4.0 * static_cast<double>(largestCoordinate(scene_, triangle)) * 0x1p-24 / static_cast<double>(cell_m_));
}

void PieceCutter::cut(uint32_t triangle, std::vector<Piece>& out) const {
  Polygon corners;
  for (const uint32_t v : scene_.triangles[triangle].v) {
    const Vec3 p = scene_.positions[v];
    const auto s = static_cast<double>(cell_m_);
    corners.push_back({static_cast<double>(p.x) / s, static_cast<double>(p.y) / s, static_cast<double>(p.z) / s});
  }
  const size_t first = out.size();
  for (auto& [cell, polygon] : clipToGrid(corners, 1, eps(triangle))) divide({cell, 0, cell, triangle, std::move(polygon)}, out);
  std::sort(out.begin() + static_cast<ptrdiff_t>(first), out.end(),
            [](const Piece& a, const Piece& b) { return std::tie(a.depth, a.cube) < std::tie(b.depth, b.cube); });
}

void PieceCutter::divide(Piece piece, std::vector<Piece>& out) const {
  if (!caster_) {
    out.push_back(std::move(piece));
    return;
  }
  bool mixed = false;
  const int sides = scene_.materials[scene_.triangles[piece.triangle].material].double_sided ? 2 : 1;
  for (int side = 0; side < sides; ++side) {
    const Sight sight = look(piece, side == 1);
    piece.enclosure[side] = sight.enclosure;
    mixed |= sight.mixed;
  }
  if (!mixed || piece.depth == kDeepestPiece || isCrumb(piece)) {
    out.push_back(std::move(piece));
    return;
  }
  const size_t first = out.size();
  const int depth = piece.depth + 1;
  for (auto& [cube, polygon] : clipToGrid(piece.polygon, std::ldexp(1.0, depth), eps(piece.triangle)))
    divide({piece.cell, depth, cube, piece.triangle, std::move(polygon)}, out);
  const bool alike = std::all_of(out.begin() + static_cast<ptrdiff_t>(first), out.end(), [&](const Piece& part) {
    return std::equal(part.enclosure, part.enclosure + 2, out[first].enclosure);
  });
  if (!alike) return;
  std::copy_n(out[first].enclosure, 2, piece.enclosure);
  out.resize(first);
  out.push_back(std::move(piece));
}

PieceCutter::Sight PieceCutter::look(const Piece& piece, bool back) const {
  std::vector<Vec3> corners;
  for (const Point& p : piece.polygon)
    corners.push_back(Vec3{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)} * cell_m_);
  if (back) std::reverse(corners.begin(), corners.end());
  std::vector<float> area{0};  // of the fan up to each triangle
  Vec3 normal;
  for (size_t i = 1; i + 1 < corners.size(); ++i) {
    const Vec3 n = cross(corners[i] - corners[0], corners[i + 1] - corners[0]);
    normal += n;
    area.push_back(area.back() + length(n));
  }
  if (!(area.back() > 0)) return {Enclosure::kOpen, false};
  const Frame frame = frameOf(normalized(normal));
  uint64_t id = piece.triangle * 8ull + static_cast<uint64_t>(2 * piece.depth + back);
  for (const int32_t x : piece.cube) id = mix64(id) + static_cast<uint32_t>(x);
  const auto seeds = SobolTable::seeds(0, id);
  const bool cutout = scene_.materials[scene_.triangles[piece.triangle].material].cutout;
  uint32_t cast = 0, near = 0, covered = 0;
  std::array<Ray, kMostProbes> rays;  // those that end near
  for (uint32_t k = 0; k < (isCrumb(piece) ? kOfCrumbs : kMostProbes); ++k) {
    if (k == kFew && near == 0 && (covered == 0 || covered == kFew)) break;
    const auto u = points_.point(k, seeds);
    const float x = u[0] * area.back();
    const auto at = std::min<size_t>(static_cast<size_t>(std::upper_bound(area.begin(), area.end(), x) - area.begin()), area.size() - 1);
    const float own = area[at] - area[at - 1];
    const Vec3 origin = pointInTriangle(corners[0], corners[at], corners[at + 1],
                                        own > 0 ? std::clamp((x - area[at - 1]) / own, 0.0f, 1.0f) : 0.5f, u[1]);
    if (cutout) {
      const auto [b, c] = barycentric(scene_, piece.triangle, origin);
      if (isHole(scene_, piece.triangle, b, c)) continue;
    }
    if (isCovered(piece.triangle, origin, frame.normal)) {
      ++covered;
      continue;
    }
    ++cast;
    const Ray ray{origin + frame.normal * caster_->surfaceOffset(piece.triangle), cosineDirection(frame, u[2], u[3])};
    const Hit hit = caster_->nearest(ray, kNear * cell_m_);
    if (hit.triangle == kNone) continue;
    // Backs do not count: what lies inside a solid is sorted out origin by origin (form_factor.h).
    rays[near] = ray;
    if (hit.front || scene_.materials[scene_.triangles[hit.triangle].material].double_sided) ++near;
  }
  if (covered > cast) return {Enclosure::kPocket, cast > 0};
  const double share = cast > 0 ? static_cast<double>(near) / cast : 0;
  Enclosure enclosure = share > kCrevice ? Enclosure::kCrevice : Enclosure::kOpen;
  if (share >= kClosed && scene_.materials[scene_.triangles[piece.triangle].material].emission == Vec3{}) {
    enclosure = Enclosure::kPocket;
    for (uint32_t k = 0; k < std::min(kWalks, near) && enclosure == Enclosure::kPocket; ++k)
      if (getsOut(rays[k], mix64(id + k))) enclosure = Enclosure::kCrevice;
  }
  return {enclosure, covered > 0 || (share > kOpen && share < kClosed)};
}

// Another surface lies on it, nearer than rays start: a picture on its wall. They would start in front of that and see all the
// same, while nothing sees where they come from.
bool PieceCutter::isCovered(uint32_t triangle, Vec3 point, Vec3 normal) const {
  const float above = caster_->surfaceOffset(triangle);
  const Hit hit = caster_->nearest({point + normal * above, normal * -1.0f}, kTouch * above);
  return hit.triangle != kNone && hit.triangle != triangle &&
         (hit.front || scene_.materials[scene_.triangles[hit.triangle].material].double_sided);
}

bool PieceCutter::getsOut(Ray ray, uint64_t seed) const {
  const Vec3 start = ray.origin;
  for (uint32_t bounce = 0; bounce < kBounces; ++bounce) {
    const Hit hit = caster_->nearest(ray, 2 * kOut * cell_m_);
    if (hit.triangle == kNone || length(hit.point - start) > kOut * cell_m_) return true;
    const Triangle& t = scene_.triangles[hit.triangle];
    const Material& material = scene_.materials[t.material];
    if (!(material.emission == Vec3{})) return true;
    if (!hit.front && !material.double_sided) return false;
    const Vec3 a = scene_.positions[t.v[0]], n = normalized(cross(scene_.positions[t.v[1]] - a, scene_.positions[t.v[2]] - a));
    const Frame frame = frameOf(hit.front ? n : n * -1.0f);
    const Vec3 on_plane = hit.point - n * dot(hit.point - a, n);  // a ray that comes from afar is rounded more than the triangle
    ray = {on_plane + frame.normal * caster_->surfaceOffset(hit.triangle),
           cosineDirection(frame, uniform(seed + 2 * bounce), uniform(seed + 2 * bounce + 1))};
  }
  return false;
}

}  // namespace ff::bake
