#include "tools/chart/sweep/temporal.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <numbers>
#include <optional>

#include "runtime/clock.h"
#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

using runtime::Clock;
using runtime::msSince;
using Light = std::vector<double>;  // reflected radiosity of the place's patches, 3 each

constexpr int kFramesAfterSwitch = 32, kFlickerFrames = 16, kFramesAState = 4;
constexpr float kDimmed = 0.3f;
constexpr double kLeastDrawn = 1e-5;  // what settled light itself is good for

// Light that changes from frame to frame, and what it would be if it had settled.
struct Sequence {
  std::string name;
  const LitWorld* start = nullptr;
  std::vector<const LitWorld*> lights;  // by frame
  std::vector<const Light*> settled;
};

class Observed {
 public:
  Observed(const MeasuredWorld& world, const Place& place) : world_(world), place_(place) {
    for (uint32_t p = 0; p < world.patches().size(); ++p)
      if (length(world.patches()[p].centroid - place.observer) <= place.reach_m) patches_.push_back(p);
  }
  bool any() const { return !patches_.empty(); }

  Result<RunningCut> cut(const Knobs& knobs) const {
    auto made = RunningCut::create(world_, knobs);
    if (!made) return made.error();
    if (auto moved = made->moveTo(place_.observer); !moved) return moved.error();
    return made;
  }

  Result<Light> seen(RunningCut& cut, const LitWorld& light) const { return cut.reflected(light, patches_); }

  // Until eight steps change nothing above 1e-6 of it, or of `scale`: light that fades to black never is.
  Result<Light> settled(RunningCut& cut, const LitWorld& light, double scale) const {
    if (auto set = cut.setLight(light); !set) return set.error();
    Light last;
    for (int steps = 0; steps < 4000; steps += 8) {
      if (auto stepped = cut.step(8); !stepped) return stepped.error();
      auto now = seen(cut, light);
      if (!now) return now.error();
      if (!last.empty() && distance(last, *now) <= 1e-6 * std::max(scale, norm(*now))) return now;
      last = std::move(*now);
    }
    return last;
  }

  double distance(const Light& a, const Light& b) const {
    double sum = 0;
    for (size_t i = 0; i < a.size(); ++i) sum += areaOf(i) * (a[i] - b[i]) * (a[i] - b[i]);
    return std::sqrt(sum);
  }
  double norm(const Light& a) const {
    double sum = 0;
    for (size_t i = 0; i < a.size(); ++i) sum += areaOf(i) * a[i] * a[i];
    return std::sqrt(sum);
  }

  // The relative error after each frame of k steps; times of the frames are added to `ms`.
  Result<std::vector<double>> follow(RunningCut& cut, const Sequence& sequence, int k, std::vector<double>& ms) const {
    std::vector<double> errors;
    if (auto set = cut.setLight(*sequence.start); !set) return set.error();
    if (auto settled = cut.settle(); !settled) return settled.error();
    const LitWorld* shining = sequence.start;
    for (size_t frame = 0; frame < sequence.lights.size(); ++frame) {
      if (sequence.lights[frame] != shining)
        if (auto set = cut.setLight(*sequence.lights[frame]); !set) return set.error();
      shining = sequence.lights[frame];
      const auto begun = Clock::now();
      if (auto stepped = cut.step(k); !stepped) return stepped.error();
      ms.push_back(msSince(begun));
      const auto now = seen(cut, *shining);
      if (!now) return now.error();
      errors.push_back(distance(*now, *sequence.settled[frame]) / norm(*sequence.settled[frame]));
    }
    return errors;
  }

 private:
  double areaOf(size_t channel) const { return static_cast<double>(world_.patches()[patches_[channel / 3]].area_m2); }
  const MeasuredWorld& world_;
  const Place& place_;
  std::vector<uint32_t> patches_;
};

Lighting turned(Lighting light, float degrees) {
  const float a = degrees * std::numbers::pi_v<float> / 180, c = std::cos(a), s = std::sin(a);
  const Vec3 d = light.to_sun;
  light.to_sun = normalized({c * d.x + s * d.z, d.y, c * d.z - s * d.x});
  return light;
}

// Lights and their settled states, each at one address.
class Lights {
 public:
  Lights(const MeasuredWorld& world, const Observed& observed, RunningCut& reference, uint32_t shadow_rays)
      : world_(world), observed_(observed), reference_(reference), shadow_rays_(shadow_rays) {}

  struct Lit {
    LitWorld world;
    Light settled;
  };
  Result<const Lit*> make(const Lighting& light) {
    auto lit = world_.direct(light, shadow_rays_);
    if (!lit) return lit.error();
    return take(std::move(*lit));
  }
  // The same light with other lamps.
  Result<const Lit*> dimmed(const Lit& lit, float factor) {
    LitWorld w = lit.world;
    w.light.lamps *= factor;
    w.lamps = w.light.switches(world_.world().info());
    return take(std::move(w));
  }
  bool isBlack(const Lit& lit) const { return !(observed_.norm(lit.settled) > 1e-4 * brightest_); }

