// Where a scene is looked at, and in which lights, where the user has left that open.
#pragma once
#include <functional>
#include <span>
#include <vector>

#include "tools/chart/sweep/measured_world.h"
#include "tools/chart/sweep/sweep.h"

namespace ff::chart {

// The path's observers, or some spread over the surface, half a cell off it and running along it; each reaches half the
// local radius of the default. Those with next to nothing in reach (in a crevice, in the sky) are left out. Errors:
// kUsage where none is left; unreadable strips.
Result<std::vector<Place>> placesOf(const SweepOptions& options, const MeasuredWorld& world, const Knobs& standard);

// The options' lights that the scene has, as SweepOptions::lights says.
std::vector<Lighting> lightsOf(const SweepOptions& options, const MeasuredWorld& world, std::span<const Place> places,
                               const Say& say);

}  // namespace ff::chart
