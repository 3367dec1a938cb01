#include "tools/chart/sweep/sweep.h"

#include <fmt/core.h>

#include <algorithm>
#include <filesystem>

#include "bake/cleanup/scene_cleanup.h"
#include "bake/import/gltf_import.h"
#include "tools/chart/kept_bake.h"
#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/error_sources.h"
#include "tools/chart/sweep/places.h"
#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

constexpr uint32_t kTimedPlaces = 3;

struct Varied {
  std::string name, varies;
  Knobs knobs;
};

std::vector<Varied> settingsToTry(const Knobs& standard, bool quick) {
  std::vector<Varied> all{{"default", "", standard}};
  const auto vary = [&](const std::string& varies, const std::string& name, const auto& change) {
    Varied v{name, varies, standard};
    change(v.knobs);
    all.push_back(std::move(v));
  };
  const float cell = standard.bake.cell_m;
  const auto metres = [](float x) { return fmt::format("{:.3g} m", static_cast<double>(x)); };
  const auto times = [&](auto... factors) { return std::vector<float>{factors...}; };
  // The run time: no bake anew.
  for (const float f : quick ? times(0.5f, 2.0f) : times(0.33f, 0.67f, 1.33f, 2.0f))
    vary("radius", "radius " + metres(standard.radius_m * f), [&](Knobs& k) { k.radius_m *= f; });
  for (const float g : quick ? times(2.0f) : times(1.2f, 1.6f, 2.0f))
    vary("growth", fmt::format("growth {:.1f}", static_cast<double>(g)), [&](Knobs& k) { k.growth = g; });
  for (const uint32_t n : quick ? std::vector<uint32_t>{1024} : std::vector<uint32_t>{1024, 4096})
    vary("most patches", fmt::format("at most {} patches", n), [&](Knobs& k) { k.max_patches = n; });
  vary("far light", "a constant for what is far", [](Knobs& k) { k.pyramid = false; });
  for (const int n : quick ? std::vector<int>{4} : std::vector<int>{2, 4, 8})
    vary("steps", fmt::format("{} steps a frame", n), [&](Knobs& k) { k.iterations = n; });
  for (const int n : quick ? std::vector<int>{5} : std::vector<int>{5, 30})
    vary("cut follows", fmt::format("cut follows every {} frames", n), [&](Knobs& k) { k.every = n; });
  for (const uint32_t n : quick ? std::vector<uint32_t>{4} : std::vector<uint32_t>{4, 32})
    vary("shadow rays", fmt::format("{} shadow rays a patch", n), [&](Knobs& k) { k.shadow_rays = n; });
  const auto dense = [&](Method method, uint32_t places) {
    vary("solver", fmt::format("{}, M = {}", nameOf(method), places), [&](Knobs& k) {
      k.method = method;
      k.places = places;
      if (method == Method::kSeed || method == Method::kPlainLocal) {  // the nearest patches and a constant
        k.pyramid = false;
        k.max_patches = places - 1;  // one place is the constant's
      }
    });
  };
  // Larger ones fill for minutes at each place; --paper has them.
  dense(Method::kMultibounce, quick ? 512 : 1024);
  dense(Method::kMultibounceHalf, quick ? 512 : 1024);
  if (!quick) dense(Method::kMultibounceLuminance, 1024);
  dense(Method::kSeed, quick ? 512 : 1024);
  dense(Method::kPlainLocal, quick ? 512 : 1024);
  // The bake.
  if (!quick)
    vary("rays", "16384 rays, 8192 quanta", [](Knobs& k) { k.bake.rays = kReferenceRays, k.bake.quanta = kReferenceQuanta; });
  for (const uint32_t n : quick ? std::vector<uint32_t>{1024} : std::vector<uint32_t>{256, 1024})
    vary("rays", fmt::format("{} rays a patch", n), [&](Knobs& k) { k.bake.rays = n; });
  if (!quick)
    for (const uint32_t n : {128u, 2048u})
      vary("quanta", fmt::format("{} quanta a row", n), [&](Knobs& k) { k.bake.quanta = n; });
  for (const float f : quick ? times(2.0f) : times(4.0f, 2.0f, 0.5f))
    vary("patch size", "patches of " + metres(cell * f), [&](Knobs& k) {
      k.bake.cell_m *= f;
      if (f < 1) k.max_patches = static_cast<uint32_t>(static_cast<float>(k.max_patches) / (f * f));
    });
  return all;
}

