// The seed, shader 1, equation (1): double = f_row C f_col, by a reduction in one work group.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

shared vec3 part[kSeedGroup];

void main() {
  const uint t = gl_LocalInvocationID.x;
  vec3 sum = vec3(0);
  for (uint i = t; i < push.used; i += kSeedGroup)
    sum += formRow(i) * vectors[at(kSeedColour, i)].rgb * formColumn(i);
  part[t] = sum;
  barrier();
  for (uint width = kSeedGroup / 2u; width > 0u; width /= 2u) {
    if (t < width) part[t] += part[t + width];
    barrier();
  }
  if (t == 0u) vectors[at(kSeedDouble, 0u)] = vec4(part[0], 0);
}
