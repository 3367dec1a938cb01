// The seed, shader 6: the new patch's column and row are written to the matrix, the double reflection to the diagonal.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "seed.glsl"

layout(local_size_x = kSeedGroup) in;

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i >= push.used) return;
  if (i == push.place) {
    matrix[i * push.stride + i] = packElement(vectors[at(kSeedDouble, 0u)].rgb);
    vectors[at(kSeedColour, i)] = vec4(colour(), 0);
    return;
  }
  matrix[i * push.stride + push.place] = packElement(vectors[at(kSeedColumn, i)].rgb);
  matrix[push.place * push.stride + i] = packElement(vectors[at(kSeedRow, i)].rgb);
}
