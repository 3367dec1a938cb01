// Radiosity of a surface: emission + albedo * (sun per pixel + interpolated irradiance); once with direct light only,
// once with all bounces, and the patch's difference to the full-world solve.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "shared.h"

layout(std430, binding = 0) readonly buffer Looks { PatchLook looks[]; };
layout(std430, binding = 2) readonly buffer Figures { PatchFigures figures[]; };
layout(std430, binding = 3) readonly buffer FrameBuffer { Frame frame; };
layout(binding = 4) uniform sampler2D shadow_near;
layout(binding = 5) uniform sampler2D shadow_far;
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 facing;
layout(location = 2) in vec3 direct;
layout(location = 3) in vec3 bounced;
layout(location = 4) flat in uint id;
layout(location = 0) out vec4 out_direct;
layout(location = 1) out vec4 out_bounced;
layout(location = 2) out float out_difference;

float lit(sampler2D map, ivec2 texel, float depth) { return texelFetch(map, texel, 0).r >= depth ? 1.0 : 0.0; }

// Percentage-closer filter: 4 x 4 comparisons under a bilinear tent. Reeves, Salesin, Cook. Rendering Antialiased
// Shadows with Depth Maps. 1987.
float filtered(sampler2D map, vec3 at) {
  const vec2 corner = floor(at.xy - 0.5);
  const vec2 f = at.xy - 0.5 - corner;
  const vec4 wx = vec4(1 - f.x, 1, 1, f.x), wy = vec4(1 - f.y, 1, 1, f.y);
  float sum = 0;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x)
      sum += wx[x] * wy[y] * lit(map, clamp(ivec2(corner) + ivec2(x - 1, y - 1), ivec2(0), ivec2(frame.size.z) - 1), at.z);
  return sum / 9;
}

// Near to what shades it a point passes for lit, by the maps' bias: a corner of a dark room would shine. So a patch of which the sun
// sees next to nothing has none: of one as large as a cell, more than rounding adds at the edge of what shades it, a texel or two of 1024.
const float kLeastLit = 1.0 / 128.0;

float sunlight(vec3 n) {
  const float cosine = dot(n, frame.sun_direction.xyz);
  if (cosine <= 0 || figures[id].sun_exposure < kLeastLit * cosine) return 0;
  for (uint m = 0; m < kShadowMaps; ++m) {
    // A texel's depth holds at its centre only: the point moves off the surface by the slope's share of the filter.
    const float slope = sqrt(max(0, 1 - cosine * cosine));
    const vec3 moved = place + n * (2.0 * slope * frame.shadow_texel_m[m]);
    const vec3 at = (frame.shadow[m] * vec4(moved, 1)).xyz - vec3(0, 0, frame.shadow_bias[m]);
    const bool inside = all(greaterThan(at.xy, vec2(3))) && all(lessThan(at.xy, vec2(frame.size.z - 3)));
    if (m + 1 < kShadowMaps && !inside) continue;
    return cosine * (m == 0 ? filtered(shadow_near, at) : filtered(shadow_far, at));
  }
  return 0;
}

void main() {
  const vec3 sun = any(greaterThan(frame.sun_irradiance.rgb, vec3(0)))
      ? sunlight(normalize(facing)) * frame.sun_irradiance.rgb : vec3(0);
  const vec3 albedo = looks[id].albedo.rgb, emission = looks[id].emission.rgb;
  out_direct = vec4(emission + albedo * (sun + direct), 1);
  out_bounced = vec4(emission + albedo * (sun + bounced), 1);
  out_difference = figures[id].difference;
}