std::string bakeName(const BakeKnobs& k, uint32_t patch_budget) {
  const std::string size = k.cell_m > 0 ? fmt::format("cell{:.4g}", static_cast<double>(k.cell_m)) : fmt::format("patches{}", patch_budget);
  return fmt::format("{}_rays{}_quanta{}", size, k.rays, k.quanta);
}

Result<KeptBake> bakeAt(const SweepOptions& options, const bake::Scene& scene, const BakeKnobs& knobs, const Say& say) {
  const std::string name = bakeName(knobs, options.patch_budget);
  bake::BakeSettings settings;
  settings.cell_m = knobs.cell_m;
  settings.patch_budget = options.patch_budget;
  settings.rays = knobs.rays;
  settings.quanta = knobs.quanta;
  settings.seed = options.seed;
  auto baked = keptBake(scene, settings, (std::filesystem::path(options.folder) / (name + ".ffm")).string());
  if (baked && baked->made) say(fmt::format("baked {} in {:.1f} s", name, baked->seconds));
  return baked;
}

// Places differ more than the samples of one do: the mean over the places of their medians, and of half their spreads.
Figure overPlaces(std::span<const double> samples, size_t of_a_place) {
  Figure all{0, 0};
  const double places = static_cast<double>(samples.size() / of_a_place);
  for (size_t first = 0; first < samples.size(); first += of_a_place) {
    const Figure place = medianOf({samples.begin() + static_cast<std::ptrdiff_t>(first),
                                   samples.begin() + static_cast<std::ptrdiff_t>(first + of_a_place)});
    all.value += place.value / places;
    all.error += place.error / places;
  }
  return all;
}

// What one setting is and does, in all lights.
class SettingRun {
 public:
  // yardstick: the default at the first place, lit.
  SettingRun(const SweepOptions& options, Sweep& sweep, MeasuredWorld& world, RunningCut& yardstick, std::vector<double>& yardstick_ms)
      : options_(options), sweep_(sweep), world_(world), yardstick_(yardstick), yardstick_ms_(yardstick_ms) {}

  Result<Setting> run(const Varied& varied, double bake_seconds) {
    const Knobs& k = varied.knobs;
    Setting s;
    s.name = varied.name;
    s.varies = varied.varies;
    s.knobs = described(k);
    s.run = runSettings(k);
    s.is_default = varied.varies.empty();
    s.bakes_anew = k.bake != sweep_.standard.bake;
    s.disk_bytes = static_cast<double>(world_.rowBytes());
    s.bake_seconds = bake_seconds;
    auto cut = RunningCut::create(world_, k);
    if (!cut) return refused(std::move(s), cut.error());
    const size_t places = sweep_.placesOfAll();
    std::vector<Comparison> comparisons(sweep_.lights.size());
    CutCost cost;
    std::vector<double> memory, nodes, patches;
    for (size_t at = 0; at < sweep_.places.size(); ++at) {
      const Place& place = sweep_.places[at];
      // The observer has gone on while the cut has not followed yet.
      const Vec3 behind = place.observer - place.velocity * (static_cast<float>(k.every - 1) / 60.0f);
      if (auto moved = cut->moveTo(behind); !moved) return refused(std::move(s), moved.error());
      for (size_t l = 0; l < sweep_.lights.size(); ++l) {
        if (!isSeen(sweep_.places, at, sweep_.lights[l])) continue;
        if (auto compared = compare(*cut, k, at, sweep_.lights[l], comparisons[l]); !compared) return compared.error();
      }
      if (at >= places) continue;  // what it costs is what it costs where anyone would stand
      cut->measureMemory(cost);
      memory.push_back(cost.memory_bytes);
      nodes.push_back(cost.active_nodes);
      patches.push_back(cost.patches);
      if (at * kTimedPlaces / places == cost.relight.size() / kSamples)
        if (auto timed = cut->timeRelight(kSamples, yardstick_, cost, yardstick_ms_); !timed) return timed.error();
    }
    const Place& first = sweep_.places.front();
    const Vec3 ahead = length(first.velocity) > 0 ? normalized(first.velocity) : Vec3{1, 0, 0};
    if (auto moved = cut->moveTo(first.observer); !moved) return refused(std::move(s), moved.error());
    if (auto timed = cut->timeWalk(first.observer, ahead, 24, cost); !timed) return timed.error();
    s.relight_ms = overPlaces(cost.relight, kSamples);  // ms when all are done and the yardstick is known
    if (cost.tiles > 0) s.update_ms_per_tile = {cost.update_ms / cost.tiles, kNotMeasured};
    s.memory_bytes = medianOf(memory).value;
    s.active_nodes = medianOf(nodes).value;
    s.patches = static_cast<double>(world_.patches().size());
    tracer_noise_.clear();
    for (size_t l = 0; l < comparisons.size(); ++l) {
      s.accuracy.push_back(comparisons[l].accuracy(sweep_.lights[l].name));
      tracer_noise_.push_back(comparisons[l].tracerNoise());
    }
    return s;
  }
  const std::vector<double>& tracerNoise() const { return tracer_noise_; }  // of the last run, by light

