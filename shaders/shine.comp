// Radiosity for those who look: what slots reflect, and what they emit.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { ShinePush push; };
layout(std430, binding = 0) readonly buffer Reflected { vec4 reflected[]; };
layout(std430, binding = 1) readonly buffer Emission { vec4 emission[]; };
layout(std430, binding = 2) writeonly buffer Radiosity { vec4 radiosity[]; };

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  if (slot < push.slots) radiosity[slot] = vec4(reflected[slot].rgb + emission[slot].rgb, 0);
}
