// ff_bench_stream: flies through a world in real time, 60 frames a second, with nothing of it in the kernel's page cache: how late tiles are,
// what the frame's thread has to do, what the disk reads, what crosses the bus to a device, and how much the light of surfaces jumps under light that
// does not change (by night: lit windows are the hard case, where a cluster stands for several lamps). Prints JSON lines.
#include <fcntl.h>
#include <sched.h>
#include <unistd.h>
#include <zstd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <fstream>
#include <set>

#include "formats/codec/records.h"
#include "runtime/dense/cpu_multibounce.h"
#include "runtime/full_solve.h"
#include "runtime/gather/shown_light.h"
#include "runtime/reload.h"
#include "runtime/updater.h"
#include "runtime/vulkan/context.h"
#include "stream/file_source.h"
#include "stream/strip_loader.h"
#include "tests/bench/flight_paths.h"
#include "tests/bench/late_source.h"
#include "tests/bench/surface_light.h"
#include "tests/bench/truth.h"

namespace {

using namespace ff;
using namespace ff::bench;

constexpr double kFrameSeconds = 1.0 / 60;
constexpr float kJump = 0.02f;
constexpr int kFramesBefore = 24;
constexpr double kPauseSeconds = 0.05;  // by which a frame begins late where the whole machine stood still: the path waits, as a game does
constexpr int kFramesAfterTheft = 30;  // that what the host has taken may still make late

struct Options {
  std::string world, reader, path, replay, solver = "gather";
  uint64_t patches = 60000;
  uint32_t max_patches = stream::StreamSettings().max_level0_nodes, max_nodes = stream::StreamSettings().max_nodes, places = 4096;
  uint32_t rays = 512;
  double seconds = 15;
  float height_m = 1.6f;
  float delay_ms = 0;
  double hint_seconds = 0.5;
  uint32_t max_applied_tiles = 0;
  uint64_t bytes_per_second = 0;
  uint32_t fade_frames = runtime::FadeSettings::kFrames;  // as the C interface does
  float fade_change = runtime::FadeSettings().most_change;
  bool quick = false, day = false, warm = false, unhurried = false, in_frame = false, vulkan = false, stepped = false, own_core = false, real_time = false;
  int iterations() const { return solver == "gather" ? runtime::Updater::kAsLightNeeds : 1; }  // a frame, as the C interface does
};

// Where the thread, and those that it starts, may run.
enum class Cores { kAll, kFirst, kOthers };
void runOn(Cores which) {
  cpu_set_t cores;
  CPU_ZERO(&cores);
  for (unsigned core = which == Cores::kOthers ? 1 : 0; core < (which == Cores::kFirst ? 1 : std::thread::hardware_concurrency()); ++core) CPU_SET(core, &cores);
  if (sched_setaffinity(0, sizeof cores, &cores) != 0) std::fprintf(stderr, "ff_bench_stream: the system does not let threads have cores of their own\n");
}

// Whether other threads may take the thread's core. Those that it starts have the same policy.
void keepCore(bool keep) {
  const sched_param priority{.sched_priority = keep ? 1 : 0};
  if (sched_setscheduler(0, keep ? SCHED_FIFO : SCHED_OTHER, &priority) != 0) std::fprintf(stderr, "ff_bench_stream: the system does not let threads keep their core\n");
}

// Bytes that the kernel has read from disks for this process.
uint64_t deviceBytes() {
  std::ifstream in("/proc/self/io");
  std::string name;
  uint64_t value = 0;
  while (in >> name >> value)
    if (name == "read_bytes:") return value;
  return 0;
}

// Time that a virtual machine's host has given to others, of all cores together, in ticks of 10 ms.
uint64_t stolenTicks() {
  std::ifstream in("/proc/stat");
  std::string name;
  uint64_t user = 0, nice = 0, system = 0, idle = 0, iowait = 0, irq = 0, softirq = 0, steal = 0;
  in >> name >> user >> nice >> system >> idle >> iowait >> irq >> softirq >> steal;
  return steal;
}

void dropFromPageCache(const formats::World& world) {
  const std::string folder = formats::folderOf(world.path());
  for (const formats::ShardInfo& shard : world.shards()) {
    const int fd = ::open((folder + shard.name).c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) continue;
    ::fdatasync(fd);  // pages that are not written yet stay
    ::posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
    ::close(fd);
  }
}

// A solver as the C interface makes it.
std::unique_ptr<runtime::Solver> makeSolver(const Options& options, const formats::World& world) {
  const runtime::MultibounceSettings dense{.places = options.places, .storage = runtime::Storage::kFloat16};
  if (!options.vulkan) {
    if (options.solver == "gather") return runtime::makeCpuGather();
    return runtime::makeDenseSolver(orExit(runtime::makeCpuMultibounce(dense)));
  }
  static const std::shared_ptr<runtime::VkContext> context = orExit(runtime::openVulkan());
  const runtime::VulkanGatherSettings room = runtime::gatherRoomFor(world, runtime::slotsFor(options.max_nodes));
  return options.solver == "gather" ? orExit(runtime::makeVulkanRecorder(context, room)) : orExit(runtime::makeVulkanDenseRecorder(context, room, dense));
}

// Times a solver's steps, so that a frame can be told without them.
class TimedSolver final : public runtime::Solver {
 public:
  explicit TimedSolver(std::unique_ptr<Solver> of) : of_(std::move(of)) {}
  // Whose steps it makes. A recorder is told what it shows, as where it records.
  void follow(const runtime::Updater& updater) { updater_ = &updater; }
  Result<void> update(const runtime::LocalMatrix& m, const runtime::MatrixChange& c) override { return timed(update_, [&] { return of_->update(m, c); }); }
  Result<void> setSource(std::span<const Vec4> source) override { return timed(update_, [&] { return of_->setSource(source); }); }
  Result<void> setEnteredSource(std::span<const Vec4> source, const runtime::MatrixChange& c, bool stays) override { return timed(update_, [&] { return of_->setEnteredSource(source, c, stays); }); }
  Result<void> setRadiosity(std::span<const Vec4> b) override { return timed(update_, [&] { return of_->setRadiosity(b); }); }
  void ease(uint32_t frames) override { of_->ease(frames); }
  void pace(const runtime::LightPace& pace) override { of_->pace(pace); }
  bool resolvesRows() const override { return of_->resolvesRows(); }
  Result<void> iterate(int k) override {
    if (auto* const recorder = dynamic_cast<runtime::VulkanRecorder*>(of_.get()); recorder && updater_)
      if (auto told = timed(update_, [&] { return shown_.tell(*recorder, *updater_); }); !told) return told;
    return timed(steps_, [&] { return of_->iterate(k); });
  }
  Result<void> approach(int k) override { return timed(steps_, [&] { return of_->approach(k); }); }
  Result<void> radiosity(std::span<Vec4> out) override { return of_->radiosity(out); }
  uint64_t repaired() const override { return of_->repaired(); }
  runtime::UploadedBytes uploaded() const override { return of_->uploaded(); }
  double lastMs() const override { return of_->lastMs(); }
  const char* name() const override { return of_->name(); }

