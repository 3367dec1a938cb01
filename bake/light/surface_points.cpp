#include "bake/light/surface_points.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "bake/rays/cosine_rays.h"
#include "bake/rays/surface_sampling.h"

namespace ff::bake {

void surfacePoints(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
                   const RayCaster& caster, std::span<SurfacePoint> points) {
  const Patch& p = set.patches[patch];
  const std::span<const PatchTriangle> triangles(set.triangles.data() + p.first_triangle, p.triangles);
  const float whole = triangles.back().cumulative_area;
  const auto seeds = SobolTable::seeds(seed, p.name);
  std::vector<Vec3> normals;
  normals.reserve(triangles.size());
  for (const PatchTriangle& t : triangles) normals.push_back(normalized(cross(t.b - t.a, t.c - t.a)));
  for (uint32_t i = 0; i < points.size(); ++i) {
    const auto u = sobol.point(i, seeds);
    float pick = u[0], v = u[1];
    const PatchTriangle* t = nullptr;
    Vec3 position;
    for (int attempt = 0; attempt < 16; ++attempt) {  // again where a cutout has a hole
      const float x = pick * whole;
      const auto at = std::upper_bound(triangles.begin(), triangles.end(), x,
                                       [](float a, const PatchTriangle& q) { return a < q.cumulative_area; });
      t = at == triangles.end() ? &triangles.back() : &*at;
      const float before = at == triangles.begin() ? 0.0f : (t - 1)->cumulative_area;
      const float own = t->cumulative_area - before;
      position = pointInTriangle(t->a, t->b, t->c, own > 0 ? std::clamp((x - before) / own, 0.0f, 1.0f) : 0.5f, v);
      if (!scene.materials[scene.triangles[t->source].material].cutout) break;
      const auto [b, c] = barycentric(scene, t->source, position);
      if (mayStart(scene, t->source, b, c)) break;
      pick = std::fmod(pick + 0.6180339887f, 1.0f);
      v = std::fmod(v + 0.7548776662f, 1.0f);
    }
    const Vec3 normal = normals[static_cast<size_t>(t - triangles.data())];
    points[i] = {position + normal * caster.surfaceOffset(t->source), normal, u[2], u[3]};
  }
}

}  // namespace ff::bake
