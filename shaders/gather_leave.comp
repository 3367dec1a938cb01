// Tiles that left: their slots are free.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { JobPush push; };
layout(std430, binding = 0) readonly buffer Jobs { TileJob jobs[]; };
layout(std430, binding = 1) buffer Parents { uint parents[]; };

void main() {
  const TileJob job = jobs[push.first + gl_WorkGroupID.x / push.groups];
  const uint node = gl_WorkGroupID.x % push.groups * kGatherGroup + gl_LocalInvocationID.x;
  if (node < job.nodes) parents[job.first_slot + node] = kFreeSlot;
}
