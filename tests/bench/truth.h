// What the benches of the run time share. What they compare with is tools/chart/world_truth.h; here errors end the program:
// benches are programs, not libraries.
#pragma once
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/clock.h"
#include "tools/chart/world_truth.h"

namespace ff::bench {

using runtime::Clock;
using runtime::msSince;
using runtime::LocalMatrix;
using runtime::SlotRange;
using runtime::Vec4;

template <class T>
T orExit(Result<T> result) {
  if (!result) {
    std::cerr << "bench: " << result.error().line() << "\n";
    std::exit(static_cast<int>(result.error().code));
  }
  return std::move(*result);
}
inline void orExit(const Result<void>& result) {
  if (result) return;
  std::cerr << "bench: " << result.error().line() << "\n";
  std::exit(static_cast<int>(result.error().code));
}

// A line of tools/bench; limit: the physical limit or rival of the same run, NaN if there is none. backend: "" or
// which.
void print(const std::string& metric, double value, const char* unit, double limit, const std::string& note,
           const std::string& backend = {});

// What the thread that calls has had of a core, ms.
double threadMs();

// So large at most is that share of the values, which are reordered; 0: there are none.
double quantile(std::vector<double>& values, double share);
inline double median(std::vector<double>& values) { return quantile(values, 0.5); }

// Generates and bakes a voxel town into the folder; returns the world's path. quick: of 8000 patches.
std::string bakeTown(const std::filesystem::path& folder, bool quick, uint64_t patches = 60'000, uint32_t rays = 4096);

using Truth = chart::WorldTruth;
using chart::Case;
using chart::compare;
using chart::Difference;
using chart::localRadius;
using chart::meanOutside;
using chart::observersOf;
using chart::sourceOf;

Truth solveTruth(const formats::WholeWorld& world, bool lamps);

}  // namespace ff::bench
