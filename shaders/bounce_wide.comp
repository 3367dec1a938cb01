// The raw wide factor, four columns an invocation. Entering: V = F_PL C G (bounce_scatter.comp adds F_PL). Leaving: the
// rows of the matrix.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  const uint fours = push.used / 4u, groups = (fours + kBounceGroup - 1u) / kBounceGroup;
  const uint r = gl_WorkGroupID.x / groups;
  const uint four = gl_WorkGroupID.x % groups * kBounceGroup + gl_LocalInvocationID.x;
  if (four >= fours) return;
  vec4 sum = vec4(0);
  if (push.leaving != 0u) {
    sum = unpackFour(plane[placeOf(r) * (push.stride / 4u) + four]);
  } else {
    for (uint e = block[kBlockRowStart + r]; e < block[kBlockRowStart + r + 1u]; ++e) {
      const uint place = block[rowEntries() + 2u * e];
      if (indexOf(place) != kNotInBlock) continue;
      const float weight = albedoOf(place) * uintBitsToFloat(block[rowEntries() + 2u * e + 1u]);
      sum += weight * unpackFour(plane[place * (push.stride / 4u) + four]);
    }
  }
  panel_fours[rawAt(r, 0u) / 4u + four] = sum;
}
