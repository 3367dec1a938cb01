// Finds surface that takes no part in the exchange of light.
//
// It is *sealed* when light gets neither in nor out: the inside of a closed tube or of a wall that is modelled from both sides,
// what lies inside another solid or behind a single-sided sheet, what another surface lies on, what is all hole. Without that, the least that
// leaks into a cavity with an albedo near 1 would fill it with light, and the few rays that get away from under a sheet
// would stand for all of them.
#pragma once
#include <cstdint>
#include <span>

#include "bake/rays/ray_caster.h"
#include "bake/rays/sobol.h"
#include "bake/scene.h"
#include "bake/surface/fences.h"

namespace ff::bake {

// Whether an origin whose ray ended on the back of a single-sided surface lies inside a solid: so do four more rays around its
// normal.
bool isBuried(const RayCaster& caster, Vec3 origin, Vec3 normal);

class SealedSurface {
 public:
  // All of them outlive this.
  SealedSurface(const Scene& scene, float cell_m, const RayCaster& caster, const Fences& fences)
      : scene_(scene), caster_(caster), fences_(fences), cell_m_(cell_m) {}
  // Whether connected surface is sealed, from a few rays; more where it is not clear at once. Thread-safe.
  bool isSealed(std::span<const PieceSide> surface) const;

 private:
  static constexpr uint32_t kMaxProbes = 32;
  bool getsOut(Ray ray, uint64_t seed) const;

  const Scene& scene_;
  const RayCaster& caster_;
  const Fences& fences_;
  float cell_m_;
  SobolTable points_{kMaxProbes};
};

}  // namespace ff::bake
