// Direct sunlight of every patch of a world: shadow rays against the world's own drawing geometry.
#pragma once
#include <vector>

#include "formats/read/whole_world.h"


namespace ff::chart {

// Irradiance per level-0 node, W/m2; irradiance: of a surface that faces the sun. 16 shadow rays a patch.
// Errors: unreadable geometry, Embree.
Result<std::vector<Vec3>> sunIrradiance(const formats::WholeWorld& world, Vec3 to_sun, Vec3 irradiance);

}  // namespace ff::chart
