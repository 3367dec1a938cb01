// Plain local radiosity: the block's form factors enter the matrix as they are, an entry an invocation. Their elements
// are zero before; two fp16 share a word, hence the atomic. count: entries of F_PL and F_PP.
#version 450
#define WORDS
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

uint vectorOf(uint starts, uint e) {
  uint c = 0u;
  for (uint step = 32u; step > 0u; step /= 2u)
    if (c + step < push.k && block[starts + c + step] <= e) c += step;
  return c;
}

void put(uint row, uint column, float value) {
  const uint e = row * push.stride + column;
#ifdef HALF
  atomicOr(words[e >> 1], halfBits(value * kHalfMatrixScale) << ((e & 1u) * 16u));
#else
  words[e] = floatBitsToUint(value);
#endif
}

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i < push.k)
    for (uint c = 0u; c < 3u; ++c) albedo[c * push.stride + placeOf(i)] = blockAlbedo(c, i);
  if (i < push.count) {
    const uint at = rowEntries() + 2u * i;
    put(placeOf(vectorOf(kBlockRowStart, i)), block[at], uintBitsToFloat(block[at + 1u]));
  } else if (i - push.count < block[kBlockColumnStart + push.k]) {
    const uint e = i - push.count, at = push.columns_at + 2u * e;
    put(block[at], placeOf(vectorOf(kBlockColumnStart, e)), uintBitsToFloat(block[at + 1u]));
  }
}
