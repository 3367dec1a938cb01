// A frame passes: what is held back of slots' light goes, evenly. Where all bounces follow in one step, light goes along, so that the step finds what
// bounces of it.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { EasePush push; };
layout(std430, binding = 0) buffer Held { vec4 held[]; };  // w: frames until it is gone
layout(std430, binding = 1) buffer Radiosity { vec4 radiosity[]; };

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  if (slot >= push.slots) return;
  const vec4 h = held[slot], stays = h.w > 1.0 ? vec4(h.rgb * ((h.w - 1.0) / h.w), h.w - 1.0) : vec4(0);
  held[slot] = stays;
  if (push.along != 0u && h.w > 0.0) radiosity[slot] = vec4(max(radiosity[slot].rgb + (stays.rgb - h.rgb), vec3(0)), 0);
}
