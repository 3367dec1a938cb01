#include <fmt/core.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <thread>
#include <tuple>

#include "tools/inspect/inspect.h"
#include "tools/inspect/recorded_path.h"

namespace ff::tools {
namespace {

using Clock = std::chrono::steady_clock;
constexpr size_t kWorst = 5;                   // frames that are listed
constexpr uint32_t kMostFrames = 1u << 20;     // FormfieldWorldSettings::logged_frames
constexpr float kSettled = 1e-4f;
constexpr uint32_t kSettleIterations = 2000;

// A run along the path: as it was recorded, or now.
struct Run {
  std::vector<double> ms;           // by frame
  std::vector<uint32_t> late;
  double quantile(double share) const {
    std::vector<double> sorted = ms;
    std::sort(sorted.begin(), sorted.end());
    return sorted[std::min(sorted.size() - 1, static_cast<size_t>(share * static_cast<double>(sorted.size())))];
  }
  size_t framesLate() const { return ms.size() - static_cast<size_t>(std::count(late.begin(), late.end(), 0u)); }
  nlohmann::json toJson() const {
    return {{"frame_ms_p50", quantile(0.5)}, {"frame_ms_p99", quantile(0.99)}, {"frame_ms_max", quantile(1)}, {"frames_with_late_tiles", framesLate()},
            {"most_late_tiles", *std::max_element(late.begin(), late.end())}};
  }
};

Run recorded(const std::vector<RecordedFrame>& path) {
  Run run;
  for (const RecordedFrame& frame : path) {
    run.ms.push_back(frame.ms);
    run.late.push_back(frame.late_tiles);
  }
  return run;
}

// All observers together, m, but for jumps.
double lengthOf(const std::vector<RecordedFrame>& path) {
  constexpr double kJump = 5;
  double length = 0;
  for (size_t f = 1; f < path.size(); ++f)
    for (size_t o = 0; o < std::min(path[f].observers.size(), path[f - 1].observers.size()); ++o) {
      const auto &a = path[f - 1].observers[o].position, &b = path[f].observers[o].position;
      const double step = std::hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
      if (step < kJump) length += step;
    }
  return length;
}

// The frames in which most was late; of those where nothing was, those that took longest.
std::vector<size_t> worstOf(const Run& run) {
  std::vector<size_t> order(run.ms.size());
  for (size_t f = 0; f < order.size(); ++f) order[f] = f;
  const size_t shown = std::min(kWorst, order.size());
  std::partial_sort(order.begin(), order.begin() + static_cast<ptrdiff_t>(shown), order.end(), [&](size_t a, size_t b) {
    return std::tuple(run.late[b], run.ms[b], a) < std::tuple(run.late[a], run.ms[a], b);
  });
  order.resize(shown);
  return order;
}

struct DeviceCloser {
  void operator()(FormfieldDevice device) const { formfieldDestroyDevice(device); }
};
struct WorldCloser {
  void operator()(FormfieldWorld world) const { formfieldCloseWorld(world); }
};

}  // namespace

Result<void> inspectTrace(const std::string& world_path, const TraceRequest& request, const InspectOutput& out) {
  const auto path = readRecordedPath(request.path);
  if (!path) return path.error();
  if (path->size() > kMostFrames) return Error{ErrorCode::kUsage, request.path, "", "has more than a million frames", "cut it into parts"};
  FormfieldDevice opened_device = nullptr;
  FormfieldWorld opened_world = nullptr;
  const auto error = [&](FormfieldResult code, FormfieldDevice device) {
    return Error{code <= FORMFIELD_ERROR_PHYSICS ? static_cast<ErrorCode>(code) : ErrorCode::kIo, "", "", formfieldError(device), ""};
  };
  if (const auto code = formfieldCreateCpuDevice(request.threads, &opened_device)) return error(code, nullptr);
  const std::unique_ptr<FormfieldDevice_T, DeviceCloser> device(opened_device);
  FormfieldWorldSettings settings{};
  settings.size = sizeof settings;
  formfieldDefaultWorldSettings(&settings);
  settings.logged_frames = static_cast<uint32_t>(path->size());
  if (request.radius_m > 0) settings.radius_m = request.radius_m;
  if (request.memory_bytes > 0) settings.memory_bytes = request.memory_bytes;
  settings.kept_bytes = std::min(settings.kept_bytes, settings.memory_bytes);
  settings.hint_bytes = std::min(settings.hint_bytes, settings.memory_bytes);
  settings.read_bytes_per_second = request.bytes_per_second;
  settings.max_applied_tiles = request.max_applied_tiles;
  if (const auto code = formfieldOpenWorld(device.get(), world_path.c_str(), &settings, &opened_world)) return error(code, device.get());
  const std::unique_ptr<FormfieldWorld_T, WorldCloser> world(opened_world);
  const auto frame = [&](const RecordedFrame& at) { return formfieldFrameFor(world.get(), static_cast<uint32_t>(at.observers.size()), at.observers.data()); };
  const auto statsNow = [&] {
    FormfieldStats stats{};
    stats.size = sizeof stats;
    formfieldGetStats(world.get(), &stats);
    return stats;
  };

  // All is there where the path begins, as it is for a game that is under way.
  if (const auto code = frame(path->front())) return error(code, device.get());
  if (const auto code = formfieldSettle(world.get(), kSettled, kSettleIterations)) return error(code, device.get());
  const FormfieldStats before = statsNow();
  float radius_m = before.reached_radius_m, growth = before.reached_growth;  // the least that budgets had room for
  Run now, radiosity;  // radiosity: what formfieldRadiosity takes after each frame
  const auto start = Clock::now();
  for (const RecordedFrame& at : *path) {
    std::this_thread::sleep_until(start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(at.seconds)));
    if (const auto code = frame(at)) return error(code, device.get());
    const FormfieldStats stats = statsNow();
    now.ms.push_back(stats.frame_ms);
    const auto asked = Clock::now();
    (void)formfieldRadiosity(world.get(), nullptr);
    radiosity.ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - asked).count());
    now.late.push_back(stats.late_tiles);
    radius_m = std::min(radius_m, stats.reached_radius_m);
    growth = std::min(growth, stats.reached_growth);
  }
  const FormfieldStats after = statsNow();
  if (!request.trace_path.empty())
    if (const auto code = formfieldWriteTrace(world.get(), request.trace_path.c_str())) return error(code, device.get());

  const Run then = recorded(*path);
  const bool known = *std::max_element(then.ms.begin(), then.ms.end()) > 0;  // a path by hand has no figures
  size_t observers = 0;
  for (const RecordedFrame& at : *path) observers = std::max(observers, at.observers.size());
  const double read_mb = static_cast<double>(after.bytes_read - before.bytes_read) * 1e-6;
  nlohmann::json worst = nlohmann::json::array();
  for (const size_t f : worstOf(now)) {
    nlohmann::json places = nlohmann::json::array();
    for (const FormfieldObserver& o : (*path)[f].observers) places.push_back({o.position[0], o.position[1], o.position[2]});
    worst.push_back({{"frame", f}, {"seconds", (*path)[f].seconds}, {"ms", now.ms[f]}, {"late_tiles", now.late[f]}, {"observers", std::move(places)}});
  }
  if (out.json) {
    nlohmann::json j{{"frames", path->size()}, {"seconds", path->back().seconds}, {"observers", observers}, {"length_m", lengthOf(*path)}, {"replayed", now.toJson()}, {"worst", worst}};
    j["recorded"] = known ? then.toJson() : nlohmann::json();
    j["replayed"].update({{"reads", after.reads - before.reads}, {"strips_read", after.strips_read - before.strips_read}, {"bytes_read", after.bytes_read - before.bytes_read},
                          {"reads_cancelled", after.reads_cancelled - before.reads_cancelled}, {"strips_failed", after.strips_failed - before.strips_failed},
                          {"peak_resident_bytes", after.peak_resident_bytes}, {"peak_stored_bytes", after.peak_stored_bytes}, {"decode_ms", after.decode_ms - before.decode_ms}, {"fallbacks", after.fallbacks}, {"radiosity_ms_p50", radiosity.quantile(0.5)}, {"radiosity_ms_p99", radiosity.quantile(0.99)}, {"least_radius_m", radius_m}, {"least_growth", growth}});
    fmt::print(out.to, "{}\n", j.dump(2));
    return {};
  }
  fmt::print(out.to, "path         {} frames in {:.2f} s, {} observer{}, {:.0f} m\n", path->size(), path->back().seconds, observers, observers == 1 ? "" : "s", lengthOf(*path));
  const auto line = [&](const char* what, auto value) {
    fmt::print(out.to, "{:<38} {:>10}{}\n", what, value(now), known ? fmt::format(", {} as recorded", value(then)) : "");
  };
  const auto ms = [](double share) { return [share](const Run& run) { return fmt::format("{:.2f} ms", run.quantile(share)); }; };
  line("a frame but for the solver, half", ms(0.5));
  line("  99 of 100", ms(0.99));
  line("  the longest", ms(1));
  fmt::print(out.to, "{:<38} {:.2f} ms, 99 of 100 {:.2f} ms\n", "asking for all radiosity, half", radiosity.quantile(0.5), radiosity.quantile(0.99));
  line("frames with late tiles", [](const Run& run) { return fmt::format("{}", run.framesLate()); });
  fmt::print(out.to, "{:<38} {:.1f} MB in {} strips by {} reads, {} cancelled, {} failed\n", "read", read_mb, after.strips_read - before.strips_read, after.reads - before.reads, after.reads_cancelled - before.reads_cancelled,
             after.strips_failed - before.strips_failed);
  fmt::print(out.to, "{:<38} {:.1f} MB, {:.1f} MB not decoded yet\n", "memory of strips, at most", static_cast<double>(after.peak_resident_bytes) * 1e-6, static_cast<double>(after.peak_stored_bytes) * 1e-6);
  fmt::print(out.to, "{:<38} {:.0f} ms of its threads' time\n", "decoding", after.decode_ms - before.decode_ms);
  fmt::print(out.to, "{:<38} {:.3g} m, growth {:.3g}, at least\n", "radius that budgets had room for", radius_m, growth);
  fmt::print(out.to, "worst frames\n");
  for (const auto& w : worst) {
    fmt::print(out.to, "  at {:.3f} s  {:.2f} ms, {} late tile{}, observer at", w["seconds"].get<double>(), w["ms"].get<double>(), w["late_tiles"].get<uint32_t>(), w["late_tiles"] == 1 ? "" : "s");
    for (const auto& place : w["observers"]) fmt::print(out.to, " {:g},{:g},{:g}", place[0].get<double>(), place[1].get<double>(), place[2].get<double>());
    fmt::print(out.to, "\n");
  }
  for (const char* warning : {formfieldStreamFailure(world.get()), formfieldBudgetWarning(world.get())})
    if (*warning) fmt::print(out.to, "{}\n", warning);
  return {};
}

}  // namespace ff::tools
