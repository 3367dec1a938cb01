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

#ifdef __cplusplus
}  // namespace ff::shaders
#endif
#endif
