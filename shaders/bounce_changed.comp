// E = G[:, places] difference, a row a subgroup: only some lights have changed. The block's buffer holds `count` places, and
// the differences are in the vector that is multiplied.
#version 450
#define SCALAR
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  for (uint row = gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID; row < push.used;
       row += gl_NumWorkGroups.x * gl_NumSubgroups) {
    const uint at = vectorsOf(0u);
    float sum = 0.0;
    for (uint i = lane; i < push.count; i += lanes)
      sum += matrixAt(row, block[i]) * vectors[at + push.x_at + block[i]];
    if (push.pending != 0u)
      for (uint c = lane; c < push.k; c += lanes) sum += vectors[at + weightsAt() + c] * panels[tallAt(c, row)];
    sum = subgroupAdd(sum);
    if (lane == 0u) vectors[at + irradianceAt() + row] = sum;
  }
}
