// The seed, shader 3, equations (3) and (4): the new column F_local C (f_col + g_col) + g_col + f_col, a row a subgroup.
// (C and f are missing in print; without them no path would reach the new patch over two others.)
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
      sum += unpackElement(matrix[row * push.stride + j]) * vectors[at(kSeedColour, j)].rgb *
             (formColumn(j) + vectors[at(kSeedDoubleColumn, j)].rgb);
    sum = subgroupAdd(sum);
    if (lane == 0u)
      vectors[at(kSeedColumn, row)] = vec4(sum + vectors[at(kSeedDoubleColumn, row)].rgb + formColumn(row), 0);
  }
}
