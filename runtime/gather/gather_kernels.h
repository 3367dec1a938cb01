// The inner loop of the gather solver: rows of packed entries (packEntry()) against radiosity stored as
// four floats a slot. Two implementations, chosen by what the processor can do; a test compares them.
// Four floats a slot beat three arrays with hardware gathers: 0.71 against 2.1 ns an entry on 1.4 M entries (AVX2, one
// core), since a slot's three channels come with a single load.
#pragma once
#include <cstdint>

#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

struct GatherJob {
  const uint32_t* row_start = nullptr;    // per slot
  const uint32_t* row_entries = nullptr;  // per slot
  const uint32_t* entries = nullptr;
  const uint32_t* leaves = nullptr;   // slots to compute
  const Vec4* albedo = nullptr;       // per slot
  const float* row_scale = nullptr;   // per slot
  const Vec4* source = nullptr;       // per slot
  const Vec4* from = nullptr;         // per slot; w is 0
  Vec4* to = nullptr;                 // per slot; must not overlap `from`
};

// to[s] = source[s] + albedo[s] * row_scale[s] * sum of count * from[column], for s in leaves[begin..end). Whether all of them are
// sound (sound_light.h): asked of each in its register, since a loop of its own takes a fifth of the time again.
using GatherKernel = bool (*)(const GatherJob& job, uint32_t begin, uint32_t end);

// values[refined[r].slot] = sum of child_weight * values over its children, for r in [begin, end). No slot of the range
// is another's child.
void refineSlots(const LocalMatrix& matrix, Vec4* values, uint32_t begin, uint32_t end);

bool gatherPortable(const GatherJob& job, uint32_t begin, uint32_t end);
// Null where this build or this processor has no AVX2 and FMA.
GatherKernel gatherAvx2();

}  // namespace ff::runtime
