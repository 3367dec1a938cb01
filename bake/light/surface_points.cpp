#include "bake/light/surface_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <vector>

#include "bake/rays/cosine_rays.h"
#include "bake/rays/surface_sampling.h"
#include "bake/wide.h"

namespace ff::bake {
namespace {

constexpr size_t kPointsAtOnce = 256;

struct AllAlongAxes {
  [[gnu::always_inline]] static void run(const float* u, const float* v, float* tangent, float* bitangent, float* normal, size_t points) {
    for (size_t i = 0; i < points; ++i) {
      const AlongAxes along = cosineAlongAxes(u[i], v[i]);
      tangent[i] = along.tangent;
      bitangent[i] = along.bitangent;
      normal[i] = along.normal;
    }
  }
};

}  // namespace

void surfacePoints(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
                   const RayCaster& caster, std::span<SurfacePoint> points, uint32_t first) {
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
  std::array<std::array<float, kPointsAtOnce>, 4> u;  // by dimension: the first two are stratified best together, and whereto matters more than where from
  for (uint32_t i = 0; i < points.size(); ++i) {
    const size_t k = i % kPointsAtOnce;
    if (k == 0)
      for (uint32_t d = 0; d < 4; ++d) sobol.points(first + i, d, seeds, std::span(u[d]).first(std::min(kPointsAtOnce, points.size() - i)));
    float pick = u[2][k], v = u[3][k];
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
    points[i] = {position + facet->normal * facet->offset_m, facet->normal, u[0][k], u[1][k]};
  }
}

void cosineRays(std::span<const SurfacePoint> points, std::span<Ray> rays) {
  std::array<float, kPointsAtOnce> u, v, tangent, bitangent, normal;
  Frame frame = frameOf({});
  for (size_t first = 0; first < points.size(); first += kPointsAtOnce) {
    const auto some = points.subspan(first, std::min(kPointsAtOnce, points.size() - first));
    for (size_t k = 0; k < some.size(); ++k) u[k] = some[k].u, v[k] = some[k].v;
    onWidest<AllAlongAxes>(u.data(), v.data(), tangent.data(), bitangent.data(), normal.data(), some.size());
    for (size_t k = 0; k < some.size(); ++k) {
      if (std::memcmp(&some[k].normal, &frame.normal, sizeof(Vec3)) != 0) frame = frameOf(some[k].normal);  // bits: 0 and -0 have frames of their own
      rays[first + k] = {some[k].position, directionIn(frame, {tangent[k], bitangent[k], normal[k]})};
    }
  }
}

}  // namespace ff::bake
