// Refined slots of one level: the area-weighted mean of their children. An invocation a slot of the finer level; the last
// child of each parent adds up.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kRefineGroup) in;
layout(push_constant) uniform Push { RefinePush push; };
layout(std430, binding = 0) readonly buffer Spans { SlotSpan spans[]; };
layout(std430, binding = 1) readonly buffer Parents { uint parents[]; };
layout(std430, binding = 2) readonly buffer Siblings { uint siblings[]; };  // the next; the first one after the last
layout(std430, binding = 3) readonly buffer Albedo { vec4 albedo[]; };  // w: area, m2
layout(std430, binding = 4) buffer Radiosity { vec4 radiosity[]; };

void main() {
  const SlotSpan span = spans[push.first + gl_WorkGroupID.x / push.groups];
  const uint slot = span.first_slot + gl_WorkGroupID.x % push.groups * kRefineGroup + gl_LocalInvocationID.x;
  if (slot >= span.first_slot + span.slots) return;
  const uint parent = parents[slot];
  if (parent >= kFreeSlot || siblings[slot] > slot) return;
  vec3 sum = vec3(0), plain = vec3(0);
  float area = 0, children = 0;
  uint child = slot;
  do {
    child = siblings[child];
    sum += albedo[child].w * radiosity[child].rgb;
    plain += radiosity[child].rgb;
    area += albedo[child].w;
    children += 1;
  } while (child < slot);
  radiosity[parent] = vec4(area > 0 ? sum / area : plain / children, 0);
}