  struct Spent {
    double wall_ms = 0, cpu_ms = 0;
  };
  Spent takeSteps() { return std::exchange(steps_, {}); }    // since the last call
  Spent takeUpdate() { return std::exchange(update_, {}); }  // taking up matrices and light

 private:
  template <class Call>
  static Result<void> timed(Spent& spent, Call&& call) {
    const auto began = Clock::now();
    const double cpu = threadMs();
    auto result = call();
    spent.cpu_ms += threadMs() - cpu;
    spent.wall_ms += msSince(began);
    return result;
  }
  std::unique_ptr<Solver> of_;
  const runtime::Updater* updater_ = nullptr;
  runtime::ShownLight shown_;
  Spent steps_, update_;
};

runtime::Sky skyOf(const Options& options) {
  runtime::Sky sky;
  sky.l0 = options.day ? Vec3{1.1f, 1.4f, 1.9f} : Vec3{0.002f, 0.003f, 0.004f};
  return sky;
}

// How many of many values are how large, to a hundredth. Takes no memory as it grows: a list of all grew to hundreds of MB, and frames stood still while it did.
class Counts {
 public:
  void add(std::span<const float> values) {
    for (const float value : values) {
      ++bins_[binOf(value)];
      most_ = std::max(most_, value);
      ++values_;
    }
  }
  double quantile(double share) const {
    const auto rank = static_cast<uint64_t>(share * static_cast<double>(values_));
    uint64_t before = 0;
    for (size_t bin = 0; bin < bins_.size(); ++bin)
      if ((before += bins_[bin]) > rank) return std::min(most(), kLeast * std::pow(kStep, static_cast<double>(bin)));
    return most();
  }
  double most() const { return static_cast<double>(most_); }

