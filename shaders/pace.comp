// How fast what is held back of a tile's light may go, by where observers are, and what its leaves reflect, of which the limit is a share: LightPace::of()
// (runtime/solver/light_pace.h). A work group a tile.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(std430, binding = 0) readonly buffer Spans { SlotSpan spans[]; };
layout(std430, binding = 1) readonly buffer Packed { uint packed_words[]; };
layout(std430, binding = 2) readonly buffer Pace { PaceFrame pace; };
layout(std430, binding = 3) readonly buffer Kinds { uint kinds[]; };
layout(std430, binding = 4) readonly buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 5) readonly buffer Radiosity { vec4 radiosity[]; };
layout(std430, binding = 6) writeonly buffer Paces { TilePace paces[]; };  // by slot
layout(std430, binding = 7) writeonly buffer Lights { PacedLight lights[]; };  // by tile

const float kNever = 1e30;  // frames

shared vec2 parts[kGatherGroup];

vec3 corner(uint at) { return vec3(uintBitsToFloat(packed_words[at]), uintBitsToFloat(packed_words[at + 1u]), uintBitsToFloat(packed_words[at + 2u])); }
// By the observer's straight way.
float framesUntilAtHand(vec3 lowest, vec3 highest, uint observer) {
  const vec3 to_lowest = (lowest - pace.at_hand_m - pace.at[observer].xyz) / pace.way[observer].xyz, to_highest = (highest + pace.at_hand_m - pace.at[observer].xyz) / pace.way[observer].xyz;
  const vec3 first = min(to_lowest, to_highest), last = max(to_lowest, to_highest);
  const float begins = max(0.0, max(first.x, max(first.y, first.z))), ends = min(last.x, min(last.y, last.z));
  return begins <= ends ? begins : kNever;
}
float distanceTo(vec3 lowest, vec3 highest, vec3 at) { return length(max(max(lowest - at, at - highest), vec3(0))); }

TilePace paceOf(uint place_at) {
  const vec3 lowest = corner(place_at), highest = corner(place_at + 3u);
  const uint level = packed_words[place_at + 6u];
  float away_m = distanceTo(lowest, highest, pace.at[0].xyz), frames = framesUntilAtHand(lowest, highest, 0u);
  for (uint i = 1u; i < pace.observers; ++i) {
    away_m = min(away_m, distanceTo(lowest, highest, pace.at[i].xyz));
    frames = min(frames, framesUntilAtHand(lowest, highest, i));
  }
  const float beyond = max(1.0, max(away_m, level > 0u ? pace.radii_m[level - 1u] : 0.0) / pace.near_m);
  return TilePace(beyond * beyond * beyond, level > 0u ? 0.0 : 1.0 / max(frames, pace.fewest_frames));
}

void main() {
  const SlotSpan tile = spans[gl_WorkGroupID.x];
  const TilePace tile_pace = paceOf(tile.place_at);
  vec2 part = vec2(0);  // light, area
  for (uint slot = tile.first_slot + gl_LocalInvocationID.x; slot < tile.first_slot + tile.slots; slot += kGatherGroup) {
    paces[slot] = tile_pace;
    if (kinds[slot] != kLeaf) continue;
    const vec3 b = radiosity[slot].rgb;
    part += albedo[slot].w * vec2((b.r + b.g + b.b) / 3.0, 1);
  }
  part = subgroupAdd(part);
  if (subgroupElect()) parts[gl_SubgroupID] = part;
  barrier();
  if (gl_LocalInvocationID.x != 0u) return;
  part = vec2(0);
  for (uint s = 0u; s < gl_NumSubgroups; ++s) part += parts[s];
  part /= tile_pace.loosened * tile_pace.loosened;  // the mean is over surfaces, of which near ones count most
  lights[gl_WorkGroupID.x] = PacedLight(part.x, part.y);
}
