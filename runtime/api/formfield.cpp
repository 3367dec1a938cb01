#include "runtime/api/formfield.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <system_error>
#include <utility>

#include "formats/storage/storage.h"
#include "runtime/api/formfield_handles.h"
#include "runtime/clock.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"

namespace {

using namespace ff;
using namespace ff::runtime;

static_assert(sizeof(Vec3) == 3 * sizeof(float) && sizeof(Vec4) == 4 * sizeof(float));
static_assert(FORMFIELD_MAX_OBSERVERS == stream::kMaxObservers);
static_assert(FORMFIELD_NO_SLOT == kNoSlot && FORMFIELD_MAX_SLOTS == kMaxSlots);

struct CpuDevice final : FormfieldDevice_T {
  Result<WorldSolver> makeSolver(const formats::World&, const SolverChoice& choice, uint32_t) override {
    if (choice.kind == SolverKind::kGather) return WorldSolver{makeCpuGather(threads)};
    MultibounceSettings dense;
    dense.places = choice.places;
    dense.storage = choice.storage;
    dense.luminance = choice.luminance;
    dense.threads = threads;
    const bool seed = choice.kind == SolverKind::kSeed;
    auto matrix = seed ? makeCpuSeed(dense) : makeCpuMultibounce(dense);
    if (!matrix) return matrix.error();
    auto solver = makeDenseSolver(std::move(*matrix), {.correct = !seed, .threads = threads});
    const DenseStats* const known = &solver->stats();
    return WorldSolver{std::move(solver), nullptr, known};
  }
  int threads = 0;
};

// What the settings say; where they leave it open, what is written beside the world, if it records where that is
// wanted; else gather, until settle() knows the cut.
Result<SolverChoice> firstChoice(const FormfieldDevice_T& device, const FormfieldWorldSettings& s,
                                 const std::string& path) {
  SolverChoice choice;
  if (s.solver == FORMFIELD_SOLVER_AUTO) {
    auto recommended = readRecommendation(path);
    if (!recommended) return recommended.error();
    if (*recommended && (!device.records() || device.records((*recommended)->kind))) return **recommended;
    choice.iterations = Updater::kAsLightNeeds;
    if (device.records()) choice.why = "what can record frames into a command buffer";
    return choice;
  }
  choice.kind = s.solver == FORMFIELD_SOLVER_MULTIBOUNCE ? SolverKind::kMultibounce
                : s.solver == FORMFIELD_SOLVER_SEED      ? SolverKind::kSeed
                                                         : SolverKind::kGather;
  choice.iterations = choice.kind == SolverKind::kGather ? Updater::kAsLightNeeds : 1;
  choice.storage = s.storage == FORMFIELD_STORAGE_FLOAT16 ? Storage::kFloat16 : Storage::kFloat32;
  choice.places = s.dense_places;
  choice.why = "as the settings say";
  return choice;
}

// takeSettings() the other way: fills in as much of the caller's structure as it has.
template <class Report>
Result<void> giveReport(const Report& report, Report* out) {
  if (!out || out->size < sizeof(uint32_t) || out->size > sizeof(Report))
    return usageError("size", "is not that of this structure", "set it to sizeof before the call");
  const uint32_t size = out->size;
  std::copy_n(reinterpret_cast<const std::byte*>(&report), size, reinterpret_cast<std::byte*>(out));
  out->size = size;
  return {};
}

Result<void> check(const FormfieldWorldSettings& s) {
  if (s.max_nodes == 0 || s.max_nodes > kMaxSlots) return usageError("max_nodes", "is not between 1 and " + std::to_string(kMaxSlots));
  if (s.iterations > 1000) return usageError("iterations", "are more than 1000 a frame", "2 to 8 are usual");
  if (s.decode_threads > 64) return usageError("decode_threads", "are more than 64", "1 is usual");
  if (s.probes > 0 && (s.probe_rays == 0 || s.probe_rays > 65535))
    return usageError("probe_rays", "are not between 1 and 65535", "256 is a good value");
  if (s.solver > FORMFIELD_SOLVER_SEED) return usageError("solver", "is none that this version knows");
  if (s.dense_places == 0 || s.dense_places > kMaxPlaces)
    return usageError("dense_places", "are not between 1 and " + std::to_string(kMaxPlaces), "4096 take 100 MiB in 16 bits");
  if (s.fade_frames > 600) return usageError("fade_frames", "are more than 600", "14 is a good value");
  if (!(s.fade_change >= 0 && s.fade_change <= 1e6f)) return usageError("fade_change", "is no number from 0 to 1e6", "0.01 is a good value");
  if (s.logged_frames > (1u << 20)) return usageError("logged_frames", "are more than a million");
  if (!(s.reload_seconds >= 0 && s.reload_seconds <= 1e6f)) return usageError("reload_seconds", "is not between 0 and 1e6", "1 is a good value, 0 turns it off");
  if (s.probes > (1u << 20)) return usageError("probes", "are more than a million");
  return {};
}

stream::StreamSettings streamSettings(const FormfieldWorldSettings& s) {
  stream::StreamSettings streaming;
  streaming.radius_m = s.radius_m;
  streaming.growth = s.growth;
  streaming.hysteresis = s.hysteresis;
  streaming.memory_bytes = s.memory_bytes;
  streaming.kept_bytes = s.kept_bytes;
  streaming.hint_bytes = s.hint_bytes;
  streaming.read_bytes_per_second = s.read_bytes_per_second;
  streaming.max_level0_nodes = s.max_patches;
  streaming.max_nodes = s.max_nodes;
  streaming.decode_threads = static_cast<int>(s.decode_threads);
  streaming.background = true;
  return streaming;
}

// What the settings leave at its default is the recommendation's, where it has a say.
void takeCut(const SolverChoice& choice, FormfieldWorldSettings& s) {
  FormfieldWorldSettings defaults;
  formfieldDefaultWorldSettings(&defaults);
  const auto take = [](const auto& recommended, const auto& usual, auto& now) {
    if (recommended && now == usual) now = *recommended;
  };
  take(choice.radius_m, defaults.radius_m, s.radius_m);
  take(choice.growth, defaults.growth, s.growth);
  take(choice.max_patches, defaults.max_patches, s.max_patches);
}

bool isFinite(Vec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }
Vec3 vectorOf(const float* v) { return {v[0], v[1], v[2]}; }
std::span<const Vec3> vectors(const float* v, uint32_t count) { return {reinterpret_cast<const Vec3*>(v), count}; }

template <class Call>
FormfieldResult inWorld(FormfieldWorld world, Call&& call) noexcept {
  if (!world) {
    return guarded(errorOfThisThread(), [] { return Result<void>(usageError("world", "is NULL")); });
  }
  return guarded(world->device.error, [&] { return call(*world); });
}

}  // namespace

