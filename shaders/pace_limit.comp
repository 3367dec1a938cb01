// The limit on how much a slot's light follows in a frame, from what all tiles reflect. One work group.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { PacePush push; };
layout(std430, binding = 0) readonly buffer Pace { PaceFrame pace; };
layout(std430, binding = 1) readonly buffer Lights { PacedLight lights[]; };
layout(std430, binding = 2) buffer State { EaseState state; };

shared vec2 parts[kGatherGroup];

void main() {
  vec2 part = vec2(0);
  for (uint tile = gl_LocalInvocationID.x; tile < push.tiles; tile += kGatherGroup) part += vec2(lights[tile].light, lights[tile].area_m2);
  part = subgroupAdd(part);
  if (subgroupElect()) parts[gl_SubgroupID] = part;
  barrier();
  if (gl_LocalInvocationID.x != 0u) return;
  part = vec2(0);
  for (uint s = 0u; s < gl_NumSubgroups; ++s) part += parts[s];
  state.most = part.x > 0.0 ? pace.most_change * part.x / part.y : kNoLimit;
}
