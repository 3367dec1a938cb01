// Refined slots of one level: the area-weighted mean of their children. An invocation a slot of the finer level; the first
// of each family adds up.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kRefineGroup) in;
layout(push_constant) uniform Push { RefinePush push; };
layout(std430, binding = 0) readonly buffer Spans { SlotSpan spans[]; };
layout(std430, binding = 1) readonly buffer Parents { uint parents[]; };
layout(std430, binding = 2) readonly buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 3) buffer Radiosity { vec4 radiosity[]; };

void main() {
  const SlotSpan span = spans[push.first + gl_WorkGroupID.x / push.groups];
  const uint first = span.first_slot + gl_WorkGroupID.x % push.groups * kRefineGroup + gl_LocalInvocationID.x;
  const uint end = span.first_slot + span.slots;
  if (first >= end) return;
  const uint parent = parents[first];
  if (parent >= kFreeSlot || (first > span.first_slot && parents[first - 1u] == parent)) return;
  vec3 sum = vec3(0), plain = vec3(0);
  float area = 0;
  uint child = first;
  for (; child < end && parents[child] == parent; ++child) {
    sum += albedo[child].w * radiosity[child].rgb;
    plain += radiosity[child].rgb;
    area += albedo[child].w;
  }
  radiosity[parent] = vec4(area > 0 ? sum / area : plain / float(child - first), 0);
}