std::string& ff::runtime::errorOfThisThread() {
  thread_local std::string line;
  return line;
}

FormfieldResult ff::runtime::resultOf(const Error& error) {
  if (error.cause == ErrorCause::kOutOfDeviceMemory) return FORMFIELD_ERROR_OUT_OF_MEMORY;
  switch (error.code) {
    case ErrorCode::kUsage:
      return FORMFIELD_ERROR_USAGE;
    case ErrorCode::kIo:
      return FORMFIELD_ERROR_IO;
    case ErrorCode::kInvalidFile:
      return FORMFIELD_ERROR_INVALID_FILE;
    case ErrorCode::kPhysics:
      return FORMFIELD_ERROR_PHYSICS;
  }
  return FORMFIELD_ERROR_IO;
}

Result<void> FormfieldWorld_T::open() {
  // Before the file is opened: what takes its place meanwhile is seen at the first look.
  std::string known;
  if (settings.reload_seconds > 0) {
    auto version = formats::storageFor(path)->version(path);
    if (!version) return version.error();
    known = std::move(*version);
  }
  auto opened = openGeneration(choice);
  if (!opened) return opened.error();
  shown = std::move(*opened);
  auto made = device.makeSolver(world(), choice, slotsFor(settings.max_nodes));
  if (!made && settings.solver == FORMFIELD_SOLVER_AUTO && choice.kind != SolverKind::kGather) {
    // What was recommended on another device may exceed this one.
    choice.kind = SolverKind::kGather;
    choice.iterations = Updater::kAsLightNeeds;
    choice.why = "gather: " + made.error().line();
    made = device.makeSolver(world(), choice, slotsFor(settings.max_nodes));
  }
  if (!made) return made.error();
  solver = std::move(*made);
  tiles.reserve(kMaxSlots);
  probe_tiles.reserve(kMaxSlots);
  radiosity.reserve(kMaxSlots);
  if (settings.reload_seconds > 0) makeReloader(std::move(known));
  return {};
}

Result<std::unique_ptr<Generation>> FormfieldWorld_T::openGeneration(SolverChoice& to) {
  auto opened = formats::World::open(path);
  if (!opened) return opened.error();
  auto recommended = firstChoice(device, settings, path);
  if (!recommended) return recommended.error();
  FormfieldWorldSettings cut = settings;
  takeCut(*recommended, cut);
  if (cut.radius_m == 0) cut.radius_m = stream::StreamSettings().radius_m * opened->info().cell_m;  // which are of patches of 1 m: a world may be in any unit
  GenerationSettings with{streamSettings(cut), {.frames = settings.fade_frames, .most_change = settings.fade_change}, {}, settings.max_applied_tiles};
  if (settings.probes > 0) {
    with.probes.emplace();
    with.probes->rays = settings.probe_rays;
    with.probes->max_kept = settings.probes;
    with.probes->facet_bytes = settings.probe_memory_bytes;
  }
  to = std::move(*recommended);
  return Generation::create(std::move(*opened), with, current);
}

