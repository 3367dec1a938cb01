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
  struct Facet {  // what every point needs of a triangle
    Vec3 normal;
    float offset_m;
    float before_m2, end_m2;  // of the patch's area
    bool cutout;
  };
  std::vector<Facet> facets;
  facets.reserve(triangles.size());
  for (float before_m2 = 0; const PatchTriangle& t : triangles) {
    const bool cutout = scene.materials[scene.triangles[t.source].material].cutout;
    facets.push_back({normalized(cross(t.b - t.a, t.c - t.a)), caster.surfaceOffset(t.source), before_m2, t.cumulative_area, cutout});
    before_m2 = t.cumulative_area;
  }
  for (uint32_t i = 0; i < points.size(); ++i) {
    const auto u = sobol.point(i, seeds);  // the first two are stratified best together: whereto matters more than where from
    float pick = u[2], v = u[3];
    const Facet* facet = nullptr;
    Vec3 position;
    for (int attempt = 0; attempt < 16; ++attempt) {  // again where a cutout has a hole
      const float x = pick * whole;
      facet = &*std::min(std::upper_bound(facets.begin(), facets.end(), x, [](float m2, const Facet& f) { return m2 < f.end_m2; }), facets.end() - 1);
      const PatchTriangle& t = triangles[static_cast<size_t>(facet - facets.data())];
      const float own = facet->end_m2 - facet->before_m2;
      position = pointInTriangle(t.a, t.b, t.c, own > 0 ? std::clamp((x - facet->before_m2) / own, 0.0f, 1.0f) : 0.5f, v);
      if (!facet->cutout) break;
      const auto [b, c] = barycentric(scene, t.source, position);
      if (mayStart(scene, t.source, b, c)) break;
      pick = std::fmod(pick + 0.6180339887f, 1.0f);
      v = std::fmod(v + 0.7548776662f, 1.0f);
    }
    points[i] = {position + facet->normal * facet->offset_m, facet->normal, u[0], u[1]};
  }
}

}  // namespace ff::bake
