// Points of a patch's surface that rays start from.
#pragma once
#include <span>

#include "bake/rays/ray_caster.h"
#include "bake/rays/sobol.h"
#include "bake/surface/patches.h"

namespace ff::bake {

struct SurfacePoint {
  Vec3 position;  // m; lifted off the surface, so that rounding cannot put it behind
  Vec3 normal;    // of the surface there
  float u, v;     // in [0, 1), stratified over all points, and together with where they lie
};

// The power heuristic of Eric Veach and Leonidas J. Guibas (Optimally combining sampling techniques for Monte Carlo rendering. 1995):
// the weight of a sample of one kind, given how densely both kinds of samples fall where it lies, all of a kind together.
inline double powerWeight(double own, double other) { return own * own / (own * own + other * other); }

// Points stratified over the patch, holes left out; they depend on the seed, the patch and its name alone. At most as many as sobol has. first: number of
// the first of them.
void surfacePoints(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
                   const RayCaster& caster, std::span<SurfacePoint> points, uint32_t first = 0);

// A cosine-distributed ray from each, as its u and v have it.
void cosineRays(std::span<const SurfacePoint> points, std::span<Ray> rays);

}  // namespace ff::bake