void FormfieldWorld_T::makeReloader(std::string known) {
  reloader.emplace(path, settings.reload_seconds, std::move(known), world(), [this] {
    SolverChoice beside;  // the solver stays
    return openGeneration(beside);
  });
}

namespace {

// What is counted from the start on, and goes on over a re-bake.
void addCounts(const stream::StreamStats& more, stream::StreamStats& sum) {
  for (const auto count : {&stream::StreamStats::reads, &stream::StreamStats::gap_bytes, &stream::StreamStats::strips_read, &stream::StreamStats::bytes_read, &stream::StreamStats::evicted, &stream::StreamStats::cancelled,
                           &stream::StreamStats::failed, &stream::StreamStats::reads_held})
    sum.*count += more.*count;
  sum.decode_ms += more.decode_ms;
}
void addCounts(const ProbeStats& more, ProbeStats& sum) {
  for (const auto count : {&ProbeStats::traced, &ProbeStats::kept, &ProbeStats::refused}) sum.*count += more.*count;
}

}  // namespace

// Between two frames.
void FormfieldWorld_T::takeUpReload(stream::Observers& now) {
  if (!reloader) return;
  reloader->follow(now, updater().lead());
  if (leaving || !reloader->ready()) return;
  leaving = std::exchange(shown, reloader->take());
  const Vec3 step = originStep(leaving->world->info(), world().info());
  now = now.moved(step);
  std::array<stream::Hint, stream::kMaxObservers> hints;
  const auto expected = leaving->streamer->expected();
  std::ranges::transform(expected, hints.begin(), [&](const stream::Hint& hint) { return stream::Hint{hint.at + step, hint.due}; });
  shown->streamer->expect(std::span(hints).first(expected.size()));
  updater().goOnFrom(leaving->updater);
  addCounts(leaving->streamer->stats(), strips_before);
  if (leaving->probes) addCounts(leaving->probes->stats(), probes_before);
  followed = ~uint64_t{0};
  ++reloads;
}

stream::StreamStats FormfieldWorld_T::streamStats() const {
  stream::StreamStats stats = shown->streamer->stats();
  addCounts(strips_before, stats);
  return stats;
}

ProbeStats FormfieldWorld_T::probeStats() const {
  ProbeStats stats = shown->probes->stats();
  addCounts(probes_before, stats);
  return stats;
}

void FormfieldWorld_T::askDirectLight(formats::TileId id, std::span<Vec3> out) {
  const auto& active = updater().matrix().tiles;
  const auto at = std::lower_bound(active.begin(), active.end(), id,
                                   [](const SlotRange& range, formats::TileId of) { return range.id < of; });
  const auto& strip = updater().strip(static_cast<size_t>(at - active.begin()));
  for (size_t i = 0; i < strip.nodes.size(); ++i) {
    const formats::Node& n = strip.nodes[i];
    nodes[i] = {{n.centroid.x, n.centroid.y, n.centroid.z},
                {n.normal.x, n.normal.y, n.normal.z},
                n.area_m2,
                {n.albedo.x, n.albedo.y, n.albedo.z}};
  }
  direct_light(direct_light_user, id.level, id.tile, strip.first_node, static_cast<uint32_t>(strip.nodes.size()),
               nodes.data(), &out.front().x);
}

Result<stream::Observers> FormfieldWorld_T::observersOf(std::span<const FormfieldObserver> given) const {
  if (given.empty() || given.size() > stream::kMaxObservers) return usageError("observers", "are none or more than 16", "give 1 to FORMFIELD_MAX_OBSERVERS");
  std::array<stream::Observer, stream::kMaxObservers> list;
  for (size_t i = 0; i < given.size(); ++i) {
    list[i] = {fromOrigin(given[i].position), vectorOf(given[i].velocity)};
    if (!isFinite(list[i].at) || !isFinite(list[i].velocity)) return usageError("observer", "or its velocity is not finite");
  }
  return stream::Observers(std::span(list).first(given.size()));
}

Result<void> FormfieldWorld_T::frame(const stream::Observers& now) {
  if (auto stepped = step(now); !stepped) return stepped;
  if (auto read = readRadiosity(); !read) return read;
  logFrame(frame_stats.steps_ms);
  return {};
}

void FormfieldWorld_T::logFrame(double steps_ms) {
  frame_ms = msSince(began) - steps_ms;
  log.add(began, frame_ms, frame_stats, streamStats(), observers, shown->world->info().origin);
}

