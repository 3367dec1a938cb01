#include "runtime/reload.h"

#include <chrono>
#include <new>
#include <system_error>
#include <utility>

#include "stream/start_threads.h"

namespace ff::runtime {
namespace {

constexpr std::chrono::milliseconds kLook{2};  // at what has come
constexpr std::chrono::seconds kRetry{5};

}  // namespace

Result<std::unique_ptr<Generation>> Generation::create(formats::World opened, const GenerationSettings& settings, Solver& solver) {
  auto world = std::make_unique<formats::World>(std::move(opened));
  auto streamer = stream::Streamer::create(*world, settings.stream);
  if (!streamer) return streamer.error();
  return std::make_unique<Generation>(std::move(world), std::move(*streamer), settings, solver);
}

Generation::Generation(std::unique_ptr<formats::World> opened, std::unique_ptr<stream::Streamer> strips, const GenerationSettings& settings, Solver& solver)
    : world(std::move(opened)), streamer(std::move(strips)), updater(*world, *streamer, solver, FarLight::kPyramid, true, settings.fade, settings.max_applied_tiles), slots(updater.matrix().most_slots) {
  if (settings.probes) probes.emplace(*world, slots, *settings.probes);
}

Result<void> Generation::prepare(const formats::WorldInfo& before, const std::function<Followed()>& where, const std::atomic<bool>& stop) {
  if (auto whole = world->openShards({.cancelled = &stop}); !whole) return whole;
  const auto until = std::chrono::steady_clock::now() + std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<float>(kMaxPrepareSeconds));
  const auto wait = [&](const auto& pending) {
    while (!stop && pending() && std::chrono::steady_clock::now() < until) std::this_thread::sleep_for(kLook);
  };
  wait([&] {
    const Followed now = where();
    streamer->setLead(now.lead);
    streamer->update(now.observers);
    return streamer->stats().pending_tiles > 0;
  });
  if (streamer->stats().failed > 0) return Error{ErrorCode::kInvalidFile, "", "", streamer->lastFailure(), ""};
  if (auto built = updater.prepare(before); !built) return built;
  if (!probes) return {};
  std::vector<ProbeTile> tiles;
  listProbeTiles(tiles);
  slots.follow(updater.matrix().tiles);
  probes->follow(where().observers, tiles, updater.matrix().leaf, 0);
  wait([&] { return !probes->settled(); });
  return {};
}

void Generation::listProbeTiles(std::vector<ProbeTile>& tiles) const {
  tiles.clear();
  for (const auto& tile : updater.matrix().tiles) tiles.push_back({tile.id, tile.first_slot, updater.strip(tiles.size()).nodes});
}

Reloader::Reloader(std::string path, float seconds, std::string known, const formats::World& shown, Open open)
    : path_(std::move(path)), seconds_(seconds), open_(std::move(open)), known_(std::move(known)), before_(shown.info()), checksum_(shown.checksum()) {
  thread_ = stream::startThread([this] { work(); });
}

Reloader::~Reloader() {
  stop_ = true;
  ask();
  thread_.join();
}

void Reloader::ask() {
  {
    const std::lock_guard lock(mutex_);
    asked_ = true;
  }
  wake_.notify_one();
}

void Reloader::follow(const stream::Observers& observers, const stream::Lead& lead) {
  const std::lock_guard lock(mutex_);
  followed_ = {observers, lead};
}

std::unique_ptr<Generation> Reloader::take() {
  std::unique_ptr<Generation> taken;
  {
    const std::lock_guard lock(mutex_);
    ready_count_ = 0;
    taken = std::move(ready_);
  }
  return taken;
}

void Reloader::retire(std::unique_ptr<Generation> generation) {
  {
    const std::lock_guard lock(mutex_);
    FF_CHECK_EQ(retired_ == nullptr, true);  // the one before was freed before another was made ready
    retired_ = std::move(generation);
  }
  wake_.notify_one();
}

std::string Reloader::failure() const {
  const std::lock_guard lock(mutex_);
  return failure_;
}

void Reloader::work() {
  std::unique_lock lock(mutex_);
  while (!stop_) {
    const auto wanted = [this] { return stop_ || retired_ || (asked_ && !ready_); };
    if (seconds_ > 0)
      wake_.wait_for(lock, std::chrono::duration<float>(seconds_), wanted);
    else
      wake_.wait(lock, wanted);
    std::unique_ptr<Generation> retired = std::move(retired_);
    const bool looks = !stop_ && !ready_ && !retired;  // one that nobody has taken yet, as where no frames are made, stands
    const bool asked = looks && std::exchange(asked_, false);
    lock.unlock();
    retired.reset();
    if (looks) look(asked);
    lock.lock();
  }
}

void Reloader::look(bool asked) try {
  auto version = formats::storageFor(path_)->version(path_, {.cancelled = &stop_});
  if (!version) return fail(version.error().line());
  const bool same = std::exchange(known_, *version) == *version;
  if (!asked && same && !(failed_ && Clock::now() >= retry_at_)) return;
  auto next = openNext(asked);
  if (stop_) return;
  if (!next) return fail(next.error().line());
  failed_ = false;
  const std::lock_guard lock(mutex_);
  failure_.clear();
  if (!*next) return;
  before_ = (*next)->world->info();
  checksum_ = (*next)->world->checksum();
  ready_ = std::move(*next);
  ready_count_ = 1;
} catch (const std::bad_alloc&) {
  fail("out of memory");
} catch (const std::system_error& e) {
  fail(path_ + ": cannot start a thread: " + e.what());
}

// Null: it is the one that is shown.
Result<std::unique_ptr<Generation>> Reloader::openNext(bool asked) {
  auto next = open_();
  if (!next) return next;
  if (!asked && (*next)->world->checksum() == checksum_) return std::unique_ptr<Generation>();
  const Vec3 step = originStep(before_, (*next)->world->info());
  const auto where = [&] {
    Followed now;
    {
      const std::lock_guard lock(mutex_);
      now = followed_;
    }
    now.observers = now.observers.moved(step);
    return now;
  };
  if (auto prepared = (*next)->prepare(before_, where, stop_); !prepared) return prepared.error();
  return next;
}

void Reloader::fail(const std::string& line) {
  failed_ = true;
  retry_at_ = Clock::now() + kRetry;
  const std::lock_guard lock(mutex_);
  if (failure_ == line) return;
  failure_ = line;
  ++failures_;
}

}  // namespace ff::runtime
