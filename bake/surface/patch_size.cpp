#include "bake/surface/patch_size.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"

namespace ff::bake {
namespace {

constexpr float kOffLattice = 1e-3f;  // of a lattice's spacing

// A multiple or a whole part of the spacing.
double alignedWith(float lattice, double cell) {
  const double parts = cell / static_cast<double>(lattice);
  return static_cast<double>(lattice) * (parts >= 1 ? std::round(parts) : 1 / std::round(1 / parts));
}

}  // namespace

float latticeOf(const Scene& scene, float finest_m) {
  PagedVector<float> at;
  at.reserve(3 * scene.positions.size());
  std::vector<bool> used(scene.positions.size());  // what was left out has no say
  for (const Triangle& t : scene.triangles)
    for (const uint32_t v : t.v) used[v] = true;
  for (size_t i = 0; i < used.size(); ++i)
    for (int a = 0; a < 3; ++a)
      if (used[i]) at.push_back(std::abs(scene.positions[i][a]));
  std::sort(at.begin(), at.end());
  at.erase(std::unique(at.begin(), at.end()), at.end());
  float spacing = at.empty() ? 0 : at.back();
  for (size_t i = 1; i < at.size(); ++i)
    if (const float gap = at[i] - at[i - 1]; gap > kOffLattice * finest_m) spacing = std::min(spacing, gap);
  if (!(spacing >= finest_m)) return 0;
  const bool all = std::all_of(at.begin(), at.end(), [&](float x) {
    return std::abs(x - spacing * std::round(x / spacing)) <= kOffLattice * spacing;
  });
  return all ? spacing : 0;
}

Result<PatchSet> patchesWithin(uint64_t budget, const Scene& scene, PatchSettings settings, const RayCaster& caster) {
  double area = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const Material& material = scene.materials[scene.triangles[t].material];
    area += static_cast<double>(triangleArea(scene, t)) * (material.double_sided ? 2 : 1) / faceCells(finenessOf(material.density));
  }
  double cell = std::sqrt(area / static_cast<double>(budget));
  const float lattice = latticeOf(scene, static_cast<float>(cell / 8));
  if (lattice > 0) cell = alignedWith(lattice, cell);
  bool look = false;  // for what is enclosed: takes longer, so only when the size is about right
  for (int attempt = 0;; ++attempt) {
    settings.cell_m = static_cast<float>(cell);
    auto set = makePatches(scene, settings, look ? &caster : nullptr);
    if (!set) return set;
    const double ratio = static_cast<double>(set->patches.size()) / static_cast<double>(budget);
    const bool met = ratio < 1.1 && ratio > 0.9;
    if (look && (met || attempt >= 3)) return set;
    look = met || attempt >= 2;
    if (!met || lattice == 0) cell *= std::sqrt(ratio);
  }
}

}  // namespace ff::bake
