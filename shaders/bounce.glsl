// What the bounce_*.comp shaders share: their buffers and the matrix's storage. HALF: two fp16 a word, else fp32.
// SCALAR: the matrix is read element by element; WORDS: as the shader likes; else four columns at a time.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"
#include "half.glsl"

layout(push_constant) uniform Push { BouncePush push; };

#ifdef HALF
#define Four uvec2
#else
#define Four uvec4
#endif
#if defined(WORDS)
layout(std430, binding = 0) buffer Plane { uint words[]; };
#elif defined(SCALAR)
layout(std430, binding = 0) readonly buffer Plane { uint plane[]; };
#else
layout(std430, binding = 0) buffer Plane { Four plane[]; };
#endif
// Tall, wide and waiting factors, kBounceBlock vectors of `stride` each; then corner and inverse, kBounceBlock squared.
layout(std430, binding = 1) buffer Panels { float panels[]; };
layout(std430, binding = 1) buffer PanelFours { vec4 panel_fours[]; };  // the same memory; no shader writes one view's reads
layout(std430, binding = 2) readonly buffer Block { uint block[]; };
layout(std430, binding = 3) buffer Albedo { float albedo[]; };  // [channel][place], the mean last; or one channel
layout(std430, binding = 4) buffer Vectors { float vectors[]; };
layout(std430, binding = 4) readonly buffer VectorFours { vec4 vector_fours[]; };
layout(std430, binding = 5) buffer Status {
  uint status;  // not 0: the block was refused, nothing may be written
  uint corrupt;  // not 0: so is all until the matrix is cleared (kSpoilt...)
};

uint tallAt(uint c, uint place) { return c * push.stride + place; }
uint wideAt(uint c, uint place) { return (kBounceBlock + c) * push.stride + place; }
uint rawAt(uint c, uint place) { return (2u * kBounceBlock + c) * push.stride + place; }
uint cornerAt(uint r, uint c) { return 3u * kBounceBlock * push.stride + r * kBounceBlock + c; }
uint inverseAt(uint r, uint c) { return cornerAt(kBounceBlock + r, c); }
uint placeOf(uint c) { return block[kBlockPlaces + c]; }
float blockAlbedo(uint channel, uint c) { return uintBitsToFloat(block[kBlockAlbedo + channel * kBounceBlock + c]); }
uint indexOf(uint place) { return block[kBlockIndex + place]; }
uint rowEntries() { return kBlockIndex + push.stride; }
float albedoOf(uint place) { return albedo[push.bound * push.stride + place]; }
uint vectorsOf(uint channel) { return channel * (4u * push.stride + kBounceBlock); }  // a multiple of 4
uint irradianceAt() { return 3u * push.stride; }
uint weightsAt() { return 4u * push.stride; }

#if defined(SCALAR)
float matrixAt(uint row, uint column) {
  const uint at = row * push.stride + column;
#ifdef HALF
  const vec2 two = unpackHalf2x16(plane[at >> 1]);
  return ((at & 1u) == 0u ? two.x : two.y) * (1.0 / kHalfMatrixScale);
#else
  return uintBitsToFloat(plane[at]);
#endif
}
#else
#ifdef HALF
vec4 unpackFour(uvec2 v) { return vec4(unpackHalf2x16(v.x), unpackHalf2x16(v.y)) * (1.0 / kHalfMatrixScale); }
uvec2 packFour(vec4 v) {
  v *= kHalfMatrixScale;
  return uvec2(halfBits(v.x) | halfBits(v.y) << 16, halfBits(v.z) | halfBits(v.w) << 16);
}
#else
vec4 unpackFour(uvec4 v) { return uintBitsToFloat(v); }
uvec4 packFour(vec4 v) { return floatBitsToUint(v); }
#endif
#endif
