// How much of what a slot shows is its own, tile by tile of those that fade out (runtime/cut/cut_fade.h), for shine.comp.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { FadePush push; };
layout(std430, binding = 0) readonly buffer Fading { FadingSlots fading[]; };
layout(std430, binding = 1) writeonly buffer Weights { uvec2 weights[]; };  // a float's bits; the record that it counts for

void main() {
  const FadingSlots tile = fading[gl_WorkGroupID.x];
  for (uint i = gl_LocalInvocationID.x; i < tile.slots; i += kGatherGroup)
    weights[tile.first_slot + i] = uvec2(floatBitsToUint(tile.own), push.record);
}
