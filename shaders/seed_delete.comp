// The seed, removal: "zeroing the row and column of the matrix of form-factors corresponding to the deleted patch".
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i >= push.used) return;
  matrix[i * push.stride + push.place] = uvec2(0);
  matrix[push.place * push.stride + i] = uvec2(0);
  if (i == push.place) vectors[at(kSeedColour, i)] = vec4(0);
}
