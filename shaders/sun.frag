// Front faces leave their patch's number + 1, back faces block and leave 0. A surface with a patch on each side is two
// coincident faces: the back one is moved a little away from the sun, so that the front one always wins.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(push_constant) uniform Push { SunPush push; };
layout(location = 0) flat in uint id;
layout(location = 0) out uint receiver;

void main() {
  receiver = gl_FrontFacing ? id + 1u : 0u;
  gl_FragDepth = gl_FragCoord.z + (gl_FrontFacing ? 0.0 : push.back_face_depth);
}
