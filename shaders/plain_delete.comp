// Plain local radiosity: rows and columns of the block become zero; an invocation an element.
#version 450
#define WORDS
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

void clearAt(uint row, uint column) {
  const uint e = row * push.stride + column;
#ifdef HALF
  atomicAnd(words[e >> 1], (e & 1u) == 0u ? 0xffff0000u : 0x0000ffffu);
#else
  words[e] = 0u;
#endif
}

void main() {
  const uint place = placeOf(gl_GlobalInvocationID.x / push.used), i = gl_GlobalInvocationID.x % push.used;
  if (gl_GlobalInvocationID.x >= push.k * push.used) return;
  clearAt(place, i);
  clearAt(i, place);
  if (i < 3u) albedo[i * push.stride + place] = 0.0;
}
