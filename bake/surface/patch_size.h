// The size of patches, from how many there may be.
#pragma once
#include "bake/surface/patches.h"

namespace ff::bake {

// The spacing of the lattice through the origin that every corner of the scene lies on, m: 1 in a world of voxels of 1 m. 0:
// there is none, or it is finer than `finest_m`.
float latticeOf(const Scene& scene, float finest_m);

// Patches of the size (where the density is 1) that meets the budget within 10 %, found in four cuts at most. Where corners lie on a lattice, a size
// whose cells cut none of its squares comes first: 1.0 m for 60,000 patches of a town of voxels where the area asks for 0.999,
// which would leave a sliver beside every face. Errors: those of makePatches.
Result<PatchSet> patchesWithin(uint64_t budget, const Scene& scene, PatchSettings settings, const RayCaster& caster);

}  // namespace ff::bake
