// Constants and structs that C++ and GLSL share; both compilers read this file, so a layout is written down once.
// Only 4-byte scalars and vec4/mat4 (16-byte aligned members): std430, push constants and C++ then agree byte for byte.
#ifndef FF_SHADERS_SHARED_H_
#define FF_SHADERS_SHARED_H_

#ifdef __cplusplus
#include <cstdint>
namespace ff::shaders {
using uint = uint32_t;
struct alignas(16) vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};
struct alignas(16) mat4 {
  float m[16] = {};  // column-major
};
#define FF_CONST inline constexpr
#else
#define FF_CONST const
#endif

// --- gather.comp, refine.comp ---
FF_CONST uint kGatherGroup = 64u;       // invocations of a work group: 64 / subgroup size rows at once
FF_CONST uint kRefineGroup = 64u;
FF_CONST uint kEntriesPerLoad = 4u;     // rows are padded to whole uvec4

// A leaf slot's row in the padded entry array.
struct GatherRow {
  uint first;   // in uvec4 from the start of the bound range
  uint vectors; // uvec4 of the row
  uint slot;
  float scale;  // 1 / Q
};
struct GatherPush {
  uint first_row;
  uint rows;
};
struct RefinedSlot {
  uint slot;
  uint first_child;
  uint children;
};
struct RefinePush {
  uint first;  // into the list of refined slots
  uint count;
};

// --- pictures: interpolate.comp, sun.vert/.frag, count.comp, surface.vert/.frag, sky.vert/.frag ---
FF_CONST uint kInterpolateGroup = 64u;
FF_CONST uint kCountGroup = 64u;
FF_CONST uint kInterpolated = 8u;  // patches that light a vertex, at most
FF_CONST uint kShadowMaps = 2u;    // around the eye; the whole world

// Which patches light a vertex, weights sum to 1; unused ones have weight 0.
struct Interpolation {
  uint patches[kInterpolated];
  float weights[kInterpolated];
};
// Irradiance, W/m2, of a slot or a vertex. The sun is not in it: it is found per pixel.
struct Light {
  vec4 direct;   // straight from emitting surfaces (and, at a vertex, from the sky)
  vec4 bounced;  // from all surfaces, after any number of bounces (and, at a vertex, from the sky)
};
struct PatchLook {
  vec4 albedo;
  vec4 emission;  // W/m2
  vec4 sky;       // irradiance from the sky, W/m2
};
struct InterpolatePush {
  uint first;  // vertex
  uint count;
};
struct CountPush {
  uint texels;
};
struct SunPush {
  mat4 projection;
  float back_face_depth;  // how far back faces are moved away from the sun, in depth units
};
struct Frame {
  mat4 view_projection;
  mat4 shadow[kShadowMaps];  // world to shadow map: x, y in texels, z depth
  vec4 shadow_texel_m;       // per map
  vec4 shadow_bias;          // per map, depth units
  vec4 sun_direction;        // towards the sun
  vec4 sun_irradiance;       // on a surface that faces it, W/m2; all 0: no sun
  vec4 sky_l0;               // radiance
  vec4 sky_l1[3];            // gradient of each channel
  vec4 eye;
  vec4 look_x, look_y, look_z;  // direction through the picture's centre (z) and half-extents (x right, y down)
  vec4 size;                 // x, y: pixels; z: shadow map texels
};

#ifdef __cplusplus
}  // namespace ff::shaders
#endif
#endif
