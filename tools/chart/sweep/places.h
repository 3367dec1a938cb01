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

// Places of its own for a light of a few lamps, which few of the others would see. The surface that it falls on (from the
// patch that reflects most on, whatever touches it and reflects at least a twentieth of what the light finds on average) is
// cut in two across its longest side, three times over, so that both halves reflect the same, by area and square. One
// observer stands before the middle of each eighth and looks at that alone: each has the same say in the error, no patch
// is counted twice, and what falls out of the room's openings is in. Where the surface has too few patches there are
// fewer; none where it cannot be cut at all. The same world gives the same places. Errors: unreadable strips.
Result<std::vector<Place>> placesInLight(const Lighting& light, MeasuredWorld& world, const Knobs& standard);

}  // namespace ff::chart
