// The lights of a world's file (formats::Light) on its patches: irradiance with shadows, by rays over the drawing triangles.
#pragma once
#include <span>
#include <vector>

#include "formats/model.h"
#include "tools/view/scene.h"

namespace ff::view {

// Irradiance at a point whose surface faces `normal` (unit), as if nothing stood in the way: FORMAT.md, section 2.8.
Vec3 unshadowedIrradiance(const formats::Light& light, Vec3 point, Vec3 normal);

// Mean irradiance of every patch, W/m2, over points spread evenly over its triangles, each with a ray to each light: a wall
// that a patch goes up to shades the part behind it. Only front faces receive, all faces block. The same whatever the
// threads.
std::vector<Vec3> irradianceFrom(std::span<const formats::Light> lights, const ViewScene& scene);

}  // namespace ff::view
