#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(std430, binding = 1) readonly buffer Vertices { Light vertices[]; };
layout(std430, binding = 3) readonly buffer FrameBuffer { Frame frame; };
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in uint patch_id;
layout(location = 3) in uint vertex_id;
layout(location = 0) out vec3 place;
layout(location = 1) out vec3 facing;
layout(location = 2) out vec3 direct;
layout(location = 3) out vec3 bounced;
layout(location = 4) flat out uint id;

void main() {
  place = position;
  facing = normal;
  direct = vertices[vertex_id].direct.rgb;
  bounced = vertices[vertex_id].bounced.rgb;
  id = patch_id;
  gl_Position = frame.view_projection * vec4(position, 1);
}
