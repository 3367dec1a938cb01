// The tall factor. Entering: U = G C F_LP, a subgroup an element, its lanes take the entries of one sparse column side
// by side (bounce_scatter.comp adds F_LP itself). Leaving: the columns of the matrix, without those who leave.
#version 450
#define SCALAR
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  const uint row = gl_WorkGroupID.x;
  const bool leaves = indexOf(row) != kNotInBlock;
  if (push.leaving != 0u) {
    for (uint c = gl_LocalInvocationID.x; c < push.k; c += kBounceGroup)
      panels[tallAt(c, row)] = leaves ? 0.0 : matrixAt(row, placeOf(c));
    return;
  }
  for (uint c = gl_SubgroupID; c < push.k; c += gl_NumSubgroups) {
    float sum = 0.0;
    for (uint e = block[kBlockColumnStart + c] + lane; e < block[kBlockColumnStart + c + 1u]; e += lanes) {
      const uint place = block[push.columns_at + 2u * e];
      sum += matrixAt(row, place) * albedoOf(place) * uintBitsToFloat(block[push.columns_at + 2u * e + 1u]);
    }
    sum = subgroupAdd(sum);
    if (lane == 0u) panels[tallAt(c, row)] = sum;
  }
}
