// Counts the texels in which the sun sees each patch.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kCountGroup) in;
layout(push_constant) uniform Push { CountPush push; };
layout(std430, binding = 0) readonly buffer Receivers { uint receivers[]; };  // patch + 1, 0: none
layout(std430, binding = 1) buffer Counts { uint counts[]; };

void main() {
  for (uint i = gl_GlobalInvocationID.x; i < push.texels; i += gl_NumWorkGroups.x * kCountGroup)
    if (receivers[i] != 0u) atomicAdd(counts[receivers[i] - 1u], 1u);
}
