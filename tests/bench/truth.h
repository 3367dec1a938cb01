// What the benches of the run time compare with: the double-precision solve of a whole world under sun and sky, and the
// figures of a comparison. Errors end the program: benches are programs, not libraries.
#pragma once
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "runtime/node_values.h"
#include "runtime/updater.h"

namespace ff::bench {

using Clock = std::chrono::steady_clock;
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
inline double msSince(Clock::time_point t) {
  return std::chrono::duration<double, std::milli>(Clock::now() - t).count();
}

// A line of tools/bench; limit: the physical limit or rival of the same run, NaN if there is none. backend: "" or
// which.
void print(const std::string& metric, double value, const char* unit, double limit, const std::string& note,
           const std::string& backend = {});

// The middle one; values is reordered.
double median(std::vector<double>& values);

// Generates and bakes a voxel town into the folder; returns the world's path.
std::string bakeTown(const std::filesystem::path& folder, bool quick);

// Everything that does not depend on the observer.
struct Truth {
  std::vector<formats::Strip> patches;  // by level-0 tile
  std::vector<float> areas_m2;
  runtime::NodeValues sun;  // irradiance, all levels
  runtime::Sky sky{{1.1f, 1.4f, 1.9f}, {{0, 0.4f, 0}, {0, 0.5f, 0}, {0, 0.7f, 0}}};
  std::vector<double> radiosity;  // 3 per patch
  double rms = 0;                 // of radiosity, over patches and channels
  bool lamps = false;

  Vec3 source(const formats::Node& node, Vec3 direct) const {
    return (lamps ? node.emission : Vec3{}) + node.albedo * (direct + skyIrradiance(sky, node));
  }
};

Truth solveTruth(const formats::World& world, bool lamps);

// Sums over patches and channels of a comparison with the truth.
struct Difference {
  double reflected = 0, reflected_truth = 0;  // squares; emission aside
  double bounced = 0;                         // squares of the truth's indirect part alone
  uint32_t patches = 0;
  double meanTruth() const { return patches ? std::sqrt(reflected_truth / (3.0 * patches)) : 0; }
  double relative() const { return std::sqrt(reflected / reflected_truth); }
  Difference& operator+=(const Difference& b) {
    reflected += b.reflected;
    reflected_truth += b.reflected_truth;
    bounced += b.bounced;
    patches += b.patches;
    return *this;
  }
  double relativeBounced() const { return std::sqrt(reflected / bounced); }
};

struct Case {
  Vec3 observer;
  float local_radius_m = 0;  // to the nearest patch that is not active
};

// Distance from the observer to the nearest patch that is not active, m.
float localRadius(const Truth& truth, std::span<const stream::StripPtr> active, Vec3 observer);

// Of the active patches within half the local radius. radiosity, source: by slot.
Difference compare(const Truth& truth, const LocalMatrix& matrix, std::span<const Vec4> radiosity,
                   std::span<const Vec4> source, const Case& at);

// The best constant for the outside: the area-weighted mean radiosity of the patches that are not active.
Vec4 meanOutside(const Truth& truth, const LocalMatrix& matrix);

// M per slot of the matrix under the truth's light. active: what the matrix was built from.
std::vector<Vec4> sourceOf(const Truth& truth, const formats::World& world, const LocalMatrix& matrix,
                           std::span<const stream::StripPtr> active);

// Eyes half a cell off patches that are spread evenly over the world's order: streets, fields, roofs and rooms.
std::vector<Vec3> observersOf(const Truth& truth, int count, float cell_m);

}  // namespace ff::bench