  static TraceSettings traceSettings(const SweepOptions& options) {
    return {.paths = options.quick ? 1024u : 4096u, .seed = options.seed};
  }

 private:
  static constexpr int kSamples = 15;

  static Setting refused(Setting s, const Error& error) {
    s.note = error.line();
    return s;
  }

  Result<void> compare(RunningCut& cut, const Knobs& k, size_t at, const Lighting& light, Comparison& comparison) {
    const TraceSettings trace = traceSettings(options_);
    const auto lit = world_.lit(light, k.shadow_rays, nullptr);
    if (!lit) return lit.error();
    // The truth does not depend on the run time's shadow rays: it is traced once.
    const auto truth = world_.lit(light, sweep_.standard.shadow_rays, &trace);
    if (!truth) return truth.error();
    if (auto set = cut.setLight(**lit); !set) return set;
    if (auto settled = cut.settle(); !settled) return settled.error();
    const auto got = cut.reflected(**lit, world_.patchesOf(at));
    if (!got) return got.error();
    comparison.addPlace(world_, **truth, world_.ofPlace(at), *got);
    return {};
  }

  const SweepOptions& options_;
  Sweep& sweep_;
  MeasuredWorld& world_;
  RunningCut& yardstick_;
  std::vector<double>& yardstick_ms_;
  std::vector<double> tracer_noise_;
};

Result<RunningCut> yardstickOf(Sweep& sweep) {
  auto cut = RunningCut::create(*sweep.world, sweep.standard);
  if (!cut) return cut.error();
  if (auto moved = cut->moveTo(sweep.places.front().observer); !moved) return moved.error();
  const auto lit = sweep.world->lit(sweep.lights.front(), sweep.standard.shadow_rays, nullptr);
  if (!lit) return lit.error();
  if (auto set = cut->setLight(**lit); !set) return set.error();
  if (auto settled = cut->settle(); !settled) return settled.error();
  return cut;
}

}  // namespace

