// Irradiance of the drawing vertices from the patches around them.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(local_size_x = kInterpolateGroup) in;
layout(push_constant) uniform Push { InterpolatePush push; };
layout(std430, binding = 0) readonly buffer Tables { Interpolation tables[]; };  // from vertex push.first
layout(std430, binding = 1) readonly buffer Reflected { vec4 reflected[]; };  // by patch: what arrives from surfaces
layout(std430, binding = 2) readonly buffer Looks { PatchLook looks[]; };
layout(std430, binding = 3) buffer Vertices { Light vertices[]; };

void main() {
  if (gl_GlobalInvocationID.x >= push.count) return;
  Light sum = Light(vec4(0), vec4(0));
  for (uint i = 0; i < kInterpolated; ++i) {
    const float w = tables[gl_GlobalInvocationID.x].weights[i];
    if (w == 0) continue;
    const uint p = tables[gl_GlobalInvocationID.x].patches[i];
    sum.direct += w * looks[p].direct;
    sum.bounced += w * (looks[p].direct + reflected[p]);
  }
  vertices[push.first + gl_GlobalInvocationID.x] = sum;
}
