// The world as the sun sees it: orthographic.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(push_constant) uniform Push { SunPush push; };
layout(location = 0) in vec3 position;
layout(location = 2) in uint patch_id;
layout(location = 0) flat out uint id;

void main() {
  id = patch_id;
  gl_Position = push.projection * vec4(position, 1);
}
