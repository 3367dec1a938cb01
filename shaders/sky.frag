// The sky that lights the world, as the radiosity of a surface of the same radiance, and the sun's disc in it.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(std430, binding = 3) readonly buffer FrameBuffer { Frame frame; };
layout(location = 0) in vec2 at;
layout(location = 0) out vec4 out_direct;
layout(location = 1) out vec4 out_bounced;
layout(location = 2) out float out_difference;

void main() {
  const vec3 w = normalize(frame.look_z.xyz + at.x * frame.look_x.xyz + at.y * frame.look_y.xyz);
  vec3 l = frame.sky_l0.rgb +
           vec3(dot(frame.sky_l1[0].xyz, w), dot(frame.sky_l1[1].xyz, w), dot(frame.sky_l1[2].xyz, w));
  l += frame.sky_l2[0].rgb * (2 * w.x * w.y) + frame.sky_l2[1].rgb * (2 * w.y * w.z) + frame.sky_l2[2].rgb * (2 * w.z * w.x) +
       frame.sky_l2[3].rgb * ((3 * w.y * w.y - 1) / 2) + frame.sky_l2[4].rgb * (w.x * w.x - w.z * w.z);
  l = 3.14159265 * max(l, vec3(0));
  // Half a degree wide, as the sun is, with a soft edge; brighter than any surface that it lights.
  const float disc = smoothstep(0.99996, 0.99999, dot(w, frame.sun_direction.xyz));
  out_direct = out_bounced = vec4(l + disc * 20.0 * frame.sun_irradiance.rgb, 0);  // alpha 0: no surface
  out_difference = -1;
}