 private:
  Result<const Lit*> take(LitWorld w) {
    auto settled = observed_.settled(reference_, w, brightest_);
    if (!settled) return settled.error();
    brightest_ = std::max(brightest_, observed_.norm(*settled));
    made_.push_back({std::move(w), std::move(*settled)});
    return &made_.back();
  }
  const MeasuredWorld& world_;
  const Observed& observed_;
  RunningCut& reference_;
  uint32_t shadow_rays_;
  double brightest_ = 0;
  std::deque<Lit> made_;
};

struct Sequences {
  Sequence switched;
  std::optional<Sequence> sun, flicker;
};

void add(Sequence& sequence, const Lights::Lit& lit) {
  sequence.lights.push_back(&lit.world);
  sequence.settled.push_back(&lit.settled);
}

Result<Sequences> sequencesOf(Lights& lights, const Lighting& before, const Lighting& after,
                              const TemporalOptions& options) {
  Sequences s;
  const auto from = lights.make(before);
  if (!from) return from.error();
  const auto to = lights.make(after);
  if (!to) return to.error();
  if (lights.isBlack(**to))
    return Error{ErrorCode::kUsage, "", "light " + after.name, "nothing of it reaches the place", "name another place"};
  s.switched = {before.name + " to " + after.name, &(*from)->world, {}, {}};
  for (int f = 0; f < kFramesAfterSwitch; ++f) add(s.switched, **to);

  if (const Lighting& sunny = after.hasSun() ? after : before; sunny.hasSun()) {
    const Lights::Lit* start = after.hasSun() ? *to : *from;
    Sequence sun{fmt::format("moving sun, {:.3g} degree{} a frame", static_cast<double>(options.degrees_a_frame),
                             options.degrees_a_frame == 1 ? "" : "s"),
                 &start->world, {}, {}};
    bool black = lights.isBlack(*start);
    for (int f = 1; f <= (options.quick ? 8 : 16) && !black; ++f) {
      const auto next = lights.make(turned(sunny, options.degrees_a_frame * static_cast<float>(f)));
      if (!next) return next.error();
      black = lights.isBlack(**next);
      add(sun, **next);
    }
    if (!black) s.sun = std::move(sun);
  }
  if (const Lights::Lit* bright = after.lamps > 0 ? *to : *from; bright->world.light.lamps > 0 && !lights.isBlack(*bright)) {
    const auto dim = lights.dimmed(*bright, kDimmed);
    if (!dim) return dim.error();
    Sequence flicker{fmt::format("lamps flicker to {:.0f} %, {} frames each", 100 * static_cast<double>(kDimmed), kFramesAState),
                     &bright->world, {}, {}};
    for (int f = 0; f < kFlickerFrames; ++f) add(flicker, f / kFramesAState % 2 == 0 ? **dim : *bright);
    if (!lights.isBlack(**dim)) s.flicker = std::move(flicker);
  }
  return s;
}

std::vector<Follower> followersOf(const TemporalOptions& options) {
  std::vector<Follower> all;
  for (const int k : {1, 2, 4, 8}) {
    Follower f{fmt::format("gather, k = {}", k), options.standard, {}, {}, {}};
    f.knobs.method = Method::kGather;
    f.knobs.iterations = k;
    all.push_back(std::move(f));
  }
  Follower dense{"", options.standard, {}, {}, {}};
  dense.knobs.method = Method::kMultibounce;
  dense.knobs.iterations = 1;
  dense.knobs.places = options.quick ? 512 : 1024;
  dense.name = fmt::format("{}, M = {}", nameOf(dense.knobs.method), dense.knobs.places);
  all.push_back(std::move(dense));
  return all;
}

Chart overFrames(const char* id, const std::string& title, const std::string& note) {
  Chart chart;
  chart.id = id;
  chart.title = title;
  chart.x_label = "frames";
  chart.y_label = "relative L2 error against the settled light, %";
  chart.note = note;
  chart.log_y = true;
  chart.y_marks = {{1, "1 %"}};
  return chart;
}

Series seriesOf(const Follower& f, std::span<const double> errors, double x_step) {
  Series series;
  series.name = f.name;
  for (size_t i = 0; i < errors.size(); ++i) {
    Series::Point p;
    p.x = x_step * static_cast<double>(i + 1);
    p.y = 100 * std::max(errors[i], kLeastDrawn);
    p.hover = fmt::format("{}\nframe {}: {:.3g} %\n{:.3g} ms a frame", f.name, i + 1, 100 * errors[i], f.relight_ms.value);
    series.points.push_back(std::move(p));
    if (errors[i] < kLeastDrawn) break;
  }
  return series;
}

std::string percent(double x) { return fmt::format("{:.3g} %", 100 * x); }

