// What the seed_*.comp shaders share. Shcherbakov, A., Frolov, V. "Implementation of the Radiosity Algorithm for Large Scale
// Scenes." GraphiCon 2019. Their matrix is an RGBA16F texture; here it is a buffer of the same 8 bytes an element, at the
// 128 MiB that every device can bind for 4096 places, so that rounding to nearest is not left to the driver.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "shared.h"
#include "half.glsl"

layout(push_constant) uniform Push { SeedPush push; };
layout(std430, binding = 0) buffer Matrix { uvec2 matrix[]; };
layout(std430, binding = 1) buffer Vectors { vec4 vectors[]; };
layout(std430, binding = 2) readonly buffer Forms { float forms[]; };

vec3 colour() { return vec3(push.red, push.green, push.blue); }
float formRow(uint i) { return forms[push.forms + i]; }
float formColumn(uint i) { return forms[push.forms + push.stride + i]; }
uint at(uint vector, uint i) { return vector * push.stride + i; }
vec3 unpackElement(uvec2 v) { return vec3(unpackHalf2x16(v.x), unpackHalf2x16(v.y).x); }
uvec2 packElement(vec3 v) { return uvec2(halfBits(v.r) | halfBits(v.g) << 16, halfBits(v.b)); }
