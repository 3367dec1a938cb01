// Form factors by ray casting: row i of the hit matrix counts where `rays` cosine-distributed rays from patch i end.
//   F_ij = 1/A_i int_Ai int_Aj cos(i) cos(j) / (pi r^2) V dAj dAi  is estimated by  h_ij / rays.
// Michael F. Cohen, John R. Wallace. Radiosity and Realistic Image Synthesis. 1993, chapter 4.
// A patch's rays depend on its number and the seed alone.
//
// Levels are built of solids that run into each other. An origin is *buried* when its ray and four more around its normal
// all end on back faces: it lies inside another solid and takes no part. A patch's exposed area is A_i (1 - buried / rays).
// So does one that sees a pocket (pieces.h): no light gets in or out there, so it lies inside.
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/patches.h"
#include "bake/ray_caster.h"
#include "bake/sobol.h"

namespace ff::bake {

// A patch is narrow where most of its rays (kMostRays) end within four cells, as in an alley or a thick wall, and very narrow
// where they end within one.
inline constexpr std::array<float, 2> kNarrowCells = {4, 1};
inline constexpr double kMostRays = 0.6;

// Lamps are few and light much: they cast up to this many times the rays of a patch, as long as all together cast no more
// than a quarter of the patches' rays. What a patch gets of a lamp is then known from the lamp's end.
inline constexpr uint32_t kMostLampRays = 8;

// What a patch sees of the sky, on average: formats::Node says what for.
struct SkyMeans {
  Vec3 direction;
  std::array<float, 5> quadratic{};
};

// Sums of weighted directions; means() divides by the sum of the weights.
class SkySums {
 public:
  void add(Vec3 direction, double weight) {
    const auto x = static_cast<double>(direction.x), y = static_cast<double>(direction.y), z = static_cast<double>(direction.z);
    const double terms[8] = {x, y, z, 2 * x * y, 2 * y * z, 2 * z * x, (3 * y * y - 1) / 2, x * x - z * z};
    weight_ += weight;
    for (size_t k = 0; k < 8; ++k) sums_[k] += weight * terms[k];
  }
  void add(const SkyMeans& means, double weight) {
    weight_ += weight;
    for (size_t k = 0; k < 3; ++k) sums_[k] += weight * static_cast<double>(means.direction[static_cast<int>(k)]);
    for (size_t k = 0; k < 5; ++k) sums_[3 + k] += weight * static_cast<double>(means.quadratic[k]);
  }
  double weight() const { return weight_; }
  SkyMeans means() const {
    SkyMeans m;
    if (!(weight_ > 0)) return m;
    for (size_t k = 0; k < 3; ++k) m.direction[static_cast<int>(k)] = static_cast<float>(sums_[k] / weight_);
    for (size_t k = 0; k < 5; ++k) m.quadratic[k] = static_cast<float>(sums_[3 + k] / weight_);
    return m;
  }

 private:
  double weight_ = 0, sums_[8] = {};
};

// Sparse rows of hit counts over patches; columns ascending. Rows sum with sky, absorbed and buried to `rays`.
struct HitRows {
  std::vector<uint32_t> rays;      // per patch
  std::vector<uint64_t> start;     // patches + 1
  std::vector<uint32_t> column;
  std::vector<uint16_t> count;
  std::vector<uint32_t> sky, absorbed, buried;  // per patch; absorbed: back faces seen from exposed origins
  std::vector<SkyMeans> sky_means;       // per patch, over its sky rays
  std::vector<uint8_t> narrow;           // per patch: how many of kNarrowCells most rays do not get to; left behind by renumber()
};

// Origins stratified over the patch and directions stratified over the cosine-weighted hemisphere. normals: of the surface
// at each origin, or empty.
void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               const RayCaster& caster, std::span<Ray> rays, std::span<Vec3> normals = {});

// Casts all rows on all of TBB's threads; `done` counts patches for a progress bar. rays <= 65535: of a patch that is no lamp.
HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays, uint64_t seed,
                 std::atomic<uint64_t>& done);

// Of the patch's area. A patch that is all buried keeps a token share: it has a row (all absorbed), and nothing sees it.
inline float exposedFraction(const HitRows& rows, size_t patch) {
  return std::max(1e-6f, 1 - static_cast<float>(rows.buried[patch]) / static_cast<float>(rows.rays[patch]));
}

// The same rows with patch p renumbered to number[p].
HitRows renumber(const HitRows& rows, std::span<const uint32_t> number);

}  // namespace ff::bake
