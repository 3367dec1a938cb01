// The sky as a source of light: a radiance over directions, and what nodes and probes get of it.
#pragma once
#include <array>
#include <cstddef>

#include "formats/model.h"

namespace ff::runtime {

// A sky of radiance L(w) = l0 + dot(l1, w) + sum of l2[k] P_k(w) per channel, W/(m2 sr): l1[c] is the gradient of channel c,
// l2[c] its quadratic part in the functions of skyQuadratics().
struct Sky {
  Vec3 l0;
  Vec3 l1[3];
  std::array<float, 5> l2[3]{};
};

// P_k(w) = {2xy, 2yz, 2zx, (3y^2 - 1) / 2, x^2 - z^2} of a unit direction, as in formats::Node::sky_quadratic.
inline std::array<float, 5> skyQuadratics(Vec3 w) {
  return {2 * w.x * w.y, 2 * w.y * w.z, 2 * w.z * w.x, (3 * w.y * w.y - 1) / 2, w.x * w.x - w.z * w.z};
}

// l0 + dot(l1, direction) + sum of l2[k] quadratics[k]: radiance, of means over directions likewise.
inline Vec3 skyRadiance(const Sky& sky, Vec3 direction, const std::array<float, 5>& quadratics) {
  Vec3 l;
  for (int c = 0; c < 3; ++c) {
    const std::array<float, 5>& q = sky.l2[c];
    l[c] = sky.l0[c] + dot(sky.l1[c], direction) +
           (q[0] * quadratics[0] + q[1] * quadratics[1] + q[2] * quadratics[2] + q[3] * quadratics[3] + q[4] * quadratics[4]);
  }
  return l;
}
inline Vec3 skyRadiance(const Sky& sky, Vec3 w) { return skyRadiance(sky, w, skyQuadratics(w)); }

// Irradiance of a node from the sky, W/m2.
inline Vec3 skyIrradiance(const Sky& sky, const formats::Node& node) {
  return (3.14159265358979f * node.sky_fraction) * skyRadiance(sky, node.sky_direction, node.sky_quadratic);
}

}  // namespace ff::runtime