std::string framesTo(std::span<const double> errors, double limit) {
  for (size_t i = 0; i < errors.size(); ++i)
    if (errors[i] <= limit) return fmt::format("{}", i + 1);
  return fmt::format("more than {}", errors.size());
}

Table tableOf(const std::vector<Follower>& followers, const std::string& switched) {
  Table table;
  table.id = "temporal";
  table.title = "How fast light follows";
  table.note = "Errors are relative L2 against the settled light of the same cut: what the solver lags behind, not what "
               "rows or patches cost. Switch: " + switched + ".";
  table.columns = {"solver", "ms a frame", "switch: after 1 frame", "after 8 frames", "frames to 1 %"};
  for (const Accuracy& a : followers.front().lag) table.columns.push_back(a.light);
  for (const Follower& f : followers) {
    std::vector<std::string> row{f.name, fmt::format("{:.3g}", f.relight_ms.value), percent(f.switched.front()),
                                 percent(f.switched[7]), framesTo(f.switched, 0.01)};
    for (const Accuracy& a : f.lag) row.push_back(percent(a.rel_l2.value));
    table.rows.push_back(std::move(row));
  }
  return table;
}

}  // namespace

Result<Temporal> measureTemporal(const MeasuredWorld& world, const Place& place, const Lighting& before,
                                 const Lighting& after, const TemporalOptions& options) {
  const Observed observed(world, place);
  if (!observed.any())
    return Error{ErrorCode::kUsage, "", "", fmt::format("no patch lies within {:.3g} m of the observer", static_cast<double>(place.reach_m)),
                 "name another place"};
  Temporal t;
  t.followers = followersOf(options);
  auto sparse = observed.cut(t.followers.front().knobs);
  if (!sparse) return sparse.error();
  Lights lights(world, observed, *sparse, options.shadow_rays);
  const auto sequences = sequencesOf(lights, before, after, options);
  if (!sequences) return sequences.error();

  Chart switched = overFrames("switch-frames", "Error over time after a switch: " + sequences->switched.name,
                              "The light of a place that had settled is switched; each frame is k steps of the solver, "
                              "which goes on from the frame before. Below 0.001 % the line ends.");
  switched.x_label = "frames since the switch";
  Chart in_time = switched, sun, flicker;
  in_time.id = "switch-ms";
  in_time.title = "The same against the solver's time";
  in_time.x_label = "frames times the median time of a frame, ms";
  in_time.log_x = true;
  if (sequences->sun)
    sun = overFrames("moving-sun", "Lag behind a moving sun",
                     "The sun turns about the vertical axis by " +
                         fmt::format("{:.3g}", static_cast<double>(options.degrees_a_frame)) +
                         " degree a frame; each frame's light against what it would settle to.");
  if (sequences->flicker)
    flicker = overFrames("flicker", "Lag behind flickering lamps",
                         fmt::format("All lamps change between full and {:.0f} % every {} frames.",
                                     100 * static_cast<double>(kDimmed), kFramesAState));

  for (Follower& f : t.followers) {
    std::optional<RunningCut> dense;
    if (isDense(f.knobs.method)) {
      auto made = observed.cut(f.knobs);
      if (!made) return made.error();
      dense.emplace(std::move(*made));
    }
    RunningCut& cut = dense ? *dense : *sparse;
    std::vector<double> ms;
    const int k = f.knobs.iterations;
    auto errors = observed.follow(cut, sequences->switched, k, ms);
    if (!errors) return errors.error();
    f.switched = std::move(*errors);
    struct Part {
      const std::optional<Sequence>& sequence;
      Chart& chart;
      std::vector<double> errors;
    } parts[] = {{sequences->sun, sun, {}}, {sequences->flicker, flicker, {}}};
    for (Part& part : parts) {
      if (!part.sequence) continue;
      auto lag = observed.follow(cut, *part.sequence, k, ms);
      if (!lag) return lag.error();
      part.errors = std::move(*lag);
      double mean = 0;
      for (const double e : part.errors) mean += e / static_cast<double>(part.errors.size());
      Accuracy a;
      a.light = part.sequence->name + " (lag)";
      a.rel_l2 = {mean, kNotMeasured};
      f.lag.push_back(std::move(a));
    }
    f.relight_ms = medianOf(ms);
    switched.series.push_back(seriesOf(f, f.switched, 1));
    in_time.series.push_back(seriesOf(f, f.switched, f.relight_ms.value));
    for (const Part& part : parts)
      if (part.sequence) part.chart.series.push_back(seriesOf(f, part.errors, 1));
  }
  t.table = tableOf(t.followers, sequences->switched.name);
  t.charts = {std::move(switched), std::move(in_time)};
  if (sequences->sun) t.charts.push_back(std::move(sun));
  if (sequences->flicker) t.charts.push_back(std::move(flicker));
  return t;
}

}  // namespace ff::chart
