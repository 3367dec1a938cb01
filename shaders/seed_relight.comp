// The seed, relighting: the irradiance is one product, a row a subgroup.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

void main() {
  const uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
  for (uint row = gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID; row < push.used;
       row += gl_NumWorkGroups.x * gl_NumSubgroups) {
    vec3 sum = vec3(0);
    for (uint j = lane; j < push.used; j += lanes)
      sum += unpackElement(matrix[row * push.stride + j]) * vectors[at(kSeedLight, j)].rgb;
    sum = subgroupAdd(sum);
    if (lane == 0u) vectors[at(kSeedIrradiance, row)] = vec4(sum, 0);
  }
}
