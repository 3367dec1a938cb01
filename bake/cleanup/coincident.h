// Surface that a scene holds twice: exporters instance a mesh twice at one place, modellers paste on top of what they copied.
// It would count twice, in area and in light, and rays would hit either at random.
#pragma once
#include <cstdint>
#include <vector>

#include "bake/scene.h"

namespace ff::bake {

// Of each triangle, whether another stands for it: the same corners within rounding, in any order that faces the same way (any
// at all where both are double-sided); or, with a neighbour that follows it, the same quad split along its other diagonal. Of those that coincide an emitter stays, then the
// brightest, then the first: whatever the order of meshes the same light stays. Where one has holes both must be of one material. Linear in the number of
// triangles, however many coincide.
std::vector<bool> findDuplicates(const Scene& scene);

}  // namespace ff::bake
