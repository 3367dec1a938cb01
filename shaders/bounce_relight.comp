// E = G x: kBounceRows rows a subgroup, lanes take four columns of each side by side. What of the last update is not yet
// folded in is added through its factors: E += tall * (wide x), with wide x from bounce_pending.comp.
// LUMINANCE: three vectors at once; a channel's own matrix obeys G_c = G + G (C_c - C) G_c, so what is multiplied next
// is M + (C_c - C) E.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

#ifdef LUMINANCE
const uint kVectors = 3u;
#else
const uint kVectors = 1u;
#endif

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  const uint fours = push.used / 4u, stride = push.stride / 4u;
  for (uint row = (gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID) * kBounceRows; row < push.used;
       row += gl_NumWorkGroups.x * gl_NumSubgroups * kBounceRows) {
    vec4 sum[kVectors];
    for (uint v = 0u; v < kVectors; ++v) sum[v] = vec4(0);
    for (uint f = lane; f < fours; f += lanes) {
      vec4 x[kVectors];
      for (uint v = 0u; v < kVectors; ++v)
        x[v] = vector_fours[(vectorsOf(v) + push.x_at) / 4u + f];
      // The four rows written out: sums stay in registers whatever the compiler unrolls.
      const vec4 g0 = unpackFour(plane[row * stride + f]), g1 = unpackFour(plane[(row + 1u) * stride + f]),
                 g2 = unpackFour(plane[(row + 2u) * stride + f]), g3 = unpackFour(plane[(row + 3u) * stride + f]);
      sum[0] += vec4(dot(g0, x[0]), dot(g1, x[0]), dot(g2, x[0]), dot(g3, x[0]));
#ifdef LUMINANCE
      sum[1] += vec4(dot(g0, x[1]), dot(g1, x[1]), dot(g2, x[1]), dot(g3, x[1]));
      sum[2] += vec4(dot(g0, x[2]), dot(g1, x[2]), dot(g2, x[2]), dot(g3, x[2]));
#endif
    }
    if (push.pending != 0u)
      for (uint c = lane; c < push.k; c += lanes)
        for (uint v = 0u; v < kVectors; ++v) {
          const float weight = vectors[vectorsOf(v) + weightsAt() + c];
          sum[v] += weight * panel_fours[tallAt(c, row) / 4u];
        }
    for (uint v = 0u; v < kVectors; ++v) {
      const vec4 e = subgroupAdd(sum[v]);
      const uint at = vectorsOf(v);
      for (uint r = 0u; r < kBounceRows && lane == 0u; ++r) {
        vectors[at + irradianceAt() + row + r] = e[r];
        if (push.next_at != 0u)
          vectors[at + push.next_at + row + r] =
              vectors[at + row + r] +
              (albedo[v * push.stride + row + r] - albedo[kBounceMean * push.stride + row + r]) * e[r];
      }
    }
  }
}