Result<void> FormfieldWorld_T::step(stream::Observers now) {
  began = Clock::now();
  takeUpReload(now);
  observers = now;
  const int iterations = settings.iterations > 0 ? static_cast<int>(settings.iterations) : choice.iterations;
  const auto stats = updater().frame(now, iterations);
  if (leaving && updater().isTakenUp()) reloader->retire(std::move(leaving));
  if (!stats) return stats.error();
  followCut(*stats);
  return {};
}

void FormfieldWorld_T::followCut(const FrameStats& stats) {
  frame_stats = stats;
  light_zeroed += stats.light_zeroed;
  if (!stats.matrix_changed) return;
  ++change;
  const LocalMatrix& matrix = updater().matrix();
  shown->slots.follow(matrix.tiles);
}

const std::vector<FormfieldTile>& FormfieldWorld_T::tilesNow() {
  if (std::exchange(tiles_of, change) == change) return tiles;
  const LocalMatrix& matrix = updater().matrix();
  tiles.clear();
  for (size_t t = 0; t < matrix.tiles.size(); ++t) {
    const SlotRange& range = matrix.tiles[t];
    const formats::TileName& name = matrix.places[t].name;
    tiles.push_back({range.id.level, range.id.tile, {name.chunk[0], name.chunk[1], name.chunk[2]}, name.tile, range.first_slot, range.first_node, range.nodes});
  }
  return tiles;
}

Result<void> FormfieldWorld_T::readRadiosity() {
  residual_unseen = !updater().reflectedInMemory().empty();
  unseen = residual_unseen ? Unseen::kInMemory : Unseen::kNothing;
  if (residual_unseen) return {};
  radiosity.resize(updater().matrix().slots());
  if (auto read = updater().reflected(radiosity); !read) return read;
  residual = residual_monitor.look(updater().matrix(), updater().source(), radiosity);
  updater().show(radiosity);
  return {};
}

double FormfieldWorld_T::residualNow() {
  if (!std::exchange(residual_unseen, false)) return residual;
  const std::span<const Vec4> reflected = updater().reflectedInMemory();
  if (reflected.size() == updater().matrix().slots()) residual = residual_monitor.look(updater().matrix(), updater().source(), reflected);
  return residual;
}

const std::vector<Vec4>& FormfieldWorld_T::shownRadiosity() {
  const Unseen where = std::exchange(unseen, Unseen::kNothing);
  if (where == Unseen::kNothing) return radiosity;
  const std::span<const Vec4> reflected = where == Unseen::kInMemory ? updater().reflectedInMemory() : std::span<const Vec4>();
  if (where == Unseen::kInMemory && reflected.size() != updater().matrix().slots()) return radiosity;  // a frame has failed since
  radiosity.resize(updater().matrix().slots());
  if (where == Unseen::kRecorded)
    solver.recording->lastSeen(radiosity);
  else
    std::ranges::copy(reflected, radiosity.begin());
  updater().show(radiosity);
  return radiosity;
}

Result<void> FormfieldWorld_T::settle(float tolerance, uint32_t max_iterations) {
  if (change == 0) return usageError("world", "has had no frame yet", "call formfieldFrame first");
  if (!(tolerance > 0) || max_iterations > 1000000) return usageError("tolerance", "is not positive, or too many iterations");
  if (auto loaded = shown->streamer->settle(); !loaded) return loaded;
  updater().awaitCut();
  const auto stats = updater().frame(observers, 1);
  if (!stats) return stats.error();
  followCut(*stats);
  if (auto chosen = chooseByMatrix(); !chosen) return chosen;
  const auto converged = updater().converge(tolerance, static_cast<int>(max_iterations));
  if (!converged) return converged.error();
  settled = *converged;
  if (auto read = readRadiosity(); !read) return read;
  if (!shown->probes) return {};
  if (auto followed_now = sample({}, {}, {}); !followed_now) return followed_now;
  shown->probes->settle();
  return {};
}

// The first time that nothing but the matrix can say which solver suits it.
Result<void> FormfieldWorld_T::chooseByMatrix() {
  if (settings.solver != FORMFIELD_SOLVER_AUTO || !choice.why.empty()) return {};
  SolverChoice better = chooseSolver(updater().matrix());
  const auto leaves = static_cast<uint32_t>(updater().matrix().leaves.size());
  better.places = std::min(settings.dense_places, leaves + leaves / 4);
  better.storage = settings.storage == FORMFIELD_STORAGE_FLOAT16 ? Storage::kFloat16 : Storage::kFloat32;
  if (better.kind == SolverKind::kGather) better.iterations = choice.iterations;
  if (better.kind != choice.kind) {
    auto made = device.makeSolver(world(), better, slotsFor(settings.max_nodes));
    if (!made) return made.error();
    radiosity.resize(updater().matrix().slots());
    if (auto read = updater().reflected(radiosity); !read) return read;
    if (auto set = made->solver->update(updater().matrix(), {}); !set) return set;
    if (auto set = made->solver->setRadiosity(radiosity); !set) return set;
    if (auto set = made->solver->setSource(updater().source()); !set) return set;
    repaired_before += solver.solver->repaired();
    solver = std::move(*made);
  }
  choice = better;
  return {};
}

