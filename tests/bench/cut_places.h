// What the cut shows around eyes that stand where people do, at fixed distances, and what its changes cost as they walk.
#pragma once
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "tests/bench/truth.h"

namespace ff::bench {

// Eyes 1.6 m above floors: half of them in streets, half in rooms. Functions of where patches lie, not of their numbers.
std::vector<Vec3> standingEyes(const Truth& truth, int count);

// Radiosity by slot once light has settled, on the CPU. iteration_ms: of one step; may be null.
std::vector<runtime::Vec4> convergedRadiosity(const runtime::LocalMatrix& matrix, std::span<const runtime::Vec4> source,
                                              double* iteration_ms = nullptr);

struct CutSettings {
  float radius_m = 0, growth = 0;
  uint32_t max_patches = 0;
};

// Prints cut.full_resolution_Nm and cut.median_error_Nm for N = 6, 12, 24, 48, 96, cut.slots, cut.entries and cut.tiles.
void printFixedDistances(const formats::WholeWorld& world, const Truth& truth, const CutSettings& settings, int eyes);

// Prints cut.change_ms (worst; median in the note) of walks at 30 m/s, 60 frames a second: along a line, there and back, and in a circle.
void printCutChanges(const formats::WholeWorld& world, const Truth& truth, const CutSettings& settings);

}  // namespace ff::bench