 private:
  static constexpr double kLeast = 1e-9, kStep = 1.01;
  static size_t binOf(float value) {
    const double x = static_cast<double>(value);
    return x > kLeast ? std::min<size_t>(kBins - 1, static_cast<size_t>(std::ceil(std::log(x / kLeast) / std::log(kStep)))) : 0;
  }
  static constexpr size_t kBins = 4096;  // up to 5e8
  std::vector<uint64_t> bins_ = std::vector<uint64_t>(kBins);
  uint64_t values_ = 0;
  float most_ = 0;
};

std::string number(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", x);
  return text;
}

// What a path's passes came to.
struct Flown {
  std::vector<double> frame_ms, frame_cpu_ms, stream_ms, matrix_ms, solver_update_cpu_ms, steps_ms, nodes, entries;
  std::vector<double> uploaded, uploaded_rows, uploaded_light;  // KiB a frame
  Counts near, far;
  double most_undisturbed_ms = 0;  // of frames in which the host took nothing
  uint64_t late_after_theft = 0, late_over_budget = 0, stolen_ticks = 0;
  double paused_seconds = 0;
  uint64_t frames = 0, frames_late = 0, late = 0, wanted = 0, frames_jump_near = 0, frames_jump_far = 0, changes = 0;
  SurfaceLight::Error near_error, far_error;
  uint32_t most_applied = 0;  // tiles that entered in a frame
  uint64_t device_bytes = 0, read_bytes = 0, gap_bytes = 0, used_bytes = 0, strips = 0, reads = 0, cancelled = 0, failed = 0;
  double seconds = 0;
  std::vector<double> whole_after_ms;  // of teleports: until nothing was late
};

// Tiles of the world that lie within their radius, their ancestors too, and are not in the matrix: by the definition alone, the chunks that nobody has read
// yet included. 0 where the budget of patches acts as a smaller radius.
uint64_t lateByDefinition(const formats::WholeWorld& world, const stream::StreamSettings& settings, Vec3 observer, std::span<const SlotRange> active) {
  uint64_t late = 0, patches = 0;
  for (const SlotRange& range : active) patches += range.id.level == 0 ? range.nodes : 0;
  if (patches + formats::kTileNodes > settings.max_level0_nodes) return 0;  // those that hysteresis keeps count
  std::vector<char> above, here;  // by tile: wanted
  for (uint32_t level = world.top(); level + 1 > 0; --level) {
    const float radius = settings.radius_m * std::pow(settings.growth, static_cast<float>(level));
    here.assign(world.tiles(level).size(), 0);
    for (const formats::TileInfo& info : world.tiles(level)) {
      here[info.id.tile] = level == world.top() || (above[info.parent_tile] && info.bounds.distance(observer) < radius);
      if (!here[info.id.tile]) continue;
      late += !std::ranges::binary_search(active, info.id, {}, &SlotRange::id);
    }
    above.swap(here);
  }
  return late;
}

// hint_seconds: before every teleport the streamer is told where it goes; 0: it is not.
void fly(const Options& options, const formats::WholeWorld& whole, SurfaceLight& surface, const FlightPath& path, double hint_seconds, Flown& flown) {
  for (int pass = 0; pass < path.passes; ++pass) {
    const formats::World world = orExit(formats::World::open(whole.path()));  // its index is read as it flies
    if (options.own_core) runOn(Cores::kOthers);
    std::unique_ptr<stream::TileSource> source = options.reader == "threads" ? stream::makeThreadSource(world)
                                                 : options.reader == "io_uring" ? orExit(stream::makeUringSource(world))
                                                                                : stream::makeFileSource(world);
    if (options.delay_ms > 0) source = std::make_unique<LateSource>(std::move(source), std::chrono::microseconds(static_cast<int64_t>(1000 * options.delay_ms)));
    stream::StreamSettings settings;
    settings.radius_m *= whole.info().cell_m;
    settings.read_bytes_per_second = options.bytes_per_second;
    settings.max_level0_nodes = options.max_patches;
    settings.max_nodes = options.max_nodes;
    settings.background = !options.in_frame;
    const auto streamer = orExit(stream::Streamer::create(world, settings, std::move(source)));
    TimedSolver solver(makeSolver(options, world));
    Clock::time_point now_stepped = Clock::now();
    runtime::Updater updater(world, *streamer, solver, runtime::FarLight::kPyramid, !options.in_frame, {.frames = options.fade_frames, .most_change = options.fade_change}, options.max_applied_tiles,
                             options.stepped ? stream::Now([&] { return now_stepped; }) : Clock::now);
    solver.follow(updater);
    orExit(updater.setSky(skyOf(options)));
    const FlightPath::Moment first = path.moment(pass, 0);
    streamer->update(first.at, first.velocity);
    orExit(streamer->settle());
    for (int k = kFramesBefore; k-- > 0;) {  // as one that is flying already: what it takes to build a matrix is known, and how long frames are
      if (!options.stepped) std::this_thread::sleep_for(std::chrono::duration<double>(kFrameSeconds));
      now_stepped += std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(kFrameSeconds));
      updater.awaitCut();
      (void)orExit(updater.frame(first.at - first.velocity * static_cast<float>(k * kFrameSeconds), first.velocity, 1));
      orExit(streamer->settle());
    }
    (void)orExit(updater.converge(1e-5f, 2000));
    std::vector<Vec4> radiosity(updater.matrix().slots());
    orExit(updater.reflected(radiosity));
    surface.forget();
    surface.look(first.at, updater.matrix(), radiosity);
    std::set<formats::TileId> there, used;
    for (const stream::StripPtr& strip : streamer->active()) there.insert(strip->id);
    if (!options.warm) dropFromPageCache(world);
    if (options.own_core) runOn(Cores::kFirst);
    if (options.real_time) keepCore(true);
    (void)solver.takeSteps();
    (void)solver.takeUpdate();
    const uint64_t device_before = deviceBytes();
    const stream::StreamStats before = streamer->stats();
    const auto frames = static_cast<int>(path.pass_seconds / kFrameSeconds);
    auto start = Clock::now();  // of frame 0, had there been no pause
    int jumped_at = -1, stolen_at = -kFramesAfterTheft;
    uint64_t stolen = stolenTicks();
    for (int f = 1; f <= frames; ++f) {
      if (options.stepped) {
        orExit(streamer->settle());
        updater.awaitBuild();
        now_stepped += std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(kFrameSeconds));
      } else {
        const auto due = start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(f * kFrameSeconds));
        std::this_thread::sleep_until(due);
        if (const auto late = Clock::now() - due; late > std::chrono::duration<double>(kPauseSeconds)) {
          start += late;
          flown.paused_seconds += std::chrono::duration<double>(late).count();
          stolen_at = f;
        }
      }
      const FlightPath::Moment now = path.moment(pass, f * kFrameSeconds);
      if (hint_seconds > 0)
        if (const FlightPath::Moment then = path.moment(pass, f * kFrameSeconds + hint_seconds); then.jumped) {
          const stream::Hint hint{then.at, Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(hint_seconds))};
          streamer->expect({&hint, 1});
        }
      if (options.unhurried) {
        streamer->update(now.at, now.velocity);
        orExit(streamer->settle());
      }
      const auto began = Clock::now();
      const double cpu = threadMs();
      const runtime::UploadedBytes uploaded = solver.uploaded();
      const runtime::FrameStats stats = orExit(updater.frame(now.at, now.velocity, options.iterations()));
      const double frame_ms = msSince(began), frame_cpu_ms = threadMs() - cpu;
      const TimedSolver::Spent steps = solver.takeSteps(), update = solver.takeUpdate();
      flown.frame_ms.push_back(frame_ms - steps.wall_ms);
      flown.steps_ms.push_back(steps.wall_ms);
      uint64_t nodes = 0;
      for (const SlotRange& range : updater.matrix().tiles) nodes += range.nodes;
      flown.nodes.push_back(static_cast<double>(nodes));
      flown.entries.push_back(static_cast<double>(updater.matrix().used_entries));
      if (const uint64_t now_stolen = stolenTicks(); now_stolen != stolen) {
        flown.stolen_ticks += now_stolen - std::exchange(stolen, now_stolen);
        stolen_at = f;
      }
      if (stolen_at != f) flown.most_undisturbed_ms = std::max(flown.most_undisturbed_ms, flown.frame_ms.back());
      flown.frame_cpu_ms.push_back(frame_cpu_ms - steps.cpu_ms);
      flown.solver_update_cpu_ms.push_back(update.cpu_ms);
      const auto kib = [](uint64_t bytes) { return static_cast<double>(bytes) / 1024; };
      flown.uploaded_rows.push_back(kib(stats.uploaded.rows - uploaded.rows));
      flown.uploaded_light.push_back(kib(stats.uploaded.light - uploaded.light));
      flown.uploaded.push_back(flown.uploaded_rows.back() + flown.uploaded_light.back());
      flown.stream_ms.push_back(stats.stream_ms);
      flown.matrix_ms.push_back(stats.matrix_ms - update.wall_ms);
      flown.changes += stats.matrix_changed;
      flown.most_applied = std::max(flown.most_applied, stats.applied_tiles);
      const stream::StreamStats s = streamer->stats();
      ++flown.frames;
      const uint64_t late = lateByDefinition(whole, settings, now.at, updater.matrix().tiles);
      flown.frames_late += late > 0;
      flown.late += late;
      if (f - stolen_at < kFramesAfterTheft)
        flown.late_after_theft += late;
      else if (s.reach.short_of != stream::Budget::kNone)
        flown.late_over_budget += late;
      flown.wanted += s.wanted_tiles;
      if (length(now.at - path.moment(pass, (f - 1) * kFrameSeconds).at) > 5) jumped_at = f;
      if (jumped_at >= 0 && late == 0) {
        flown.whole_after_ms.push_back(1000 * kFrameSeconds * (f - jumped_at + 1));
        jumped_at = -1;
      }
      if (stats.matrix_changed)
        for (const stream::StripPtr& strip : streamer->active())
          if (!there.contains(strip->id) && used.insert(strip->id).second) flown.used_bytes += strip->tile.info().strip.stored_bytes;
      radiosity.resize(updater.matrix().slots());
      orExit(updater.reflected(radiosity));
      updater.fade().blend(updater.matrix(), radiosity);
      surface.look(now.at, updater.matrix(), radiosity);
      flown.near_error += surface.nearError();
      flown.far_error += surface.farError();
      const auto most = [](const std::vector<float>& changes) { return changes.empty() ? 0.0f : *std::ranges::max_element(changes); };
      flown.frames_jump_near += most(surface.near()) > kJump;
      flown.frames_jump_far += most(surface.far()) > kJump;
      flown.near.add(surface.near());
      flown.far.add(surface.far());
    }
    if (options.own_core) runOn(Cores::kAll);
    if (options.real_time) keepCore(false);
    flown.seconds += path.pass_seconds;
    flown.device_bytes += deviceBytes() - device_before;
    const stream::StreamStats after = streamer->stats();
    flown.read_bytes += after.bytes_read - before.bytes_read;
    flown.gap_bytes += after.gap_bytes - before.gap_bytes;
    flown.strips += after.strips_read - before.strips_read;
    flown.reads += after.reads - before.reads;
    flown.cancelled += after.cancelled - before.cancelled;
    flown.failed += after.failed - before.failed;
  }
}