Result<Sweep> runSweep(const SweepOptions& options, const Say& say) {
  Sweep sweep;
  auto scene = bake::importGltf(options.scene_path);
  if (!scene) return scene.error();
  auto clean = bake::cleanUp(*scene, {.exclude = options.leave_out});  // the truth is of what is baked
  if (!clean) return clean.error();
  sweep.scene = std::make_unique<const bake::Scene>(clean->scene ? std::move(*clean->scene) : std::move(*scene));
  KeptBake standard{options.world_path, kNotMeasured};
  if (standard.path.empty()) {
    auto baked = bakeAt(options, *sweep.scene, {.cell_m = options.cell_m}, say);
    if (!baked) return baked.error();
    standard = *baked;
  }
  auto opened = MeasuredWorld::open(*sweep.scene, standard.path);
  if (!opened) return opened.error();
  sweep.world_path = standard.path;
  sweep.world = std::make_unique<MeasuredWorld>(std::move(*opened));
  const formats::WorldInfo& info = sweep.world->world().info();
  sweep.standard.bake = {info.cell_m, info.rays, info.quanta};
  sweep.standard.radius_m = stream::StreamSettings{}.radius_m * info.cell_m;

  auto places = placesOf(options, *sweep.world, sweep.standard);
  if (!places) return places.error();
  sweep.places = std::move(*places);
  sweep.lights = lightsOf(options, *sweep.world, sweep.places, say);
  for (const Lighting& light : sweep.lights) {
    if (light.name != kOneGroupLit) continue;
    const auto own = placesInLight(light, *sweep.world, sweep.standard);
    if (!own) return own.error();
    sweep.places.insert(sweep.places.end(), own->begin(), own->end());
  }

  std::vector<Varied> all = settingsToTry(sweep.standard, options.quick);
  if (options.only_default) all.resize(1);
  std::unique_ptr<Rows> reference;
  auto yardstick = yardstickOf(sweep);
  if (!yardstick) return yardstick.error();
  std::vector<double> yardstick_ms;
  std::vector<BakeKnobs> bakes;
  for (const Varied& v : all)
    if (std::find(bakes.begin(), bakes.end(), v.knobs.bake) == bakes.end()) bakes.push_back(v.knobs.bake);
  for (const BakeKnobs& knobs : bakes) {
    std::unique_ptr<MeasuredWorld> other;
    MeasuredWorld* world = sweep.world.get();
    std::string path = standard.path;
    double seconds = standard.seconds;
    if (knobs != sweep.standard.bake) {
      const auto baked = bakeAt(options, *sweep.scene, knobs, say);
      if (!baked) return baked.error();
      auto measured = MeasuredWorld::open(*sweep.scene, baked->path);
      if (!measured) return measured.error();
      other = std::make_unique<MeasuredWorld>(std::move(*measured));
      world = other.get();
      path = baked->path;
      seconds = baked->seconds;
    }
    world->lookAt(sweep.places, options.quick ? 150 : 300);
    SettingRun run(options, sweep, *world, *yardstick, yardstick_ms);
    for (const Varied& v : all) {
      if (v.knobs.bake != knobs) continue;
      auto setting = run.run(v, seconds);
      if (!setting) return setting.error();
      std::string line = fmt::format("{:<34} {:7.2f} times the default's frame", setting->name, setting->relight_ms.value);
      for (const Accuracy& a : setting->accuracy)
        line += fmt::format("   {} {:.2f} % (median {:.2f}, full solve {:.2f})", a.light, 100 * a.rel_l2.value,
                            100 * a.median.value, 100 * a.full_solve_rel_l2.value);
      say(line + (setting->note.empty() ? "" : "   " + setting->note));
      setting->world = path;
      sweep.settings.push_back(std::move(*setting));
      sweep.knobs.push_back(v.knobs);
      if (v.varies.empty()) sweep.tracer_noise = run.tracerNoise();
    }
    if (world != sweep.world.get() && knobs.rays == kReferenceRays && knobs.quanta == kReferenceQuanta) {
      auto rows = rowsOf(*world, sweep);
      if (!rows) return rows.error();
      reference = std::make_unique<Rows>(std::move(*rows));
    }
  }
  const double unit_ms = medianOf(yardstick_ms).value;
  for (Setting& s : sweep.settings) s.relight_ms = {s.relight_ms.value * unit_ms, s.relight_ms.error * unit_ms};
  if (!options.only_default)
    if (auto split = splitSources(SettingRun::traceSettings(options), sweep, reference.get()); !split) return split.error();
  return sweep;
}

}  // namespace ff::chart
