// How far the last step went: |B' - B|^2 summed over the leaves of each work group.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { ChangePush push; };
layout(std430, binding = 0) readonly buffer Before { vec4 before[]; };
layout(std430, binding = 1) readonly buffer After { vec4 after[]; };
layout(std430, binding = 2) readonly buffer Kinds { uint kinds[]; };
layout(std430, binding = 3) writeonly buffer Sums { float sums[]; };

shared float parts[kGatherGroup];

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  const bool leaf = slot < push.slots && kinds[slot] == kLeaf;
  const vec3 change = leaf ? after[slot].rgb - before[slot].rgb : vec3(0);
  const float part = subgroupAdd(dot(change, change));
  if (subgroupElect()) parts[gl_SubgroupID] = part;
  barrier();
  if (gl_LocalInvocationID.x != 0u) return;
  float sum = 0.0;
  for (uint s = 0u; s < gl_NumSubgroups; ++s) sum += parts[s];
  sums[gl_WorkGroupID.x] = sum;
}
