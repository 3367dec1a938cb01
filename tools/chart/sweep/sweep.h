// The sweep: bakes and runs a scene at many settings, one knob at a time, and compares each with the truth.
#pragma once
#include <algorithm>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tools/chart/report.h"
#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

inline constexpr const char* kOneGroupLit = "one lamp group lit";

struct SweepOptions {
  std::string scene_path;
  std::string world_path;                 // of the default bake; empty: baked into `folder`
  std::string folder;                     // for worlds that are baked on the way; they are left there and used again
  std::vector<std::string> leave_out;     // CleanupSettings::exclude
  float cell_m = 0;                       // 0: the world's, or from the patch budget
  uint32_t patch_budget = 60000;
  bool quick = false;
  bool only_default = false;
  std::vector<Place> path;                // observers; reach is filled in by the sweep. Empty: spread over the surface
  int observers = 12;                     // if the path is empty
  std::vector<Lighting> lights;           // to be path traced; at least one. One of lamps is left out where there are none, and
                                          // followed by one of the lamp group nearest to an observer alone: kOneGroupLit, looked at
                                          // from places of its own
  uint64_t seed = 1;
};

// One line now and then.
using Say = std::function<void(const std::string&)>;

// Everything the sweep keeps for the charts that come after it.
struct Sweep {
  std::unique_ptr<const bake::Scene> scene;  // the tracer keeps its address
  std::vector<Place> places;              // first those of all lights, then those of one alone
  std::vector<Lighting> lights;
  Knobs standard;
  std::vector<Knobs> knobs;               // by setting
  std::vector<Setting> settings;          // the default first
  std::vector<ErrorSources> sources;      // by light
  std::unique_ptr<MeasuredWorld> world;   // the default's
  std::string world_path;                 // of the default
  std::vector<double> tracer_noise;       // by light, relative

  size_t placesOfAll() const {
    return static_cast<size_t>(std::count_if(places.begin(), places.end(), [](const Place& p) { return p.in_light.empty(); }));
  }
};

// Errors: those of import, bake and reading.
Result<Sweep> runSweep(const SweepOptions& options, const Say& say);

}  // namespace ff::chart
