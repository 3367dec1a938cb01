// The paths that ff_bench_stream flies, each in passes that begin settled and cold: what a pass sees it has not read before.
#pragma once
#include <array>
#include <functional>
#include <string>
#include <vector>

#include "formats/result.h"
#include "formats/vec3.h"

namespace ff::bench {

struct FlightPath {
  struct Moment {
    Vec3 at, velocity;
    bool jumped = false;  // teleported since the moment before
  };
  std::string name;
  int passes = 1;
  double pass_seconds = 0;
  bool teleports = false;
  std::function<Moment(int pass, double seconds)> moment;
};

// Over `bounds`, eyes at height y, each path for about so many seconds: straight lines at 30, 60 and 80 m/s; turns of 90 degrees every 20 m at 30 m/s; to and
// fro over 10 m at 30 m/s; teleports every second, walking at 5 m/s in between.
std::vector<FlightPath> flightPaths(const Box& bounds, float y, double seconds);
// Where the first observer of a recorded run was (tools/inspect/recorded_path.h), from an origin in the scene's world space.
Result<FlightPath> recordedPath(const std::string& file, const std::array<double, 3>& origin);

}  // namespace ff::bench
