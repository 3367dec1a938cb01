// The end-to-end error, source by source: each is measured by taking it away and nothing else.
#pragma once
#include <array>
#include <map>
#include <vector>

#include "tools/chart/sweep/measured_world.h"
#include "tools/chart/sweep/sweep.h"

namespace ff::chart {

// Rows that are as good as exact, beside those of other bakes.
inline constexpr uint32_t kReferenceRays = 16384, kReferenceQuanta = 8192;

// Full solves of the reference bake, by where a patch is: the order of nodes depends on the rays.
struct Rows {
  using Key = std::array<float, 6>;
  std::map<Key, uint32_t> patch_at;
  std::vector<std::vector<double>> reflected;  // by light, 3 per patch
  static Key keyOf(const formats::Node& n) {
    return {n.centroid.x, n.centroid.y, n.centroid.z, n.normal.x, n.normal.y, n.normal.z};
  }
};

// world: the reference bake. Errors: unreadable strips.
Result<Rows> rowsOf(MeasuredWorld& world, const Sweep& sweep);

// Fills sweep.sources. reference: null where there is no such bake; patches and rows are then one line.
Result<void> splitSources(const TraceSettings& trace, Sweep& sweep, const Rows* reference);

// As people read it; number: of the table on its page, from 1.
Table tableOf(const ErrorSources& split, size_t number);

}  // namespace ff::chart
