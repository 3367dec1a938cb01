// Small scenes made by hand: rectangles cut into square patches.
#pragma once
#include "tools/view/scene.h"

namespace ff::view {

// Adds a rectangle with corner `at` and edges u, v (its front is where cross(u, v) points), cut into nu x nv patches of two
// triangles. Returns the number of its first patch; patches go along u first.
inline uint32_t addSheet(ViewScene& scene, Vec3 at, Vec3 u, Vec3 v, int nu, int nv, Vec3 albedo = {0.5f, 0.5f, 0.5f},
                         Vec3 emission = {}) {
  const auto first = static_cast<uint32_t>(scene.patches.size());
  const Vec3 du = u / static_cast<float>(nu), dv = v / static_cast<float>(nv);
  for (int j = 0; j < nv; ++j)
    for (int i = 0; i < nu; ++i) {
      const Vec3 p = at + du * static_cast<float>(i) + dv * static_cast<float>(j);
      formats::Node n;
      n.area_m2 = length(cross(du, dv));
      n.centroid = p + du * 0.5f + dv * 0.5f;
      n.normal = normalized(cross(du, dv));
      n.albedo = albedo;
      n.emission = emission;
      n.quanta = 512;
      const auto patch = static_cast<uint32_t>(scene.patches.size());
      scene.patches.push_back(n);
      scene.lamps.push_back({});
      for (const Vec3 corner : {p, p + du, p + du + dv, p, p + du + dv, p + dv}) {
        scene.corners.push_back(corner);
        scene.bounds.add(corner);
      }
      scene.triangle_patch.insert(scene.triangle_patch.end(), 2, patch);
    }
  return first;
}

}  // namespace ff::view