Result<void> FormfieldWorld_T::sample(std::span<const Vec3> points, std::span<const Vec3> normals, std::span<Vec3> out) {
  if (!shown->probes) return usageError("probes", "the world was opened without", "set FormfieldWorldSettings::probes");
  if (change == 0) return usageError("world", "has had no frame yet", "call formfieldFrame first");
  if (change != followed) {
    followed = change;
    shown->listProbeTiles(probe_tiles);
  }
  shown->probes->follow(observers, probe_tiles, updater().matrix().leaf, change);
  shown->probes->sample(points, normals, shownRadiosity(), sky, out);
  return {};
}

extern "C" {

uint32_t formfieldVersion(void) { return FF_VERSION_NUMBER; }
const char* formfieldVersionText(void) { return FF_VERSION_TEXT; }

const char* formfieldError(FormfieldDevice device) {
  return device ? device->error.c_str() : errorOfThisThread().c_str();
}

FormfieldResult formfieldCreateCpuDevice(int32_t threads, FormfieldDevice* device) {
  return guarded(errorOfThisThread(), [&]() -> Result<void> {
    if (!device) return usageError("device", "is NULL");
    *device = nullptr;
    if (threads < 0 || threads > 1024) return usageError("threads", "is not between 0 and 1024", "0 takes all cores");
    auto made = std::make_unique<CpuDevice>();
    made->threads = threads;
    made->name = "cpu";
    *device = made.release();
    return {};
  });
}

void formfieldDestroyDevice(FormfieldDevice device) { delete device; }
const char* formfieldDeviceName(FormfieldDevice device) { return device ? device->name.c_str() : ""; }

void formfieldDefaultWorldSettings(FormfieldWorldSettings* settings) {
  if (!settings) return;
  const stream::StreamSettings streaming;
  *settings = {};
  settings->size = sizeof(FormfieldWorldSettings);
  settings->radius_m = 0;
  settings->growth = streaming.growth;
  settings->hysteresis = streaming.hysteresis;
  settings->memory_bytes = streaming.memory_bytes;
  settings->kept_bytes = streaming.kept_bytes;
  settings->hint_bytes = streaming.hint_bytes;
  settings->max_patches = streaming.max_level0_nodes;
  settings->max_nodes = streaming.max_nodes;
  settings->decode_threads = 1;
  settings->solver = FORMFIELD_SOLVER_AUTO;
  settings->storage = FORMFIELD_STORAGE_FLOAT16;
  settings->dense_places = 4096;
  settings->iterations = 0;
  settings->probes = 256;
  settings->probe_rays = 256;
  settings->probe_memory_bytes = uint64_t{64} << 20;
  settings->fade_frames = FadeSettings::kFrames;
  settings->fade_change = FadeSettings().most_change;
  settings->logged_frames = 1024;
}

FormfieldResult formfieldOpenWorld(FormfieldDevice device, const char* path, const FormfieldWorldSettings* settings,
                                   FormfieldWorld* world) {
  if (!device) return guarded(errorOfThisThread(), [] { return Result<void>(usageError("device", "is NULL")); });
  return guarded(device->error, [&]() -> Result<void> {
    if (!path || !world) return usageError("path or world", "is NULL");
    *world = nullptr;
    FormfieldWorldSettings s;
    formfieldDefaultWorldSettings(&s);
    if (auto taken = takeSettings(settings, s); !taken) return taken;
    if (auto good = check(s); !good) return good;
    auto made = std::make_unique<FormfieldWorld_T>(*device, path, s);
    if (auto opened = made->open(); !opened) return opened;
    *world = made.release();
    return {};
  });
}

void formfieldCloseWorld(FormfieldWorld world) { delete world; }

FormfieldResult formfieldGetWorldInfo(FormfieldWorld world, FormfieldWorldInfo* info) {
  return inWorld(world, [&](FormfieldWorld_T& w) {
    const formats::WorldInfo& i = w.world().info();
    FormfieldWorldInfo report{};
    report.patches = w.world().levels()[0].nodes;
    report.levels = static_cast<uint32_t>(w.world().levels().size());
    report.cell_m = i.cell_m;
    for (int a = 0; a < 3; ++a) {
      report.origin[a] = i.origin[static_cast<size_t>(a)];
      report.lo[a] = i.bounds.lo[a];
      report.hi[a] = i.bounds.hi[a];
    }
    report.has_geometry = w.world().hasGeometry();
    report.preview = w.world().info().preview;
    report.lamp_groups = w.updater().lamps().groups();
    return giveReport(report, info);
  });
}

FormfieldResult formfieldSetDirectLight(FormfieldWorld world, FormfieldDirectLight direct_light, void* user) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    w.direct_light = direct_light;
    w.direct_light_user = user;
    w.updater().setDirectLight(direct_light ? [&w](formats::TileId id, std::span<Vec3> out) { w.askDirectLight(id, out); } : DirectLight());
    return {};
  });
}

