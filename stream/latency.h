// How long something takes of late.
#pragma once
#include <algorithm>

namespace ff::stream {

// The longest of late, once it took so long again: a shorter time lowers it by a fiftieth.
inline float longestOfLate(float before, float took) { return std::max(took, 0.98f * before); }

}  // namespace ff::stream
