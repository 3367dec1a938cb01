// A frame passes: what is held back of slots' light goes, evenly.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { EasePush push; };
layout(std430, binding = 0) buffer Held { vec4 held[]; };  // w: frames until it is gone

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  if (slot >= push.slots) return;
  const vec4 h = held[slot];
  held[slot] = h.w > 1.0 ? vec4(h.rgb * ((h.w - 1.0) / h.w), h.w - 1.0) : vec4(0);
}
