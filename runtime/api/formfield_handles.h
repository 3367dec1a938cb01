// What is behind the handles of formfield.h. Internal: formfield.cpp and formfield_vulkan.cpp.
#pragma once
#include <algorithm>
#include <array>
#include <memory>
#include <new>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "runtime/api/formfield.h"
#include "runtime/choose_solver.h"
#include "runtime/cut/slot_map.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/frame_log.h"
#include "runtime/probes/probes.h"
#include "runtime/reload.h"
#include "runtime/solver/residual_monitor.h"
#include "runtime/updater.h"

namespace ff::runtime {

// A solver that can write its steps into somebody else's command buffer.
class Recording {
 public:
  virtual ~Recording() = default;
  virtual Result<void> record(int iterations) = 0;
  // Instead of asking the device while a frame is recorded: what slots reflect as last seen, which lags.
  virtual void lastSeen(std::span<Vec4> reflected) const = 0;
  // Slots were given out anew, and go on from this.
  virtual void goOnFrom(std::span<const Vec4> reflected) = 0;
};

// The solver of a world, and what there is to know of it.
struct WorldSolver {
  std::unique_ptr<Solver> solver;
  const std::string* fallback_reason = nullptr;  // the solver's; null: there is nothing to fall back from
  const DenseStats* dense = nullptr;             // of the solver, or of the one that it may fall back from
  std::unique_ptr<Recording> recording{};        // null: the solver cannot; not to be used after it fell back
  std::unique_ptr<std::string> own_reason{};     // where the device failed before it had begun
  bool fellBack() const { return fallback_reason && !fallback_reason->empty(); }
};

}  // namespace ff::runtime

struct FormfieldDevice_T {
  virtual ~FormfieldDevice_T() = default;
  virtual ff::Result<ff::runtime::WorldSolver> makeSolver(const ff::formats::World& world,
                                                          const ff::runtime::SolverChoice& choice, uint32_t max_slots) = 0;
  // Whether worlds here are meant to record frames, and what can: `auto` then takes nothing else.
  bool records() const { return records(ff::runtime::SolverKind::kGather); }
  virtual bool records(ff::runtime::SolverKind) const { return false; }
  virtual uint64_t submissions() const { return 0; }  // of our own to a queue, for tests: each is waited for
  std::string name, error;
};

struct FormfieldWorld_T {
  FormfieldWorld_T(FormfieldDevice_T& on, std::string from, const FormfieldWorldSettings& with) : device(on), path(std::move(from)), settings(with), log(with.logged_frames) {}
  FormfieldWorld_T(const FormfieldWorld_T&) = delete;
  FormfieldWorld_T& operator=(const FormfieldWorld_T&) = delete;

  ff::Result<void> open();
  // The world's file as it is now. choice: what is recommended beside it, or the settings say.
  ff::Result<std::unique_ptr<ff::runtime::Generation>> openGeneration(ff::runtime::SolverChoice& choice);
  void makeReloader(std::string known);
  void takeUpReload(ff::stream::Observers& observers);
  ff::runtime::Updater& updater() const { return shown->updater; }
  const ff::formats::World& world() const { return *shown->world; }
  // Of all generations together, where they count since the start.
  ff::stream::StreamStats streamStats() const;
  ff::runtime::ProbeStats probeStats() const;
  // Of a place in the scene's world space.
  ff::Vec3 fromOrigin(const double at[3]) const {
    const auto& origin = world().info().origin;
    return {static_cast<float>(at[0] - origin[0]), static_cast<float>(at[1] - origin[1]), static_cast<float>(at[2] - origin[2])};
  }
  // Those of a call; errors: too many, none, or a number that is not finite.
  ff::Result<ff::stream::Observers> observersOf(std::span<const FormfieldObserver> given) const;
  // The frame but for reading its light back, and logging it.
  ff::Result<void> step(ff::stream::Observers observers);
  void logFrame(double steps_ms);  // steps_ms: what its thread has spent on the solver's steps
  ff::Result<void> frame(const ff::stream::Observers& observers);
  ff::Result<void> settle(float tolerance, uint32_t max_iterations);
  ff::Result<void> sample(std::span<const ff::Vec3> points, std::span<const ff::Vec3> normals, std::span<ff::Vec3> out);
  void askDirectLight(ff::formats::TileId id, std::span<ff::Vec3> out);
  void followCut(const ff::runtime::FrameStats& stats);
  ff::Result<void> chooseByMatrix();
  ff::Result<void> readRadiosity();
  // Made when somebody asks: not every frame is looked at.
  const std::vector<ff::runtime::Vec4>& shownRadiosity();
  double residualNow();
  const std::vector<FormfieldTile>& tilesNow();

