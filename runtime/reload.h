// Hot reload: a world that is baked again while it is shown. A Generation is one bake of it with all that is near the observers; a Reloader looks whether the
// world's file has been replaced, and opens and prepares the next generation on a thread of its own, so that a frame only takes it.
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/cut/slot_map.h"
#include "runtime/probes/probes.h"
#include "runtime/updater.h"
#include "stream/streamer.h"

namespace ff::runtime {

struct GenerationSettings {
  stream::StreamSettings stream;
  FadeSettings fade;
  std::optional<ProbeSettings> probes;
  uint32_t max_applied_tiles = 0;
};

// What a re-bake is prepared for.
struct Followed {
  stream::Observers observers;
  stream::Lead lead;
};

// One thread at a time.
struct Generation {
  // Loads the coarsest level. solver: outlives it, and is not called before the first frame. Errors: as Streamer::create.
  static Result<std::unique_ptr<Generation>> create(formats::World opened, const GenerationSettings& settings, Solver& solver);
  Generation(std::unique_ptr<formats::World> opened, std::unique_ptr<stream::Streamer> strips, const GenerationSettings& settings, Solver& solver);

  // Before the first frame: brings near what observers want, puts its matrix together and loads the probes' triangles, for kMaxPrepareSeconds at most
  // or until `stop`. where: asked time and again, in this world's coordinates. Errors: a shard is missing or too short, a strip near the observers cannot be read.
  Result<void> prepare(const formats::WorldInfo& before, const std::function<Followed()>& where, const std::atomic<bool>& stop);
  // The cut's tiles as Probes::follow() takes them.
  void listProbeTiles(std::vector<ProbeTile>& tiles) const;

  const std::unique_ptr<const formats::World> world;
  const std::unique_ptr<stream::Streamer> streamer;
  Updater updater;
  SlotMap slots;
  std::optional<Probes> probes;
  std::set<formats::ChunkPtr> listed;  // kept for those who ask for patches by number: they will again
};

inline constexpr float kMaxPrepareSeconds = 5;

class Reloader {
 public:
  // On the reloader's thread: opens the world's file as it is now, with the settings that go with it.
  using Open = std::function<Result<std::unique_ptr<Generation>>()>;
  // path: of the world. seconds: between looks at it (Storage::version); 0: only ask() makes it look. known: its version when `shown` was opened, empty
  // with 0 seconds. shown: the generation that a taken one will follow. Throws std::system_error where there is no thread.
  Reloader(std::string path, float seconds, std::string known, const formats::World& shown, Open open);
  ~Reloader();

  // The frame's: they allocate and free nothing, and the lock that they take guards only swaps.
  // Opens what is there now, whatever its version.
  void ask();
  // Where observers are, in the coordinates of the generation that is shown, and what its streamer has for a lead.
  void follow(const stream::Observers& observers, const stream::Lead& lead);
  // Whether take() has a generation; no lock.
  bool ready() const { return ready_count_.load() != 0; }
  // Prepared, to be shown from now on.
  std::unique_ptr<Generation> take();
  // Frees one that is not shown any more, on the reloader's thread.
  void retire(std::unique_ptr<Generation> generation);

  // Why the last attempt came to nothing, as a line: what was shown goes on. Empty: it did not fail. Any thread; allocates.
  std::string failure() const;
  uint32_t failures() const { return failures_.load(); }  // attempts that failed, those that say the same as the one before left out

 private:
  using Clock = std::chrono::steady_clock;
  void work();
  void look(bool asked);
  Result<std::unique_ptr<Generation>> openNext(bool asked);
  void fail(const std::string& line);

  const std::string path_;
  const float seconds_;
  const Open open_;
  // The thread's.
  std::string known_;            // version of the last attempt's file
  formats::WorldInfo before_;    // of the generation that is shown, or ready
  uint64_t checksum_ = 0;        // likewise
  bool failed_ = false;
  Clock::time_point retry_at_;   // after a failure: what is being copied may have come whole since

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool asked_ = false;
  Followed followed_;
  std::unique_ptr<Generation> ready_, retired_;
  std::string failure_;
  std::atomic<uint32_t> ready_count_{0}, failures_{0};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace ff::runtime
