// The seed, shader 2, equations (2): g_col = f_col rho double, g_row = f_row rho double.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i >= push.used) return;
  const vec3 back = colour() * vectors[at(kSeedDouble, 0u)].rgb;
  vectors[at(kSeedDoubleColumn, i)] = vec4(formColumn(i) * back, 0);
  vectors[at(kSeedDoubleRow, i)] = vec4(formRow(i) * back, 0);
}
