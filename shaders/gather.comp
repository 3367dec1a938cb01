// One Jacobi iteration of B = M + albedo * F B over the leaf slots: a subgroup takes a row, its lanes take uvec4 of entries
// (column slot << kCountBits | count) side by side, and the subgroup adds up. Works for any subgroup size: lanes are counted, not assumed,
// because a subgroup may be only partly filled and gl_SubgroupSize is then too large.
// A step that goes further: `after` holds the values of two steps ago, and the step goes on from there, omega times as far
// (Chebyshev semi-iteration); no value falls below its source. A source that is no light counts as 0, a result that is
// none becomes its source, and either is added to `repaired`. What is held back of a slot's light stands beside its source.
// With HOLD: finds what is to be held back. `before` is what the last step came from, `after` what it came to: what rows that
// have changed since would have made else of it.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"
#include "sound.glsl"

layout(local_size_x = kGatherGroup) in;
layout(constant_id = 0) const bool kFurther = false;
layout(push_constant) uniform Push { GatherPush push; };
layout(std430, binding = 0) readonly buffer Rows { GatherRow rows[]; };
layout(std430, binding = 1) readonly buffer Entries { uvec4 entries[]; };
layout(std430, binding = 2) readonly buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 3) readonly buffer Source { vec4 source[]; };
layout(std430, binding = 4) readonly buffer Before { vec4 before[]; };
layout(std430, binding = 5) buffer After { vec4 after[]; };
layout(std430, binding = 6) readonly buffer Kinds { uint kinds[]; };
#ifdef HOLD
layout(std430, binding = 7) buffer Held { vec4 held[]; };  // w: frames until it is gone
layout(std430, binding = 8) readonly buffer LastSource { vec4 last_source[]; };  // of the last step; w: 1: entered since
#else
layout(std430, binding = 7) readonly buffer Held { vec4 held[]; };
layout(std430, binding = 8) buffer Faults { uint repaired; };
#endif

#ifdef HOLD
// It is so much now. What has grown takes its full time again; the rest goes on, and takes no longer than that.
vec4 heldBack(vec3 light, vec4 so_far) {
  if (!isSound(light)) return vec4(0);
  return vec4(light, largestOf(abs(light)) <= largestOf(abs(so_far.rgb)) * kHeldGrown ? min(so_far.w, float(push.frames)) : float(push.frames));
}
#endif

vec3 term(uint entry) { return float(entry & kCountMask) * before[entry >> kCountBits].rgb; }

void main() {
  const uint lanes = subgroupAdd(1u);
  const uint lane = subgroupExclusiveAdd(1u);
  uint unsound = 0u;
  for (uint slot = gl_WorkGroupID.x * gl_NumSubgroups + gl_SubgroupID; slot < push.slots;
       slot += gl_NumWorkGroups.x * gl_NumSubgroups) {
    if (kinds[slot] != kLeaf) {
#ifdef HOLD
      if (push.segment == 0u && lane == 0u) held[slot] = vec4(0);
#else  // a free one is 0 in both buffers: a light that has settled settles there, too
      if (kinds[slot] == kFree && push.segment == 0u && lane == 0u) after[slot] = vec4(0);
#endif
      continue;
    }
    const GatherRow row = rows[slot];
    if (row.segment != push.segment) continue;
    const uint vectors = (row.entries + kEntriesPerLoad - 1u) / kEntriesPerLoad;
    vec3 sum = vec3(0);
    for (uint v = lane; v < vectors; v += lanes) {
      const uvec4 e = entries[row.first + v];
      sum += (term(e.x) + term(e.y)) + (term(e.z) + term(e.w));
    }
    sum = subgroupAdd(sum);
    if (lane != 0u) continue;
#ifdef HOLD
    const vec3 last = last_source[slot].w == 0.0 ? last_source[slot].rgb : source[slot].rgb;
    held[slot] = heldBack(after[slot].rgb - (isSound(last) ? last : vec3(0)) - albedo[slot].rgb * (row.scale * sum), held[slot]);
#else
    const vec3 given = source[slot].rgb;
    const bool given_sound = isSound(given);
    const vec3 m = given_sound ? given : vec3(0);
    vec3 b = m + albedo[slot].rgb * (row.scale * sum);
    const vec4 back = held[slot];
    if (back.w > 0.0) b = max(b + back.rgb, vec3(0));
    if (kFurther) {
      const vec3 old = after[slot].rgb;
      b = max(m, old + push.omega * (b - old));
    }
    const bool sound = isSound(b);
    after[slot] = vec4(sound ? b : m, 0);
    unsound += uint(!given_sound) + uint(!sound);
#endif
  }
#ifndef HOLD
  if (unsound > 0u) atomicAdd(repaired, unsound);
#endif
}