FormfieldResult formfieldLightChanged(FormfieldWorld world) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    w.updater().lightChanged();
    return {};
  });
}

FormfieldResult formfieldSetDirectIrradiance(FormfieldWorld world, uint32_t first, uint32_t count,
                                             const float* irradiance) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (first > kMaxSlots || count > kMaxSlots - first) return usageError("slots", "reach past FORMFIELD_MAX_SLOTS");
    if (count > 0 && !irradiance) return usageError("irradiance", "is NULL");
    return w.updater().setDirectIrradiance(first, vectors(irradiance, count));
  });
}

FormfieldResult formfieldSetSky(FormfieldWorld world, const FormfieldSky* sky) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!sky) return usageError("sky", "is NULL");
    Sky set;
    set.l0 = vectorOf(sky->radiance);
    for (int c = 0; c < 3; ++c) {
      set.l1[c] = vectorOf(sky->gradient[c]);
      std::copy_n(sky->quadratic[c], 5, set.l2[c].begin());
    }
    if (auto taken = w.updater().setSky(set); !taken) return taken;
    w.sky = set;
    return {};
  });
}

FormfieldResult formfieldLampGroups(FormfieldWorld world, uint32_t first, uint32_t count, FormfieldLampGroup* groups) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    const std::vector<formats::LampGroup>& known = w.world().info().lamp_groups;
    if (first > known.size() || count > known.size() - first) return usageError("lamp groups", "reach past the world's last one");
    if (count > 0 && !groups) return usageError("groups", "is NULL");
    for (uint32_t i = 0; i < count; ++i) {
      const formats::LampGroup& g = known[first + i];
      groups[i] = {g.name.c_str(), {g.emission.x, g.emission.y, g.emission.z}, static_cast<float>(g.area_m2), g.patches};
    }
    return {};
  });
}

FormfieldResult formfieldFindLampGroup(FormfieldWorld world, const char* name, uint32_t* group) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!name || !group) return usageError("name or group", "is NULL");
    const std::vector<formats::LampGroup>& known = w.world().info().lamp_groups;
    const auto at = std::find_if(known.begin(), known.end(), [&](const formats::LampGroup& g) { return g.name == name; });
    if (at == known.end()) return usageError(name, "is no lamp group of this world", "see formfieldLampGroups, or ffinspect info");
    *group = static_cast<uint32_t>(at - known.begin());
    return {};
  });
}

FormfieldResult formfieldSetEmission(FormfieldWorld world, uint32_t group, const float scale[3]) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!scale) return usageError("scale", "is NULL");
    if (group >= w.updater().lamps().groups())
      return usageError("group", "is no lamp group of this world", "see formfieldLampGroups, or ffinspect info");
    const Vec3 set = vectorOf(scale);
    if (!isFinite(set)) return usageError("scale", "is not finite");
    if (set.x < 0 || set.y < 0 || set.z < 0) return usageError("scale", "is negative", "a lamp that is off has 0");
    return w.updater().setLamp(group, set);
  });
}

FormfieldResult formfieldFrame(FormfieldWorld world, const double observer[3], const float velocity[3]) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!observer) return usageError("observer", "is NULL");
    const FormfieldObserver given = observerOf(observer, velocity);
    const auto one = w.observersOf({&given, 1});
    return one ? w.frame(*one) : Result<void>(one.error());
  });
}

FormfieldResult formfieldFrameFor(FormfieldWorld world, uint32_t count, const FormfieldObserver* observers) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!observers) return usageError("observers", "is NULL");
    const auto all = w.observersOf({observers, count});
    return all ? w.frame(*all) : Result<void>(all.error());
  });
}

FormfieldResult formfieldExpect(FormfieldWorld world, uint32_t count, const FormfieldPlace* places) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (count > stream::kMaxObservers) return usageError("places", "are more than 16", "give at most FORMFIELD_MAX_OBSERVERS");
    if (count > 0 && !places) return usageError("places", "is NULL");
    std::array<stream::Hint, stream::kMaxObservers> hints;
    for (uint32_t i = 0; i < count; ++i) {
      const FormfieldPlace& place = places[i];
      hints[i].at = w.fromOrigin(place.position);
      if (!isFinite(hints[i].at) || !(place.seconds >= 0 && place.seconds <= 1e6f)) return usageError("place", "or its time is not finite, or the time is negative");
      hints[i].due = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<float>(place.seconds));
    }
    w.shown->streamer->expect(std::span(hints).first(count));
    return {};
  });
}

