// A frame passes: what is held back of slots' light goes, evenly, but for what would be too much in a frame (HeldLight::Slot::release, runtime/solver/held_light.h).
// Where all bounces follow in one step, light goes along, so that the step finds what bounces of it.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"
#include "sound.glsl"

layout(local_size_x = kGatherGroup) in;
layout(push_constant) uniform Push { EasePush push; };
layout(std430, binding = 0) buffer Held { vec4 held[]; };  // w: frames until it is gone
layout(std430, binding = 1) buffer Radiosity { vec4 radiosity[]; };
layout(std430, binding = 2) readonly buffer Paces { TilePace paces[]; };  // by slot
layout(std430, binding = 3) buffer State { EaseState state; };

vec4 released(vec4 h, uint slot) {
  h.w = min(h.w, float(push.frames));
  const float stays = h.w > 1.0 ? (h.w - 1.0) / h.w : 0.0;
  if (push.most_change > 0.0) {
    const TilePace pace = paces[slot];
    const float now = largestOf(abs(h.rgb)), own = push.most_change * (pace.loosened - 1.0) * largestOf(abs(radiosity[slot].rgb));
    const float most = max(state.most * pace.loosened + own, pace.due * now);
    if ((1.0 - stays) * now > most) return vec4(h.rgb * (1.0 - most / now), max(h.w - 1.0, 1.0));
  }
  return vec4(h.rgb * stays, max(h.w - 1.0, 0.0));
}

void main() {
  const uint slot = gl_GlobalInvocationID.x;
  const vec4 h = slot < push.slots ? held[slot] : vec4(0);
  vec4 stay = vec4(0);
  if (h.w > 0.0) {
    held[slot] = stay = released(h, slot);
    if (push.along != 0u) radiosity[slot] = vec4(max(radiosity[slot].rgb + (stay.rgb - h.rgb), vec3(0)), 0);
  }
  if (subgroupMax(stay.w) > 0.0 && subgroupElect()) atomicMax(state.last_holding, push.record);
}
