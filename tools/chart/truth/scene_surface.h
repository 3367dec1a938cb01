// What the path tracer reads off a scene's surface at a point: reflectance, emitted radiance, holes. Written apart from
// the baker's, from glTF 2.0's definitions, so that an error in one shows against the other.
#pragma once
#include "bake/scene.h"

namespace ff::chart {

struct SurfacePoint {
  Vec3 albedo;
  Vec3 radiance;  // emitted from the front, W/(m2 sr)
};

// u, v: barycentric weights of corners 1 and 2.
SurfacePoint surfaceAt(const bake::Scene& scene, uint32_t triangle, float u, float v);
// Whether a cutout lets light through there.
bool holeAt(const bake::Scene& scene, uint32_t triangle, float u, float v);

}  // namespace ff::chart
