// Refined slots of one level: the area-weighted mean of their children, which are consecutive slots.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kRefineGroup) in;
layout(push_constant) uniform Push { RefinePush push; };
layout(std430, binding = 0) readonly buffer Refined { RefinedSlot refined[]; };
layout(std430, binding = 1) readonly buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 2) buffer Radiosity { vec4 radiosity[]; };

void main() {
  if (gl_GlobalInvocationID.x >= push.count) return;
  const RefinedSlot r = refined[push.first + gl_GlobalInvocationID.x];
  vec3 sum = vec3(0);
  float area = 0;
  for (uint c = r.first_child; c < r.first_child + r.children; ++c) {
    sum += albedo[c].w * radiosity[c].rgb;
    area += albedo[c].w;
  }
  radiosity[r.slot] = vec4(area > 0 ? sum / area : vec3(0), 0);
}
