// Adds F_LP to the tall and F_PL to the raw wide factor, an entry an invocation (each element has one at most), and takes
// down the albedos of the block. count: entries of F_PL and F_PP, then those of F_LP up to the dispatch's end.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "bounce.glsl"

layout(local_size_x = kBounceGroup) in;

// The vector of a sparse list that entry e belongs to.
uint vectorOf(uint starts, uint e) {
  uint c = 0u;
  for (uint step = 32u; step > 0u; step /= 2u)
    if (c + step < push.k && block[starts + c + step] <= e) c += step;
  return c;
}

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i < push.k) {
    // One matrix for all: albedos of all channels and the mean; else those of its own.
    for (uint c = push.bound == 0u ? push.channel : 0u; c <= push.channel; ++c)
      albedo[(push.bound == 0u ? 0u : c) * push.stride + placeOf(i)] = push.leaving != 0u ? 0.0 : blockAlbedo(c, i);
  }
  if (push.leaving != 0u) return;
  if (i < push.count) {
    const uint place = block[rowEntries() + 2u * i];
    if (indexOf(place) == kNotInBlock)
      panels[rawAt(vectorOf(kBlockRowStart, i), place)] += uintBitsToFloat(block[rowEntries() + 2u * i + 1u]);
  } else if (i - push.count < block[kBlockColumnStart + push.k]) {
    const uint e = i - push.count, at = push.columns_at + 2u * e;
    panels[tallAt(vectorOf(kBlockColumnStart, e), block[at])] += uintBitsToFloat(block[at + 1u]);
  }
}