const float* formfieldRadiosity(FormfieldWorld world, uint32_t* slots) {
  if (slots) *slots = 0;
  if (!world) return nullptr;
  const std::vector<Vec4>& radiosity = world->shownRadiosity();
  if (slots) *slots = static_cast<uint32_t>(radiosity.size());
  return radiosity.empty() ? nullptr : &radiosity.front().x;
}

FormfieldResult formfieldSample(FormfieldWorld world, uint32_t count, const float* points, const float* normals,
                                float* irradiance) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (count > 0 && (!points || !normals || !irradiance)) return usageError("points, normals or irradiance", "is NULL");
    return w.sample(vectors(points, count), vectors(normals, count), {reinterpret_cast<Vec3*>(irradiance), count});
  });
}

FormfieldResult formfieldSettle(FormfieldWorld world, float tolerance, uint32_t max_iterations) {
  return inWorld(world, [&](FormfieldWorld_T& w) { return w.settle(tolerance, max_iterations); });
}

const FormfieldTile* formfieldTiles(FormfieldWorld world, uint32_t* count, uint64_t* change) {
  if (count) *count = 0;
  if (change) *change = world ? world->change : 0;
  if (!world) return nullptr;
  const std::vector<FormfieldTile>& tiles = world->tilesNow();
  if (count) *count = static_cast<uint32_t>(tiles.size());
  return tiles.data();
}

FormfieldResult formfieldPatchSlots(FormfieldWorld world, uint64_t first, uint32_t count, uint32_t* slots) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    const uint64_t patches = w.world().levels()[0].nodes;
    if (first > patches || count > patches - first) return usageError("patches", "reach past the world's last one");
    if (count > 0 && !slots) return usageError("slots", "is NULL");
    for (uint32_t i = 0; i < count;) {
      const auto tile = w.world().tileOfNode(0, first + i);
      if (!tile) return tile.error();
      w.shown->listed.insert(tile->chunk);
      auto index = static_cast<uint32_t>(first + i - tile->info().first_node);
      for (; i < count && index < tile->info().nodes; ++i, ++index) slots[i] = w.shown->slots.slotOf(*tile, index);
    }
    return {};
  });
}

FormfieldResult formfieldSlotNode(FormfieldWorld world, uint32_t slot, uint32_t* level, uint64_t* node) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    const SlotRange* range = w.shown->slots.tileOf(slot);
    if (!range) return usageError("slot", "belongs to no active tile", "see formfieldTiles");
    if (level) *level = range->id.level;
    if (node) *node = range->first_node + slot - range->first_slot;
    return {};
  });
}

FormfieldResult formfieldGetStats(FormfieldWorld world, FormfieldStats* stats) {
  return inWorld(world, [&](FormfieldWorld_T& w) {
    const FrameStats& f = w.frame_stats;
    const stream::StreamStats s = w.streamStats();
    FormfieldStats report{};
    report.slots = f.slots;
    report.leaves = f.leaves;
    report.level0_leaves = f.level0_leaves;
    report.entries = f.entries;
    report.cut_changed = f.matrix_changed;
    report.stream_ms = f.stream_ms;
    report.matrix_ms = f.matrix_ms;
    report.solve_ms = f.solve_ms;
    report.strips_read = s.strips_read;
    report.bytes_read = s.bytes_read;
    report.strips_evicted = s.evicted;
    report.reads_cancelled = s.cancelled;
    report.strips_failed = s.failed;
    report.resident_bytes = s.resident_bytes;
    report.peak_resident_bytes = s.peak_resident_bytes;
    report.resident_tiles = s.resident_tiles;
    report.wanted_tiles = s.wanted_tiles;
    report.pending_tiles = s.pending_tiles;
    report.fallbacks = w.solver.fellBack();
    if (w.solver.dense && !w.solver.fellBack()) {
      const DenseStats& d = *w.solver.dense;
      report.dense_nodes = d.on_places;
      report.dense_waiting = d.waiting;
      report.dense_refused = d.refused;
      report.dense_rebuilds = d.rebuilds;
      report.dense_probe = d.probe;
    }
    report.residual = w.residualNow();
    if (w.shown->probes) {
      const ProbeStats p = w.probeStats();
      report.probes_traced = p.traced;
      report.probes_remembered = p.kept;
      report.probe_tiles = p.facet_tiles;
      report.samples_refused = p.refused;
    }
    const FrameLog::Times times = w.log.times();
    report.frame_ms_p50 = times.p50_ms;
    report.frame_ms_p99 = times.p99_ms;
    report.frame_ms_max = times.max_ms;
    report.frame_ms = w.frame_ms;
    report.late_tiles = s.late_tiles;
    report.ahead_tiles = s.ahead_tiles;
    report.light_zeroed = w.light_zeroed;
    report.light_repaired = w.repaired_before + w.solver.solver->repaired();
    report.applied_tiles = f.applied_tiles;
    report.waiting_tiles = f.waiting_tiles;
    report.reads_held = s.reads_held;
    report.reloads = w.reloads;
    report.reload_failures = w.reloader ? w.reloader->failures() : 0;
    report.reads = s.reads;
    report.gap_bytes = s.gap_bytes;
    report.decode_ms = s.decode_ms;
    report.peak_stored_bytes = s.peak_stored_bytes;
    report.reached_radius_m = s.reach.radius_m;
    report.reached_growth = s.reach.growth;
    const UploadedBytes uploaded = w.solver.solver->uploaded();
    report.uploaded_row_bytes = uploaded.rows;
    report.uploaded_light_bytes = uploaded.light;
    report.settle_iterations = static_cast<uint32_t>(w.settled.iterations);
    report.settled = w.settled.settled;
    report.settle_change = w.settled.change;
    return giveReport(report, stats);
  });
}

