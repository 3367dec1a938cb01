// The oracle: all level-0 rows of a world, double precision, no cut, no streaming.
#pragma once
#include <span>
#include <vector>

#include "formats/reader.h"

namespace ff::runtime {

struct FullSolveSettings {
  double tolerance = 1e-9;  // largest change of an iteration over the largest radiosity
  int max_iterations = 2000;
  int threads = 0;  // 0 = all cores; the result does not depend on it
};

struct FullSolution {
  std::vector<double> radiosity;  // 3 per patch, W/m2
  std::vector<double> gathered;   // F B: what arrives through the rows, 3 per patch, W/m2
  int iterations = 0;
  double last_change = 0;
};

// source: M, 3 per patch (as Solver::setSource), patches in node order.
// Memory: 6 bytes an entry. Errors: unreadable strips.
Result<FullSolution> solveFullWorld(const formats::World& world, std::span<const double> source,
                                    const FullSolveSettings& settings = {});

}  // namespace ff::runtime
