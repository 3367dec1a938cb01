// The sweep: bakes and runs a scene at many settings, one knob at a time, and compares each with the truth.
#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "tools/chart/measured_world.h"
#include "tools/chart/report.h"

namespace ff::chart {

struct SweepOptions {
  std::string scene_path;
  std::string world_path;                 // of the default bake; empty: baked into `folder`
  std::string folder;                     // for worlds that are baked on the way; they are left there and used again
  std::vector<std::string> leave_out;     // BakeSettings::leave_out
  float cell_m = 0;                       // 0: the world's, or from the patch budget
  uint32_t patch_budget = 60000;
  bool quick = false;
  std::vector<Place> path;                // observers; reach is filled in by the sweep
  std::vector<Lighting> lights;           // those that are path traced; at least one
  uint64_t seed = 1;
};

// One line now and then.
using Say = std::function<void(const std::string&)>;

// Everything the sweep keeps for the charts that come after it.
struct Sweep {
  bake::Scene scene;
  std::vector<Place> places;
  std::vector<Lighting> lights;
  Knobs standard;
  std::vector<Knobs> knobs;               // by setting
  std::vector<Setting> settings;          // the default first
  Table sources;                          // the end-to-end error, source by source
  std::unique_ptr<MeasuredWorld> world;   // the default's
  std::string world_path;
  std::vector<double> tracer_noise;       // by light
};

// Errors: those of import, bake and reading.
Result<Sweep> runSweep(const SweepOptions& options, const Say& say);

}  // namespace ff::chart
