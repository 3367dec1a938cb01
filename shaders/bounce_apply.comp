// The wide factor W from the raw one and the inverse, and the block's own rows of the matrix; four columns an invocation.
// Entering: rows = K [V S], W = C_P rows, and 1 in the block's own columns, which brings U itself there.
// Leaving: rows = 0, W = -C_P K G_P, and -1 in the block's own columns, which takes them away exactly.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  if ((status | corrupt) != 0u) return;
  const uint fours = push.used / 4u, groups = (fours + kBounceGroup - 1u) / kBounceGroup;
  const uint r = gl_WorkGroupID.x / groups;
  const uint four = gl_WorkGroupID.x % groups * kBounceGroup + gl_LocalInvocationID.x;
  if (four >= fours) return;
  vec4 row = vec4(0);
  for (uint q = 0u; q < push.k; ++q) row += panels[inverseAt(r, q)] * panel_fours[rawAt(q, 0u) / 4u + four];
  const float factor = blockAlbedo(push.channel, r);
  vec4 w = factor * row;
  for (uint i = 0u; i < 4u; ++i) {
    const uint own = indexOf(4u * four + i);
    if (push.leaving != 0u)
      w[i] = own == kNotInBlock ? -w[i] : own == r ? -1.0 : 0.0;
    else if (own == r)
      w[i] += 1.0;
  }
  panel_fours[wideAt(r, 0u) / 4u + four] = w;
  plane[placeOf(r) * (push.stride / 4u) + four] = packFour(push.leaving != 0u ? vec4(0) : row);
}