FormfieldResult formfieldReload(FormfieldWorld world) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!w.reloader) try {
        w.makeReloader({});
      } catch (const std::system_error& e) {
        return Error{ErrorCode::kIo, w.path, "", std::string("cannot start a thread: ") + e.what(), "close other programs"};
      }
    w.reloader->ask();
    return {};
  });
}

const char* formfieldReloadFailure(FormfieldWorld world) {
  if (!world) return "";
  (void)guarded(world->device.error, [&]() -> Result<void> {
    world->reload_failure = world->reloader ? world->reloader->failure() : "";
    return {};
  });
  return world->reload_failure.c_str();
}

FormfieldResult formfieldWriteTrace(FormfieldWorld world, const char* path) {
  return inWorld(world, [&](FormfieldWorld_T& w) -> Result<void> {
    if (!path) return usageError("path", "is NULL");
    if (w.settings.logged_frames == 0) return usageError("logged_frames", "is 0: no frame is kept", "set FormfieldWorldSettings::logged_frames");
    const std::string trace = w.log.trace();
    return formats::writeWholeFile(*formats::posixStorage(), path, std::as_bytes(std::span(trace)));
  });
}

const char* formfieldSolverName(FormfieldWorld world) { return world ? world->solver.solver->name() : ""; }

const char* formfieldFallbackReason(FormfieldWorld world) {
  return world && world->solver.fallback_reason ? world->solver.fallback_reason->c_str() : "";
}

const char* formfieldSolverReason(FormfieldWorld world) { return world ? world->choice.why.c_str() : ""; }

const char* formfieldLightFault(FormfieldWorld world) { return world ? world->updater().lightFault().c_str() : ""; }

const char* formfieldStreamFailure(FormfieldWorld world) {
  if (!world) return "";
  (void)guarded(world->device.error, [&]() -> Result<void> {
    world->stream_failure = world->shown->streamer->lastFailure();
    if (world->stream_failure.empty() && world->shown->probes && world->shown->probes->stats().starved)
      world->stream_failure = "out of memory or threads for the triangles that probes meet; close other programs, or lower probe_memory_bytes";
    return {};
  });
  return world->stream_failure.c_str();
}

const char* formfieldBudgetWarning(FormfieldWorld world) {
  if (!world) return "";
  (void)guarded(world->device.error, [&]() -> Result<void> {
    const stream::StreamStats s = world->streamStats();
    const auto& origin = world->world().info().origin;
    const auto at = [&](size_t a) { return origin[a] + static_cast<double>(s.first_short_at[static_cast<int>(a)]); };
    constexpr const char* kNames[] = {"", "max_nodes", "max_patches", "memory_bytes"};
    char text[256] = "";
    if (s.first_short.short_of != stream::Budget::kNone)
      std::snprintf(text, sizeof text, "%s ran out at (%.9g, %.9g, %.9g) m: there was room for a radius of %.3g m and a growth of %.3g; raise it, or ask for less",
                    kNames[static_cast<size_t>(s.first_short.short_of)], at(0), at(1), at(2), static_cast<double>(s.first_short.radius_m), static_cast<double>(s.first_short.growth));
    world->budget_warning = text;
    return {};
  });
  return world->budget_warning.c_str();
}

const char* formfieldStorageWarning(FormfieldWorld world) {
  if (!world) return "";
  (void)guarded(world->device.error, [&]() -> Result<void> {
    world->storage_warning = formats::storageFor(world->path)->warning();
    return {};
  });
  return world->storage_warning.c_str();
}

}  // extern "C"
