#include "bake/surface/sealed.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <vector>

#include "bake/rays/cosine_rays.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"

namespace ff::bake {
namespace {

// kFew rays that all go far say that surface is open; else kMaxProbes, or kOfCrumbs of what is under kCrumbCells of a cell's
// face, are cast. Hidden origins, more than half, or kClosed of the rays of the others ending within kNear cells are what sealed
// surface has. In the second case kWalks random walks of kBounces look for a way out, kOut cells from where they start, or a lamp.
// Distances are in base cells, whatever the fineness: whether light gets to a place is not for its patches to say.
constexpr uint32_t kFew = 8, kOfCrumbs = 16, kWalks = 4, kBounces = 64;
constexpr float kNear = 1, kOut = 4;
constexpr double kClosed = 0.95, kCrumbCells = 0.05;

float uniform(uint64_t seed) { return static_cast<float>(mix64(seed) >> 40) * 0x1p-24f; }

struct Sample {
  Vec3 a, b, c;
  double cumulative_area;
  PieceSide side;
};

}  // namespace

bool isBuried(const RayCaster& caster, Vec3 origin, Vec3 normal) {
  const Frame frame = frameOf(normal);
  for (int k = 0; k < 4; ++k) {
    const Vec3 side = (k & 1 ? frame.tangent : frame.bitangent) * (k & 2 ? 1.0f : -1.0f);
    const Hit hit = caster.nearest({origin, normalized(frame.normal + side)});
    if (hit.triangle == kNone || hit.front) return false;
  }
  return true;
}

bool SealedSurface::isSealed(std::span<const PieceSide> surface) const {
  std::vector<Sample> samples;
  double area = 0;
  for (const PieceSide side : surface) {
    const PolygonView p = side.piece->polygon;
    const auto metres = [&](size_t i) {
      return Vec3{static_cast<float>(p[i].x), static_cast<float>(p[i].y), static_cast<float>(p[i].z)} * cell_m_;
    };
    for (size_t i = 1; i + 1 < p.size(); ++i) {
      area += length(cross(p[i] - p[0], p[i + 1] - p[0])) / 2;
      samples.push_back({metres(0), metres(side.back ? i + 1 : i), metres(side.back ? i : i + 1), area, side});
    }
  }
  if (!(area > 0)) return false;
  const Piece& first = *surface[0].piece;
  uint64_t id = surface[0].back;  // by where it lies
  for (const double x : {first.polygon[0].x, first.polygon[0].y, first.polygon[0].z}) id = mix64(id) + std::bit_cast<uint64_t>(x);
  const auto seeds = SobolTable::seeds(0, id);
  uint32_t origins = 0, hidden = 0, near = 0;
  std::array<Ray, kMaxProbes> rays;  // those that end near
  for (uint32_t k = 0; k < (area < kCrumbCells * faceCells(first.fineness) ? kOfCrumbs : kMaxProbes); ++k) {
    if (k == kFew && near == 0 && (hidden == 0 || hidden == origins)) break;
    const auto u = points_.point(k, seeds);
    const double x = static_cast<double>(u[0]) * area;
    auto at = std::upper_bound(samples.begin(), samples.end(), x, [](double a, const Sample& s) { return a < s.cumulative_area; });
    if (at == samples.end()) --at;
    const double before = at == samples.begin() ? 0 : (at - 1)->cumulative_area, own = at->cumulative_area - before;
    const Vec3 on = pointInTriangle(at->a, at->b, at->c, own > 0 ? static_cast<float>(std::clamp((x - before) / own, 0.0, 1.0)) : 0.5f, u[1]);
    const uint32_t triangle = at->side.piece->triangle;
    if (scene_.materials[scene_.triangles[triangle].material].cutout) {
      const auto [b, c] = barycentric(scene_, triangle, on);
      if (isHole(scene_, triangle, b, c)) continue;
    }
    const Frame frame = frameOf(normalized(cross(at->b - at->a, at->c - at->a)));
    ++origins;
    const auto cells = [&](float v) { return static_cast<double>(v) / static_cast<double>(cell_m_); };
    if (at->side.piece->doubled[at->side.back] || fences_.isCovered(triangle, at->side.back, {cells(on.x), cells(on.y), cells(on.z)})) {
      ++hidden;
      continue;
    }
    const Ray ray{on + frame.normal * caster_.surfaceOffset(triangle), cosineDirection(frame, u[2], u[3])};
    const Hit hit = caster_.nearest(ray);
    if (hit.triangle == kNone) continue;
    if (!hit.front && !scene_.materials[scene_.triangles[hit.triangle].material].double_sided) {
      if (isBuried(caster_, ray.origin, frame.normal)) ++hidden;
    } else if (length(hit.point - ray.origin) < kNear * cell_m_) {
      rays[near++] = ray;
    }
  }
  if (2 * hidden > origins) return true;
  if (origins == 0) {  // holes alone?
    SurfaceMean mean(1);
    return std::all_of(samples.begin(), samples.end(), [&](const Sample& t) {
      return mean.add(scene_, t.side.piece->triangle, t.a, t.b, t.c, length(cross(t.b - t.a, t.c - t.a)) / 2) == 0;
    });
  }
  if (near == 0 || near < kClosed * (origins - hidden)) return false;
  if (!(scene_.materials[scene_.triangles[first.triangle].material].emission == Vec3{})) return false;
  for (uint32_t k = 0; k < std::min(kWalks, near); ++k)
    if (getsOut(rays[k], mix64(id + k))) return false;
  return true;
}

bool SealedSurface::getsOut(Ray ray, uint64_t seed) const {
  const Vec3 start = ray.origin;
  for (uint32_t bounce = 0; bounce < kBounces; ++bounce) {
    const Hit hit = caster_.nearest(ray, 2 * kOut * cell_m_);
    if (hit.triangle == kNone || length(hit.point - start) > kOut * cell_m_) return true;
    const Triangle& t = scene_.triangles[hit.triangle];
    const Material& material = scene_.materials[t.material];
    if (!(material.emission == Vec3{})) return true;
    if (!hit.front && !material.double_sided) return false;
    const Vec3 a = scene_.positions[t.v[0]], n = normalized(cross(scene_.positions[t.v[1]] - a, scene_.positions[t.v[2]] - a));
    const Frame frame = frameOf(hit.front ? n : n * -1.0f);
    const Vec3 on_plane = hit.point - n * dot(hit.point - a, n);  // a ray that comes from afar is rounded more than the triangle
    ray = {on_plane + frame.normal * caster_.surfaceOffset(hit.triangle),
           cosineDirection(frame, uniform(seed + 2 * bounce), uniform(seed + 2 * bounce + 1))};
  }
  return false;
}

}  // namespace ff::bake
