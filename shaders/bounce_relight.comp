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
      for (uint r = 0u; r < kBounceRows; ++r) {
        const vec4 g = unpackFour(plane[(row + r) * stride + f]);
        for (uint v = 0u; v < kVectors; ++v) sum[v][r] += dot(g, x[v]);
      }
    }
    if (push.pending != 0u)
      for (uint c = lane; c < push.k; c += lanes)
        for (uint v = 0u; v < kVectors; ++v) {
          const float weight = vectors[vectorsOf(v) + weightsAt() + c];
          for (uint r = 0u; r < kBounceRows; ++r) sum[v][r] += weight * panels[tallAt(c, row + r)];
        }
    for (uint v = 0u; v < kVectors; ++v) {
      const vec4 e = subgroupAdd(sum[v]);
      if (lane != 0u) continue;
      const uint at = vectorsOf(v);
      for (uint r = 0u; r < kBounceRows; ++r) {
        vectors[at + irradianceAt() + row + r] = e[r];
        if (push.next_at != 0u)
          vectors[at + push.next_at + row + r] =
              vectors[at + row + r] +
              (albedo[v * push.stride + row + r] - albedo[kBounceMean * push.stride + row + r]) * e[r];
      }
    }
  }
}
