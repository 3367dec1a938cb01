#include "tests/bench/flight_paths.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "tools/inspect/recorded_path.h"

namespace ff::bench {
namespace {

constexpr float kMargin = 0.1f;  // of the world, at each end

// "1.5", "30".
std::string speedText(float speed) {
  char text[16];
  std::snprintf(text, sizeof text, "%g", static_cast<double>(speed));
  return text;
}

int passesFor(double seconds, double pass_seconds) { return std::max(1, static_cast<int>(std::lround(seconds / pass_seconds))); }

}  // namespace

std::vector<FlightPath> flightPaths(const Box& bounds, float y, double seconds) {
  const Vec3 size = bounds.hi - bounds.lo;
  const Vec3 lo = bounds.lo + size * kMargin, span = size * (1 - 2 * kMargin);
  const float middle_x = lo.x + span.x / 2, middle_z = lo.z + span.z / 2;
  // Lanes of passes, far from each other and the same for every path.
  const auto lane = [=](int pass) { return lo.z + span.z * std::fmod(0.5f + 0.618034f * static_cast<float>(pass), 1.0f); };
  std::vector<FlightPath> paths;
  for (const float speed : {1.5f, 10.0f, 30.0f, 60.0f, 80.0f}) {
    const double pass_seconds = std::min(seconds, static_cast<double>(span.x / speed));
    paths.push_back({"line, " + speedText(speed) + " m/s", passesFor(seconds, pass_seconds), pass_seconds, false, [=](int pass, double t) {
                       return FlightPath::Moment{{lo.x + speed * static_cast<float>(t), y, lane(pass)}, {speed, 0, 0}};
                     }});
  }
  constexpr float kSpeed = 30, kLeg_m = 20, kReach_m = 10, kWalk = 5;
  const double turn_seconds = std::min(seconds, static_cast<double>(2 * (span.x - kLeg_m) / kSpeed));
  paths.push_back({"turns, 30 m/s", passesFor(seconds, turn_seconds), turn_seconds, false, [=](int pass, double t) {
                     const auto way = kSpeed * static_cast<float>(t);
                     const auto leg = static_cast<int>(way / kLeg_m);
                     const float on = way - kLeg_m * static_cast<float>(leg), before = kLeg_m * static_cast<float>((leg + 1) / 2);
                     const bool aside = leg % 2 != 0;  // in turn to the left and to the right
                     const float side = leg % 4 < 2 ? 1.0f : -1.0f, from = leg % 4 < 2 ? 0 : kLeg_m;
                     const float z = std::min(lane(pass), lo.z + span.z - kLeg_m);
                     return FlightPath::Moment{{lo.x + before + (aside ? 0 : on), y, z + (aside ? (side > 0 ? on : kLeg_m - on) : from)},
                                               aside ? Vec3{0, 0, side * kSpeed} : Vec3{kSpeed, 0, 0}};
                   }});
  paths.push_back({"oscillation, 30 m/s", 1, seconds, false, [=](int, double t) {
                     const float way = std::fmod(kSpeed * static_cast<float>(t), 2 * kReach_m);
                     const bool there = way < kReach_m;
                     return FlightPath::Moment{{middle_x, y, middle_z + (there ? way : 2 * kReach_m - way)}, {0, 0, there ? kSpeed : -kSpeed}};
                   }});
  paths.push_back({"teleports", 1, seconds, true, [=](int, double t) {
                     std::mt19937 random(static_cast<uint32_t>(t));
                     const auto share = [&] { return static_cast<float>(random() >> 8) / 16777216.0f; };
                     const float x = share(), z = share(), since = static_cast<float>(std::fmod(t, 1.0));
                     return FlightPath::Moment{{lo.x + span.x * x + kWalk * since, y, lo.z + span.z * z}, {kWalk, 0, 0}, t >= 1 && std::fmod(t, 1.0) < 1.0 / 60};
                   }});
  return paths;
}

Result<FlightPath> recordedPath(const std::string& file, const std::array<double, 3>& origin) {
  auto frames = tools::readRecordedPath(file);
  if (!frames) return frames.error();
  const double seconds = frames->back().seconds;
  return FlightPath{"recorded", 1, seconds, false, [frames = std::move(*frames), origin](int, double t) {
                      const auto next = std::upper_bound(frames.begin(), frames.end(), t, [](double at, const tools::RecordedFrame& f) { return at < f.seconds; });
                      const tools::RecordedFrame& frame = next == frames.begin() ? *next : *std::prev(next);
                      const FormfieldObserver& o = frame.observers[0];
                      FlightPath::Moment moment;
                      for (int a = 0; a < 3; ++a) moment.at[a] = static_cast<float>(o.position[a] - origin[static_cast<size_t>(a)]);
                      moment.velocity = {o.velocity[0], o.velocity[1], o.velocity[2]};
                      return moment;
                    }};
}

}  // namespace ff::bench