void report(const std::string& name, const FlightPath& path, Flown& flown) {
  const auto ratio = [](auto a, auto b) { return b > 0 ? static_cast<double>(a) / static_cast<double>(b) : 0; };
  const auto percent = [&](auto a, auto b) { return number(100 * ratio(a, b)) + " %"; };
  const std::string note = name + "; " + path.name + ": " + std::to_string(flown.frames) + " frames in " + std::to_string(path.passes) + " passes";
  std::string after;
  if (!flown.whole_after_ms.empty()) {
    const double middle = quantile(flown.whole_after_ms, 0.5);
    after = "; nothing late any more " + number(middle) + " ms after a teleport, at most " + number(flown.whole_after_ms.back()) + " ms, " +
            std::to_string(flown.whole_after_ms.size()) + " teleports";
  }
  print("stream.late_tiles", static_cast<double>(flown.late), "tiles", 0,
        note + "; tiles within their radius that were not active, summed over frames; in " + percent(flown.frames_late, flown.frames) + " of the frames, " +
            percent(flown.late, flown.wanted) + " of the wanted tiles; " + std::to_string(flown.late_after_theft) + " of them in the half second after the host of this machine took its cores away (" +
            std::to_string(10 * flown.stolen_ticks) + " ms in all, and pauses of " + number(flown.paused_seconds) + " s), " + std::to_string(flown.late_over_budget) + " others where a budget had run out; " + std::to_string(flown.strips) + " strips read, " + std::to_string(flown.failed) + " failed, " +
            std::to_string(flown.cancelled) + " dropped from the queue" + after);
  const auto cpu = [&](double share) {
    return number(quantile(flown.frame_cpu_ms, share)) + ", of these the solver's tables " + number(quantile(flown.solver_update_cpu_ms, share)) + "; on the clock the streamer " +
           number(quantile(flown.stream_ms, share)) + ", matrix and light " + number(quantile(flown.matrix_ms, share));
  };
  const auto over_limit = std::ranges::count_if(flown.frame_ms, [](double ms) { return ms > 1; });
  for (const auto& [metric, share, limit] : {std::tuple{"stream.frame_p50_ms", 0.5, std::nan("")}, std::tuple{"stream.frame_p99_ms", 0.99, 0.2},
                                             std::tuple{"stream.frame_max_ms", 1.0, 1.0}})
    print(metric, quantile(flown.frame_ms, share), "ms", limit,
          note + "; the frame's thread but for the solver's steps, on the clock; " + std::to_string(over_limit) + " frames took more than 1 ms; ms of a core's time " + cpu(share) + "; the cut changed in " + std::to_string(flown.changes) + " frames, by at most " + std::to_string(flown.most_applied) + " tiles; at most " + number(flown.most_undisturbed_ms) + " ms where the host of this machine took nothing",
          "cpu");
  print("stream.nodes", quantile(flown.nodes, 0.5), "nodes", std::nan(""),
        note + "; in the matrix, wanted or fading, median; at most " + number(quantile(flown.nodes, 1)) + "; entries " + number(quantile(flown.entries, 0.5)) + ", at most " + number(quantile(flown.entries, 1)) +
            "; the solver's steps " + number(quantile(flown.steps_ms, 0.5)) + " ms a frame, 99 of a hundred below " + number(quantile(flown.steps_ms, 0.99)),
        "cpu");
  if (quantile(flown.uploaded, 1) > 0)
    for (const auto& [metric, share] : {std::pair{"stream.uploaded_p50_kib", 0.5}, std::pair{"stream.uploaded_p99_kib", 0.99}, std::pair{"stream.uploaded_max_kib", 1.0}})
      print(metric, quantile(flown.uploaded, share), "KiB", std::nan(""),
            note + "; what crosses the bus to the device in a frame; of rows alone " + number(quantile(flown.uploaded_rows, share)) + ", of light " + number(quantile(flown.uploaded_light, share)), "vulkan");
  print("stream.read_amplification", ratio(flown.device_bytes, flown.used_bytes), "ratio", 2.5,
        note + "; bytes that the disk read over those of strips that became active, " + number(static_cast<double>(flown.used_bytes) / 1e6) + " MB; strips read over the same " +
            number(ratio(flown.read_bytes, flown.used_bytes)) + ", with what lies between them " + number(ratio(flown.read_bytes + flown.gap_bytes, flown.used_bytes)) + "; " + number(static_cast<double>(flown.device_bytes) / 1e6 / flown.seconds) + " MB/s from the disk");
  print("stream.strips_a_read", ratio(flown.strips, flown.reads), "strips", std::nan(""), note + "; " + std::to_string(flown.strips) + " strips in " + std::to_string(flown.reads) + " reads, neighbours in one");
  print("stream.pop_p99", flown.near.quantile(0.99), "relative", 0.01,
        note + "; change from frame to frame of what fixed patches within 12 m reflect, over the mean within 30 m; worst " + number(flown.near.most()) + ", above 2 % in " +
            percent(flown.frames_jump_near, flown.frames) + " of the frames");
  print("stream.pop_far_p999", flown.far.quantile(0.999), "relative", std::nan(""),
        note + "; the same at 12 to 30 m, 999 of a thousand; 99 of a hundred below " + number(flown.far.quantile(0.99)) + ", worst " + number(flown.far.most()) + ", above 2 % in " +
            percent(flown.frames_jump_far, flown.frames) + " of the frames");
  print("stream.moving_error", flown.near_error.relative(), "relative", 0,
        note + "; rms over all frames of what fixed patches within 12 m reflect, against the whole world solved in double precision; at 12 to 30 m " + number(flown.far_error.relative()));
}

