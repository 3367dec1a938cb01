// Radiosity for those who look: what slots reflect, and what they emit. Of what a slot reflects its own counts by its weight; the rest
// is what its parent shows, as the same irradiance on the slot's albedo (runtime/cut/cut_fade.h).
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { ShinePush push; };
layout(std430, binding = 0) readonly buffer Reflected { vec4 reflected[]; };
layout(std430, binding = 1) readonly buffer Emission { vec4 emission[]; };
layout(std430, binding = 2) writeonly buffer Radiosity { vec4 radiosity[]; };
layout(std430, binding = 3) readonly buffer Weights { uvec2 weights[]; };  // fade.comp
layout(std430, binding = 4) readonly buffer Parents { uint parents[]; };
layout(std430, binding = 5) readonly buffer Albedo { vec4 albedo[]; };
layout(std430, binding = 6) readonly buffer Source { vec4 source[]; };
layout(std430, binding = 7) writeonly buffer LastSource { vec4 last_source[]; };

vec3 shown(uint slot) {
  vec3 sum = vec3(0), share = vec3(1);  // share: of what the slot at hand shows
  for (;;) {
    const float own = weights[slot].y == push.fades ? uintBitsToFloat(weights[slot].x) : 1.0;
    const uint parent = parents[slot];
    if (own == 1.0 || parent >= kFreeSlot) return sum + share * reflected[slot].rgb;
    const vec3 from = albedo[parent].rgb;
    const bvec3 dark = lessThanEqual(from, vec3(0));  // says nothing of irradiance
    sum += share * mix(vec3(own), vec3(1), dark) * reflected[slot].rgb;
    share *= mix((1.0 - own) * albedo[slot].rgb / from, vec3(0), dark);
    slot = parent;
  }
}

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  if (slot >= push.slots) return;
  const vec3 emitted = parents[slot] == kFreeSlot ? vec3(0) : emission[slot].rgb;  // that of a tile that has left stays there
  radiosity[slot] = vec4((push.fades != 0u ? shown(slot) : reflected[slot].rgb) + emitted, 0);
  if (push.stepped != 0u) last_source[slot] = vec4(source[slot].rgb, 0);
}
