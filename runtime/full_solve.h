// The oracle: all level-0 rows of a world, double precision, no cut, no streaming.
#pragma once
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/lamps.h"
#include "runtime/sky.h"

namespace ff::runtime {

struct FullSolveSettings {
  double tolerance = 1e-9;  // largest change of an iteration over the largest radiosity
  int max_iterations = 2000;
  int threads = 0;  // 0 = all cores; the result does not depend on it
};

struct FullSolution {
  std::vector<double> radiosity;  // reflected, 3 per patch, W/m2: emission is the caller's to add
  std::vector<double> gathered;   // F B: what arrives through the rows, 3 per patch, W/m2
  int iterations = 0;
  double last_change = 0;
};

// Irradiance of every patch without a bounce: direct, from sky and lamps. direct: by patch, W/m2; empty: none. Reads every
// level-0 strip. Errors: unreadable strips.
Result<std::vector<Vec3>> arriving(const formats::WholeWorld& world, std::span<const Vec3> direct, const Sky& sky, const Lamps& lamps);
// M of every patch, 3 each: albedo times that.
Result<std::vector<double>> fullSource(const formats::WholeWorld& world, std::span<const Vec3> direct, const Sky& sky,
                                       const Lamps& lamps);

// source: M, 3 per patch (as Solver::setSource), patches in node order.
// Memory: 6 bytes an entry. Errors: unreadable strips.
Result<FullSolution> solveFullWorld(const formats::WholeWorld& world, std::span<const double> source,
                                    const FullSolveSettings& settings = {});

}  // namespace ff::runtime