  FormfieldDevice_T& device;
  const std::string path;
  const FormfieldWorldSettings settings;
  ff::runtime::SolverChoice choice;
  ff::runtime::WorldSolver solver;
  // Between the updater and whatever solver is in use.
  struct Current final : ff::runtime::Solver {
    explicit Current(const FormfieldWorld_T& w) : world(w) {}
    Solver& now() const { return *world.solver.solver; }
    ff::Result<void> update(const ff::runtime::LocalMatrix& m, const ff::runtime::MatrixChange& c) override {
      return now().update(m, c);
    }
    // Asked before there is a solver, too, and by the thread that opens a re-bake. (The seed does not; it is a baseline.)
    bool resolvesRows() const override { return world.device.records(); }
    ff::Result<void> setSource(std::span<const ff::runtime::Vec4> source) override { return now().setSource(source); }
    ff::Result<void> setEnteredSource(std::span<const ff::runtime::Vec4> source, const ff::runtime::MatrixChange& c, bool stays) override {
      return now().setEnteredSource(source, c, stays);
    }
    // A frame is being recorded, and update() has not just fallen back: nothing waits for the device.
    bool records() const { return world.recording && !world.solver.fellBack(); }
    ff::Result<void> setRadiosity(std::span<const ff::runtime::Vec4> b) override {
      if (world.recording) world.solver.recording->goOnFrom(b);
      return now().setRadiosity(b);
    }
    void ease(uint32_t frames) override { now().ease(frames); }
    void pace(const ff::runtime::LightPace& p) override { now().pace(p); }
    ff::Result<void> iterate(int k) override { return records() ? world.solver.recording->record(k) : now().iterate(k); }
    ff::Result<void> approach(int k) override { return now().approach(k); }
    uint64_t repaired() const override { return now().repaired(); }
    ff::Result<void> radiosity(std::span<ff::runtime::Vec4> out) override {
      if (!records()) return now().radiosity(out);
      world.solver.recording->lastSeen(out);
      return {};
    }
    std::span<const ff::runtime::Vec4> inMemory() override { return records() ? std::span<const ff::runtime::Vec4>() : now().inMemory(); }
    ff::runtime::UploadedBytes uploaded() const override { return now().uploaded(); }
    double lastMs() const override { return now().lastMs(); }
    const char* name() const override { return now().name(); }
    const FormfieldWorld_T& world;
  } current{*this};
  bool recording = false;  // iterate() records
  std::unique_ptr<ff::runtime::Generation> shown;
  std::unique_ptr<ff::runtime::Generation> leaving;  // the solver may still look at it
  ff::stream::StreamStats strips_before;             // of generations that left
  ff::runtime::ProbeStats probes_before;
  uint32_t reloads = 0;
  ff::runtime::ResidualMonitor residual_monitor;
  ff::runtime::Sky sky;
  FormfieldDirectLight direct_light = nullptr;
  void* direct_light_user = nullptr;

  // Of the last frame.
  std::chrono::steady_clock::time_point began;
  double frame_ms = 0;  // but for the solver's steps
  ff::stream::Observers observers;
  ff::runtime::FrameStats frame_stats;
  ff::runtime::FrameLog log;
  ff::runtime::Settled settled;  // by the last settle()
  uint64_t light_zeroed = 0;     // since the start
  uint64_t repaired_before = 0;  // by solvers that are no longer in use
  double residual = -1;
  enum class Unseen { kNothing, kInMemory, kRecorded };
  Unseen unseen = Unseen::kNothing;  // light of the last frame is where the solver has it, or recorded, and not in `radiosity` yet
  bool residual_unseen = false;      // it was not looked at yet
  uint64_t tiles_of = 0;             // `change` of `tiles`
  uint64_t change = 0, followed = ~uint64_t{0};  // the cut: its number, and the one that the probes know
  std::vector<FormfieldTile> tiles;
  std::vector<ff::runtime::ProbeTile> probe_tiles;
  std::vector<ff::runtime::Vec4> radiosity;  // shownRadiosity(), but for what is unseen
  std::array<FormfieldNode, ff::formats::kTileNodes> nodes;  // of the tile whose light is asked for
  std::string stream_failure, reload_failure, budget_warning, storage_warning;
  std::optional<ff::runtime::Reloader> reloader;  // the first to go: its thread opens generations
};

namespace ff::runtime {

// Where the line of an error goes when there is no device yet: this thread's.
std::string& errorOfThisThread();

FormfieldResult resultOf(const Error& error);

// Runs a call behind the C interface: what goes wrong becomes a code and a line.
template <class Call>
FormfieldResult guarded(std::string& line, Call&& call) noexcept {
  try {
    const Result<void> done = call();
    if (done) return FORMFIELD_OK;
    line = done.error().line();
    return resultOf(done.error());
  } catch (const std::bad_alloc&) {
    line = "out of memory";  // short enough to need none
    return FORMFIELD_ERROR_OUT_OF_MEMORY;
  } catch (...) {
    line = "internal error";
    return FORMFIELD_ERROR_IO;
  }
}

inline FormfieldObserver observerOf(const double at[3], const float velocity[3]) {  // velocity: null is none
  FormfieldObserver observer{};
  std::copy_n(at, 3, observer.position);
  if (velocity) std::copy_n(velocity, 3, observer.velocity);
  return observer;
}

inline Error usageError(const char* place, std::string message, const char* remedy = "") {
  return {ErrorCode::kUsage, "", place, message, remedy};
}

// Copies as many bytes as both sides know; what the caller's structure does not have keeps its default.
template <class Settings>
Result<void> takeSettings(const Settings* given, Settings& out) {
  if (!given) return {};
  if (given->size < sizeof(uint32_t) || given->size > sizeof(Settings))
    return usageError("size", "is not that of this structure", "set it to sizeof, or use the function for the defaults");
  const uint32_t size = sizeof(Settings);
  std::copy_n(reinterpret_cast<const std::byte*>(given), given->size, reinterpret_cast<std::byte*>(&out));
  out.size = size;
  return {};
}

}  // namespace ff::runtime