// A world that is opened anew while frames go on: what the frame that changes over takes, and how long until it comes.
void printReload(const formats::WholeWorld& whole, const std::string& name, const Options& options) {
  constexpr int kReloads = 9;
  TimedSolver solver(runtime::makeCpuGather());
  runtime::GenerationSettings settings;
  settings.stream.radius_m *= whole.info().cell_m;
  settings.stream.background = true;
  settings.fade.frames = options.fade_frames;
  settings.fade.most_change = options.fade_change;
  const auto open = [&] { return runtime::Generation::create(orExit(formats::World::open(whole.path())), settings, solver); };
  std::unique_ptr<runtime::Generation> shown = orExit(open());
  runtime::Reloader reloader(whole.path(), 0, "", *shown->world, open);
  orExit(shown->updater.setSky(skyOf(options)));
  const Box& bounds = whole.info().bounds;
  Vec3 at = bounds.lo + (bounds.hi - bounds.lo) * 0.3f;
  at.y = options.height_m;
  const Vec3 velocity{5, 0, 0};
  std::vector<double> over_ms, over_cpu_ms, other_ms, ready_after_ms;
  for (auto asked_at = Clock::now(); over_ms.size() < kReloads;) {
    std::this_thread::sleep_for(std::chrono::duration<double>(kFrameSeconds));
    at += velocity * static_cast<float>(kFrameSeconds);
    const auto began = Clock::now();
    const double cpu = threadMs();
    const stream::Observers observers(stream::Observer{at, velocity});
    reloader.follow(observers, shown->updater.lead());
    std::unique_ptr<runtime::Generation> before;
    if (reloader.ready()) {
      before = std::exchange(shown, reloader.take());
      shown->updater.goOnFrom(before->updater);
    }
    (void)orExit(shown->updater.frame(observers, options.iterations()));
    const TimedSolver::Spent steps = solver.takeSteps();
    (before ? over_ms : other_ms).push_back(msSince(began) - steps.wall_ms);
    if (before) {
      over_cpu_ms.push_back(threadMs() - cpu - steps.cpu_ms);
      ready_after_ms.push_back(msSince(asked_at));
      reloader.retire(std::move(before));
    }
    if (other_ms.size() % 60 == 30) {
      reloader.ask();
      asked_at = Clock::now();
    }
  }
  const double middle = quantile(over_ms, 0.5);
  print("stream.reload_frame_ms", middle, "ms", quantile(other_ms, 0.5),
        name + "; the frame that changes over to a re-bake, but for the solver's steps, on the clock: median of " + std::to_string(kReloads) + ", at most " + number(over_ms.back()) + "; " + number(quantile(over_cpu_ms, 0.5)) +
            " ms of a core's time; limit: the median of other frames (99 of a hundred take at most " + number(quantile(other_ms, 0.99)) + "); ready " + number(quantile(ready_after_ms, 0.5)) + " ms after it was asked for",
        "cpu");
}

