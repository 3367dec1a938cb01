// How fast the run time's light follows light that changes: after a switch, under a moving sun, with flickering lamps.
// What it follows is the settled light of the same cut, so nothing but the solver's lag is measured.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

struct TemporalOptions {
  Knobs standard;               // the cut; its method and iterations are varied
  bool quick = false;           // half the moving sun's way, a smaller dense matrix
  uint32_t shadow_rays = 16;    // per patch and position of the sun
  float degrees_a_frame = 1;    // of the moving sun, about the vertical axis
};

// One solver and number of steps a frame.
struct Follower {
  std::string name;             // "gather, k = 2"
  Knobs knobs;
  Figure relight_ms;            // median over all frames measured, and its spread
  std::vector<double> switched; // relative L2 error after each frame since the switch
  std::vector<Accuracy> lag;    // rel_l2: mean over the frames of "moving sun, ..." and "flickering lamps, ..."
};

struct Temporal {
  std::vector<Follower> followers;
  std::vector<Chart> charts;
  Table table;
};

// At one place, over the patches within its reach. The switch is from one light to the other; the sun that moves and the
// lamps that flicker are those of `after`, else of `before`; without a sun or lamps there, that part is left out.
// Errors: kUsage (no patch within reach, or both lights black there), unreadable strips.
Result<Temporal> measureTemporal(const MeasuredWorld& world, const Place& place, const Lighting& before,
                                 const Lighting& after, const TemporalOptions& options);

}  // namespace ff::chart
