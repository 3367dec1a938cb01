// The seed, shader 4, equations (3) and (4): the new row (f_row + g_row) C F_local + g_row + f_row. A work group takes 16
// columns; its 8 lanes down take rows in turn.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

shared vec3 part[kSeedGroup];

void main() {
  const uint t = gl_LocalInvocationID.x, column = gl_WorkGroupID.x * kSeedColumns + t % kSeedColumns;
  vec3 sum = vec3(0);
  if (column < push.used)
    for (uint i = t / kSeedColumns; i < push.used; i += kSeedGroup / kSeedColumns)
      sum += (formRow(i) + vectors[at(kSeedDoubleRow, i)].rgb) * vectors[at(kSeedColour, i)].rgb *
             unpackElement(matrix[i * push.stride + column]);
  part[t] = sum;
  barrier();
  for (uint width = kSeedGroup / 2u; width >= kSeedColumns; width /= 2u) {
    if (t < width) part[t] += part[t + width];
    barrier();
  }
  if (t < kSeedColumns && column < push.used)
    vectors[at(kSeedRow, column)] = vec4(part[t] + vectors[at(kSeedDoubleRow, column)].rgb + formRow(column), 0);
}
