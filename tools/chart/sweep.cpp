#include "tools/chart/sweep.h"

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <optional>

#include "bake/gltf_import.h"
#include "tools/chart/comparison.h"
#include "tools/chart/running_cut.h"

namespace ff::chart {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t kTimedPlaces = 3;
constexpr size_t kFewestPatches = 40;      // within reach of a place; an eye in a crevice or in the sky says little

// Rows that are as good as exact, beside those of other bakes.
constexpr uint32_t kReferenceRays = 16384, kReferenceQuanta = 8192;

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
  for (const float g : quick ? times(2.0f) : times(1.3f, 2.0f))
    vary("growth", fmt::format("growth {:.1f}", static_cast<double>(g)), [&](Knobs& k) { k.growth = g; });
  for (const uint32_t n : quick ? std::vector<uint32_t>{1024} : std::vector<uint32_t>{1024, 16384})
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

bake::Scene without(bake::Scene scene, const std::vector<std::string>& leave_out) {
  std::erase_if(scene.triangles, [&](const bake::Triangle& t) {
    return std::find(leave_out.begin(), leave_out.end(), scene.materials[t.material].name) != leave_out.end();
  });
  return scene;
}

std::string bakeName(const BakeKnobs& k) {
  return fmt::format("cell{:.4g}_rays{}_quanta{}", static_cast<double>(k.cell_m), k.rays, k.quanta);
}

struct Baked {
  std::string path;
  double seconds = kNotMeasured;
};

// A world of these knobs that lies in the folder already is taken, if it is of the same bake.
Result<Baked> bakeAt(const SweepOptions& options, const bake::Scene& scene, const BakeKnobs& knobs, const Say& say) {
  Baked baked;
  std::filesystem::create_directories(options.folder);
  baked.path = (std::filesystem::path(options.folder) / (bakeName(knobs) + ".ffm")).string();
  bake::BakeSettings settings;
  settings.cell_m = knobs.cell_m;
  settings.patch_budget = options.patch_budget;
  settings.rays = knobs.rays;
  settings.quanta = knobs.quanta;
  settings.seed = options.seed;
  settings.leave_out = options.leave_out;
  const std::string timed = baked.path + ".seconds";
  if (knobs.cell_m > 0)
    if (const auto there = formats::World::open(baked.path); there && there->info().bake_key == bake::bakeKey(scene, settings, knobs.cell_m))
      if (std::ifstream in(timed); in >> baked.seconds) return baked;
  const auto start = Clock::now();
  const auto made = bake::bakeWorld(scene, settings, baked.path);
  if (!made) return made.error();
  baked.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  std::ofstream(timed) << baked.seconds;
  say(fmt::format("baked {} in {:.1f} s", bakeName(knobs), baked.seconds));
  return baked;
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
    const size_t places = sweep_.places.size();
    std::vector<Comparison> comparisons(sweep_.lights.size());
    CutCost cost;
    std::vector<double> memory, nodes, patches;
    for (size_t at = 0; at < places; ++at) {
      const Place& place = sweep_.places[at];
      // The observer has gone on while the cut has not followed yet.
      const Vec3 behind = place.observer - place.velocity * (static_cast<float>(k.every - 1) / 60.0f);
      if (auto moved = cut->moveTo(behind); !moved) return refused(std::move(s), moved.error());
      for (size_t l = 0; l < sweep_.lights.size(); ++l) {
        if (auto compared = compare(*cut, k, at, sweep_.lights[l], comparisons[l]); !compared) return compared.error();
      }
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
    if (auto timed = cut->timeWalk(first.observer, ahead, 6, cost); !timed) return timed.error();
    s.relight_ms = medianOf(cost.relight);  // ms when all are done and the yardstick is known
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
    std::vector<uint32_t> patches;
    for (const uint32_t number : world_.ofPlace(at)) patches.push_back(world_.lookedAt()[number]);
    const auto got = cut.reflected(**lit, patches);
    if (!got) return got.error();
    comparison.addPlace(world_, **truth, world_.ofPlace(at), *got);
    return {};
  }

 public:
  static TraceSettings traceSettings(const SweepOptions& options) {
    return {.paths = options.quick ? 1024u : 4096u, .seed = options.seed};
  }

 private:
  const SweepOptions& options_;
  Sweep& sweep_;
  MeasuredWorld& world_;
  RunningCut& yardstick_;
  std::vector<double>& yardstick_ms_;
  std::vector<double> tracer_noise_;
};

// The path's observers, or some spread over the surface; within half the local radius of the default.
Result<std::vector<Place>> placesOf(const SweepOptions& options, const MeasuredWorld& world, const Knobs& standard) {
  std::vector<Place> candidates = options.path;
  const size_t wanted = candidates.empty() ? static_cast<size_t>(options.observers) : candidates.size();
  const auto& patches = world.patches();
  if (candidates.empty())
    for (size_t i = 0; i < 2 * wanted; ++i) {  // twice as many: some will be in crevices
      // Every other one first, so that whatever is left out the rest is spread evenly.
      const size_t k = i < wanted ? 2 * i : 2 * (i - wanted) + 1;
      const formats::Node& node = patches[patches.size() * (2 * k + 1) / (4 * wanted)];
      // Ten cells a second along the surface: a man's run through a town of 1 m.
      const Vec3 along = normalized(cross(node.normal, std::abs(node.normal.y) < 0.7f ? Vec3{0, 1, 0} : Vec3{1, 0, 0}));
      candidates.push_back({node.centroid + node.normal * (0.5f * standard.bake.cell_m), along * (10 * standard.bake.cell_m), 0});
    }
  auto cut = RunningCut::create(world, standard);
  if (!cut) return cut.error();
  std::vector<Place> places;
  for (Place& place : candidates) {
    if (places.size() == wanted) break;
    if (auto moved = cut->moveTo(place.observer); !moved) return moved.error();
    place.reach_m = std::min(cut->localRadius() / 2, 24 * standard.bake.cell_m);
    const auto near = std::count_if(patches.begin(), patches.end(), [&](const formats::Node& n) {
      return length(n.centroid - place.observer) <= place.reach_m;
    });
    if (static_cast<size_t>(near) >= std::min(kFewestPatches, patches.size())) places.push_back(place);
  }
  if (places.empty())
    return Error{ErrorCode::kUsage, options.scene_path, "camera path", "no observer has surfaces within reach",
                 "lead the path through the scene, or leave it out"};
  return places;
}

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

// The lamps nearest to an observer: an emitting patch and all that follow from one to the next within two cells.
std::optional<Lighting> oneRoomLit(const Lighting& lamps, const MeasuredWorld& world, std::span<const Place> places) {
  std::vector<const formats::Node*> emitters;
  for (const formats::Node& n : world.patches())
    if (!(n.emission == Vec3{})) emitters.push_back(&n);
  size_t first = 0;
  float nearest = std::numeric_limits<float>::infinity();
  for (size_t e = 0; e < emitters.size(); ++e)
    for (const Place& place : places)
      if (const float d = length(emitters[e]->centroid - place.observer); d < nearest) nearest = d, first = e;
  const float reach = 2 * world.world().info().cell_m;
  std::vector<bool> lit(emitters.size(), false);
  std::vector<size_t> next;
  if (!emitters.empty()) next.push_back(first), lit[first] = true;
  Lighting one = lamps;
  one.name = "one room lit";
  one.lit = Box{};
  size_t count = next.size();
  while (!next.empty()) {
    const size_t e = next.back();
    next.pop_back();
    one.lit.add(emitters[e]->centroid);
    for (size_t f = 0; f < emitters.size(); ++f)
      if (!lit[f] && length(emitters[f]->centroid - emitters[e]->centroid) < reach) lit[f] = true, ++count, next.push_back(f);
  }
  if (count == 0 || count == emitters.size()) return std::nullopt;  // no lamp, or all of them are one
  const float half = world.world().info().cell_m / 2;
  one.lit = {one.lit.lo - Vec3{half, half, half}, one.lit.hi + Vec3{half, half, half}};
  return one;
}

std::vector<Lighting> lightsOf(const SweepOptions& options, const MeasuredWorld& world, std::span<const Place> places,
                               const Say& say) {
  std::vector<Lighting> lights;
  const bool any = std::any_of(world.patches().begin(), world.patches().end(),
                               [](const formats::Node& n) { return !(n.emission == Vec3{}); });
  for (const Lighting& light : options.lights) {
    if (light.lamps > 0 && !any) {
      say(light.name + ": the scene has none");
      continue;
    }
    lights.push_back(light);
    if (light.lamps > 0)
      if (auto one = oneRoomLit(light, world, places)) lights.push_back(*one);
  }
  return lights;
}

// The full solves of the reference bake, by where a patch is: the order of nodes depends on the rays.
struct Rows {
  using Key = std::array<float, 6>;
  std::map<Key, uint32_t> patch_at;
  std::vector<std::vector<double>> reflected;  // by light, 3 per patch
  static Key keyOf(const formats::Node& n) {
    return {n.centroid.x, n.centroid.y, n.centroid.z, n.normal.x, n.normal.y, n.normal.z};
  }
};

Result<Rows> rowsOf(MeasuredWorld& world, const Sweep& sweep) {
  Rows rows;
  for (uint32_t p = 0; p < world.patches().size(); ++p) rows.patch_at[Rows::keyOf(world.patches()[p])] = p;
  for (const Lighting& light : sweep.lights) {
    const auto lit = world.lit(light, sweep.standard.shadow_rays, nullptr);
    if (!lit) return lit.error();
    std::vector<double> reflected = (*lit)->full;
    for (size_t p = 0; p < world.patches().size(); ++p)
      for (int c = 0; c < 3; ++c)
        reflected[3 * p + static_cast<size_t>(c)] -= static_cast<double>((*lit)->lamps.mean[0][p][c]);
    rows.reflected.push_back(std::move(reflected));
  }
  return rows;
}

std::string percent(const Figure& f) {
  if (!std::isfinite(f.value)) return "\u2014";
  return std::isfinite(f.error) && f.error > 0 ? fmt::format("{:.2f} \u00b1 {:.2f} %", 100 * f.value, 100 * f.error)
                                               : fmt::format("{:.2f} %", 100 * f.value);
}

// Each source is measured by taking it away and nothing else.
Result<void> splitSources(const SweepOptions& options, Sweep& sweep, const Rows* reference) {
  const TraceSettings trace = SettingRun::traceSettings(options);
  MeasuredWorld& world = *sweep.world;
  auto cut = RunningCut::create(world, sweep.standard);
  if (!cut) return cut.error();
  for (size_t l = 0; l < sweep.lights.size(); ++l) {
    const auto lit = world.lit(sweep.lights[l], sweep.standard.shadow_rays, &trace);
    if (!lit) return lit.error();
    Comparison total, exact;  // the default; with reference rows and a full solve
    std::vector<double> rows, more_steps, sun, truth;
    for (size_t at = 0; at < sweep.places.size(); ++at) {
      std::vector<uint32_t> patches;
      for (const uint32_t number : world.ofPlace(at)) patches.push_back(world.lookedAt()[number]);
      if (auto moved = cut->moveTo(sweep.places[at].observer); !moved) return moved;
      if (auto set = cut->setLight(**lit); !set) return set;
      if (auto settled = cut->settle(); !settled) return settled.error();
      const auto got = cut->reflected(**lit, patches);
      if (!got) return got.error();
      if (auto stepped = cut->step(200); !stepped) return stepped;
      const auto later = cut->reflected(**lit, patches);
      if (!later) return later.error();
      total.addPlace(world, **lit, world.ofPlace(at), *got);
      double row = 0, more = 0, direct = 0, power = 0;
      std::vector<double> best;
      for (size_t k = 0; k < patches.size(); ++k) {
        const formats::Node& node = world.patches()[patches[k]];
        const auto area = static_cast<double>(node.area_m2);
        const PatchTruth& traced = (*lit)->traced[world.ofPlace(at)[k]];
        uint32_t other = bake::kNone;
        if (reference)
          if (const auto found = reference->patch_at.find(Rows::keyOf(node)); found != reference->patch_at.end())
            other = found->second;
        for (int c = 0; c < 3; ++c) {
          const size_t i = 3 * k + static_cast<size_t>(c), from = 3 * size_t{patches[k]} + static_cast<size_t>(c);
          const double full = (*lit)->full[from] - static_cast<double>((*lit)->lamps.mean[0][patches[k]][c]);
          const double better = other == bake::kNone ? full : reference->reflected[l][3 * size_t{other} + static_cast<size_t>(c)];
          const double s = static_cast<double>(node.albedo[c] * ((*lit)->sun.mean[0][patches[k]][c] - traced.sun[c]));
          best.push_back(better);
          row += area * (full - better) * (full - better);
          more += area * ((*later)[i] - (*got)[i]) * ((*later)[i] - (*got)[i]);
          direct += area * s * s;
          power += area * full * full;
        }
      }
      exact.addPlace(world, **lit, world.ofPlace(at), best);
      rows.push_back(row);
      more_steps.push_back(more);
      sun.push_back(direct);
      truth.push_back(power);
    }
    const Accuracy all = total.accuracy(""), floor = exact.accuracy("");
    Table t;
    t.id = "sources-" + std::to_string(l + 1);
    t.title = "Where the error comes from: " + sweep.lights[l].name;
    t.note = fmt::format("Relative L2 over {} places. Each line is measured by taking its source away and nothing else; squares of "
                         "the four lines would add up to the square of the whole if they were independent.",
                         sweep.places.size());
    t.columns = {"source", "error", "measured as"};
    t.rows.push_back({"all together", percent(all.rel_l2), "the default against the path tracer"});
    t.rows.push_back({reference ? "patches" : "patches and rows", percent(floor.rel_l2),
                      reference ? fmt::format("full solve, {} rays and {} quanta, against the path tracer", kReferenceRays, kReferenceQuanta)
                                : "full solve of the default's rows against the path tracer"});
    if (reference) t.rows.push_back({"rows", percent(relativeNorm(rows, truth)), "full solve of the default's rows against that of the reference rows"});
    t.rows.push_back({"cut", percent(all.full_solve_rel_l2), "streamed against the full solve of the same rows"});
    t.rows.push_back({"solver", percent(relativeNorm(more_steps, truth)), "what 200 more steps change"});
    if (sweep.lights[l].hasSun())
      t.rows.push_back({"of which shadow rays", percent(relativeNorm(sun, truth)),
                        fmt::format("sun by {} rays a patch against the path tracer's (its noise included)", sweep.standard.shadow_rays)});
    sweep.sources.push_back(std::move(t));
  }
  return {};
}

}  // namespace

Result<Sweep> runSweep(const SweepOptions& options, const Say& say) {
  Sweep sweep;
  auto scene = bake::importGltf(options.scene_path);
  if (!scene) return scene.error();
  sweep.scene = without(std::move(*scene), options.leave_out);
  Baked standard{options.world_path, kNotMeasured};
  if (standard.path.empty()) {
    auto baked = bakeAt(options, sweep.scene, {.cell_m = options.cell_m}, say);
    if (!baked) return baked.error();
    standard = *baked;
  }
  auto opened = MeasuredWorld::open(sweep.scene, standard.path);
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
      const auto baked = bakeAt(options, sweep.scene, knobs, say);
      if (!baked) return baked.error();
      auto measured = MeasuredWorld::open(sweep.scene, baked->path);
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
      sweep.settings.push_back(std::move(*setting));
      sweep.knobs.push_back(v.knobs);
      sweep.world_of.push_back(path);
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
    if (auto split = splitSources(options, sweep, reference.get()); !split) return split.error();
  return sweep;
}

}  // namespace ff::chart
