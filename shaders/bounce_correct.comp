// The dense part of a recorded step: B' + C G r at leaves that have places. A matrix that is corrupt adds nothing, and one
// whose product is no light is.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "sound.glsl"

layout(local_size_x = kBounceGroup) in;
layout(push_constant) uniform Push { CorrectPush push; };
layout(std430, binding = 0) readonly buffer Slots { uint slot_of_place[]; };
layout(std430, binding = 1) readonly buffer Vectors { float vectors[]; };
layout(std430, binding = 2) readonly buffer Albedo { vec4 albedo[]; };
layout(std430, binding = 3) buffer Radiosity { vec4 radiosity[]; };
layout(std430, binding = 4) buffer Status { uint status, corrupt; };

void main() {
  const uint place = gl_GlobalInvocationID.x;
  if (place >= push.stride || corrupt != 0u) return;
  const uint slot = slot_of_place[place];
  if (slot == kTopSlot) return;
  vec3 e;
  for (uint c = 0u; c < 3u; ++c) e[c] = vectors[c * (4u * push.stride + kBounceBlock) + 3u * push.stride + place];
  if (!isSound(e)) {
    atomicMax(corrupt, kSpoiltNotFinite);
    return;
  }
  radiosity[slot] = vec4(radiosity[slot].rgb + albedo[slot].rgb * e, 0);
}
