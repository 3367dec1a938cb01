// Form factors by ray casting: row i of the hit matrix counts where `rays` cosine-distributed rays from patch i end.
//   F_ij = 1/A_i int_Ai int_Aj cos(i) cos(j) / (pi r^2) V dAj dAi  is estimated by  h_ij / rays.
// Michael F. Cohen, John R. Wallace. Radiosity and Realistic Image Synthesis. 1993, chapter 4.
// A patch's rays depend on its number and the seed alone.
#pragma once
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/patches.h"
#include "bake/ray_caster.h"
#include "bake/sobol.h"

namespace ff::bake {

// Sparse rows of hit counts over patches; columns ascending. Rows sum with sky and absorbed to `rays`.
struct HitRows {
  uint32_t rays = 0;               // per patch
  std::vector<uint64_t> start;     // patches + 1
  std::vector<uint32_t> column;
  std::vector<uint16_t> count;
  std::vector<uint32_t> sky, absorbed;   // per patch; absorbed: back faces
  std::vector<Vec3> sky_direction;       // per patch: mean over its sky rays
};

// `rays` origins stratified over the patch and directions stratified over the cosine-weighted hemisphere.
void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               float surface_offset, std::span<Ray> rays);

// Casts all rows on all of TBB's threads; `done` counts patches for a progress bar. rays <= 65535.
HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays, uint64_t seed,
                 std::atomic<uint64_t>& done);

// The same rows with patch p renumbered to number[p].
HitRows renumber(const HitRows& rows, std::span<const uint32_t> number);

}  // namespace ff::bake