// Decoding into the form that solvers use, beside zstd alone on the same strips, round by round.
void printDecoding(const formats::WholeWorld& world, const std::string& name) {
  std::vector<std::pair<formats::TileRef, std::vector<std::byte>>> strips;
  size_t largest = 0;
  const auto tiles = world.tiles(0);
  for (size_t t = 0; t < tiles.size(); t += std::max<size_t>(1, tiles.size() / 200)) {
    std::vector<std::byte> stored(tiles[t].strip.stored_bytes);
    orExit(world.readStored(tiles[t].strip, stored));
    largest = std::max<size_t>(largest, tiles[t].strip.raw_bytes);
    strips.emplace_back(world.ref(tiles[t].id), std::move(stored));
  }
  std::vector<char> buffer(largest);
  const std::unique_ptr<ZSTD_DCtx, size_t (*)(ZSTD_DCtx*)> context(ZSTD_createDCtx(), ZSTD_freeDCtx);
  std::vector<double> ratios;
  for (int round = 0; round < 9; ++round) {
    double began = threadMs();
    for (const auto& [tile, stored] : strips)
      if (ZSTD_isError(ZSTD_decompressDCtx(context.get(), buffer.data(), buffer.size(), stored.data() + formats::kStripHeaderBytes, stored.size() - formats::kStripHeaderBytes)))
        std::exit(3);
    const double bare = threadMs() - began;
    began = threadMs();
    for (const auto& [tile, stored] : strips) (void)orExit(stream::decodeAndPack(world, tile, stored));
    ratios.push_back(bare / (threadMs() - began));
  }
  const double middle = median(ratios);
  print("stream.decode_ratio_to_bare_zstd", middle, "ratio", 0.6,
        name + "; one core, " + std::to_string(strips.size()) + " strips of level 0, into the form that solvers use; median of " + std::to_string(ratios.size()) + " rounds, " +
            number(ratios.front()) + " to " + number(ratios.back()));
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"Flies through a world at 60 frames a second, its files out of the page cache: late tiles, the frame's thread, the disk, and jumps of light. One JSON object a line.",
               "ff_bench_stream"};
  app.add_option("--world", options.world, "a baked world; without it a town is baked");
  app.add_flag("--quick", options.quick, "a smaller town, shorter paths");
  app.add_option("--patches", options.patches, "of the town that is baked: 60000, 60k, 1M")->transform(CLI::AsSizeValue(true))->capture_default_str();
  app.add_option("--solver", options.solver, "gather or multibounce")->check(CLI::IsMember({"gather", "multibounce"}))->capture_default_str();
  app.add_option("--places", options.places, "of multibounce's dense matrix")->check(CLI::Range(64, 65536))->capture_default_str();
  app.add_flag("--vulkan", options.vulkan, "on a Vulkan device, as an engine records it");
  app.add_option("--max-patches", options.max_patches, "of the finest level, active at once")->capture_default_str();
  app.add_option("--max-nodes", options.max_nodes, "of all levels, wanted at once")->check(CLI::Range(1u, runtime::kMaxSlots))->capture_default_str();
  app.add_flag("--stepped", options.stepped, "a frame follows when all that the one before asked for is there, and finds that 1/60 s has passed: for solvers that take longer");
  app.add_flag("--own-core", options.own_core, "the frame's thread has the first core for itself, all others share the rest");
  app.add_flag("--real-time", options.real_time, "the frame's thread keeps its core until it waits (SCHED_FIFO)");
  app.add_option("--rays", options.rays, "a patch, of the town that is baked")->capture_default_str();
  app.add_option("--seconds", options.seconds, "of each path, about")->check(CLI::Range(1.0, 3600.0))->capture_default_str();
  app.add_option("--path", options.path, "paths whose names begin so, reload, or decoding; all without it");
  app.add_option("--replay", options.replay, "a path that formfieldWriteTrace has recorded, instead of those; give --world");
  app.add_option("--height", options.height_m, "of the eyes, m, in the world's coordinates")->capture_default_str();
  app.add_option("--reader", options.reader, "io_uring or threads; what streams choose without it")->check(CLI::IsMember({"io_uring", "threads"}));
  app.add_option("--delay", options.delay_ms, "ms that every read takes longer")->check(CLI::Range(0.0f, 10000.0f));
  app.add_option("--hint", options.hint_seconds, "s before a teleport that the streamer is told where it goes; such paths are flown without and with it; 0: without")
      ->check(CLI::Range(0.0, 0.9))
      ->capture_default_str();
  app.add_option("--tiles", options.max_applied_tiles, "that enter a frame's matrix, at most; 0: no limit")->capture_default_str();
  app.add_option("--bytes", options.bytes_per_second, "of strips that are read a second, at most; 0: no limit")->transform(CLI::AsSizeValue(false))->capture_default_str();
  app.add_flag("--day", options.day, "under a bright sky: lamps are on all the same");
  app.add_flag("--warm", options.warm, "leaves the files in the page cache");
  app.add_option("--fade", options.fade_frames, "frames that a tile takes to come or to go, at least; 0: it does so at once")->capture_default_str();
  app.add_option("--change", options.fade_change, "of the mean of what lies near, that a surface's light may change in a frame for a new cut; 0: no limit")->check(CLI::Range(0.0f, 1e6f))->capture_default_str();
  app.add_flag("--in-frame", options.in_frame, "the streamer's work is done and new matrices are put together within the frame");
  app.add_flag("--unhurried", options.unhurried, "every frame waits until all is there: what changes of the cut cost by themselves");
  CLI11_PARSE(app, argc, argv);
  if (options.quick) options.seconds = std::min(options.seconds, 4.0);
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_stream_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::WholeWorld world =
      orExit(formats::WholeWorld::open(options.world.empty() ? bakeTown(folder, options.quick, options.patches, options.rays) : options.world));
  const runtime::Sky sky = skyOf(options);
  const auto source = orExit(runtime::fullSource(world, {}, sky, runtime::Lamps(world.info())));
  SurfaceLight surface(world, orExit(runtime::solveFullWorld(world, source, {.tolerance = 1e-6})).radiosity);
  const std::string name = std::to_string(world.levels()[0].nodes) + " patches, " + options.solver + (options.vulkan ? " on Vulkan" : "") + (options.stepped ? ", stepped" : "") + (options.delay_ms > 0 ? ", reads " + number(options.delay_ms) + " ms late" : "");
  const bool recorded = !options.replay.empty();
  for (const FlightPath& path : recorded ? std::vector{orExit(recordedPath(options.replay, world.info().origin))} : flightPaths(world.info().bounds, options.height_m, options.seconds)) {
    if (!recorded && !path.name.starts_with(options.path)) continue;
    for (const bool hinted : {false, true}) {
      if (hinted && (!path.teleports || options.hint_seconds == 0)) continue;
      const double hint_seconds = hinted ? options.hint_seconds : 0;
      Flown flown;
      fly(options, world, surface, path, hint_seconds, flown);
      report(name + (hinted ? ", told " + number(hint_seconds) + " s before" : ""), path, flown);
    }
  }
  if (!recorded && std::string("reload").starts_with(options.path)) printReload(world, name, options);
  if (!recorded && std::string("decoding").starts_with(options.path)) printDecoding(world, name);
  std::filesystem::remove_all(folder);
  return 0;
}
