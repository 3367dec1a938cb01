// The seed, shader 5, equation (5): F_local += column rho row (rho is missing in print). A work group takes 128 columns of
// 8 rows.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

void main() {
  const uint across = (push.used + kSeedGroup - 1u) / kSeedGroup;
  const uint column = gl_WorkGroupID.x % across * kSeedGroup + gl_LocalInvocationID.x;
  if (column >= push.used) return;
  const vec3 row = colour() * vectors[at(kSeedRow, column)].rgb;
  const uint first = gl_WorkGroupID.x / across * kSeedRows;
  for (uint i = first; i < min(first + kSeedRows, push.used); ++i) {
    const uint e = i * push.stride + column;
    matrix[e] = packElement(unpackElement(matrix[e]) + vectors[at(kSeedColumn, i)].rgb * row);
  }
}
