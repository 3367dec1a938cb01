// After the rows' part of a recorded step, B' = M + C F B: what it changed, r = B' - B, goes to the vectors of the dense
// product by place; and sums over the leaves, a work group each, say how far B was from its equation and whether M is
// another one than at the last frame.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"
#include "sound.glsl"

layout(local_size_x = kBounceGroup) in;
layout(push_constant) uniform Push { CorrectPush push; };
layout(std430, binding = 0) readonly buffer Slots { uint slot_of_place[]; };
layout(std430, binding = 1) readonly buffer Before { vec4 before[]; };
layout(std430, binding = 2) readonly buffer After { vec4 after[]; };
layout(std430, binding = 3) readonly buffer Source { vec4 source[]; };
layout(std430, binding = 4) buffer LastSource { vec4 last_source[]; };
layout(std430, binding = 5) readonly buffer Kinds { uint kinds[]; };
layout(std430, binding = 6) writeonly buffer Vectors { float vectors[]; };
layout(std430, binding = 7) buffer Sums { StepSums sums[]; };

shared vec4 parts[kBounceGroup];
shared uint relit_parts[kBounceGroup];

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i < push.stride) {
    const uint slot = slot_of_place[i];
    const vec3 r = slot != kTopSlot ? after[slot].rgb - before[slot].rgb : vec3(0);
    for (uint c = 0u; c < 3u; ++c) vectors[c * (4u * push.stride + kBounceBlock) + i] = r[c];
  }
  vec4 part = vec4(0);  // sums of squares, largest values
  uint relit = 0u;
  if (i < push.slots && kinds[i] == kLeaf) {
    const vec3 m = isSound(source[i].rgb) ? source[i].rgb : vec3(0), b = after[i].rgb, left = b - before[i].rgb;
    part = vec4(dot(left, left), dot(b - m, b - m), largestOf(abs(left)), largestOf(b));
    relit = any(notEqual(m, last_source[i].rgb)) ? 1u : 0u;
    last_source[i] = vec4(m, 0);
  }
  part = vec4(subgroupAdd(part.xy), subgroupMax(part.zw));
  relit = subgroupMax(relit);
  if (subgroupElect()) {
    parts[gl_SubgroupID] = part;
    relit_parts[gl_SubgroupID] = relit;
  }
  barrier();
  if (gl_LocalInvocationID.x != 0u) return;
  for (uint s = 1u; s < gl_NumSubgroups; ++s) {
    parts[0] = vec4(parts[0].xy + parts[s].xy, max(parts[0].zw, parts[s].zw));
    relit_parts[0] = max(relit_parts[0], relit_parts[s]);
  }
  const uint group = gl_WorkGroupID.x, before_this = push.first != 0u ? 0u : sums[group].relit;
  sums[group] = StepSums(parts[0].x, parts[0].y, parts[0].z, parts[0].w, max(relit_parts[0], before_this));
}
