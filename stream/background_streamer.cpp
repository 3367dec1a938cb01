#include "stream/background_streamer.h"

#include <algorithm>
#include <array>
#include <condition_variable>
#include <mutex>
#include <new>
#include <optional>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "stream/start_threads.h"

namespace ff::stream {
namespace {

class BackgroundStreamer final : public Streamer {
 public:
  // Throws std::system_error where no thread can be started, and leaves `of` alone then.
  explicit BackgroundStreamer(std::unique_ptr<Streamer>& of) : Streamer({of->radii().begin(), of->radii().end()}, of->maxNodes()), active_(of->activeList()), stats_taken_(of->stats()), stats_(stats_taken_) {
    expected_.reserve(kMaxObservers);
    Streamer* const plain = of.get();
    thread_ = startThread([this, plain] { work(*plain); });
    of_ = std::move(of);
  }

  ~BackgroundStreamer() override {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    asked_again_.notify_one();
    thread_.join();
  }

  using Streamer::update;
  bool update(const Observers& observers) override {
    (void)forgetHints(expected_);
    observers_ = observers;
    updated_ = true;
    std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock) return false;  // whoever has it may have lost its core: the next frame
    const bool changed = takeUp();
    ask();
    const bool sleeps = sleeps_;
    lock.unlock();
    if (sleeps) asked_again_.notify_one();
    return changed;
  }

  void expect(std::span<const Hint> hints) override {
    FF_CHECK_LE(hints.size(), kMaxObservers);
    expected_.assign(hints.begin(), hints.end());
    hinted_ = true;
  }
  std::span<const Hint> expected() const override { return expected_; }
  void setLead(const Lead& lead) override { lead_ = lead; }
  const StripList& activeList() const override { return active_; }

  Result<void> settle() override {
    std::unique_lock lock(mutex_);
    asked_.settles = true;
    ask();
    asked_again_.notify_one();
    settled_.wait(lock, [&] { return done_ == asked_.number; });
    (void)takeUp();
    if (failure_) return *failure_;
    return {};
  }

  StreamStats stats() const override {
    StreamStats stats = stats_taken_;
    stats.pending_tiles += taken_ == 0 ? updated_ : observers_.movedBy(radii()[0], looked_at_taken_);
    return stats;
  }
  std::string lastFailure() const override { return of_->lastFailure(); }

 private:
  struct Asked {
    uint64_t number = 0;  // 0: nothing yet
    Observers observers;
    Lead lead;
    bool settles = false, hinted = false;
    std::array<Hint, kMaxObservers> hints;
    size_t hint_count = 0;
  };

  // These two with mutex_ held.
  void ask() {
    asked_.observers = observers_;
    asked_.lead = lead_;
    if (std::exchange(hinted_, false)) {
      std::ranges::copy(expected_, asked_.hints.begin());
      asked_.hint_count = expected_.size();
      asked_.hinted = true;
    }
    ++asked_.number;
  }
  // Whether there was another list.
  bool takeUp() {
    stats_taken_ = stats_;
    looked_at_taken_ = looked_at_;
    taken_ = done_;
    if (!fresh_) return false;
    fresh_ = false;
    active_ = std::move(ready_);
    return true;
  }

  void work(Streamer& of) {
    std::unique_lock lock(mutex_);
    int looks = 0;  // in vain, one after the other
    for (bool tiles_pending = false;;) {
      const auto asked = [this] { return stop_ || asked_.number != done_; };
      sleeps_ = looks >= kLooks && !tiles_pending;
      if (sleeps_)
        asked_again_.wait(lock, asked);
      else
        asked_again_.wait_for(lock, kLook, [&] { return stop_ || asked_.settles; });
      sleeps_ = false;
      if (stop_) return;
      looks = asked() ? 0 : looks + 1;
      if (looks > 0 && !tiles_pending) continue;
      const Asked now = asked_;
      asked_.settles = asked_.hinted = false;
      lock.unlock();
      bool changed = now.settles;
      std::optional<Error> failure;
      try {
        if (now.hinted) of.expect(std::span(now.hints).first(now.hint_count));
        of.setLead(now.lead);
        changed |= of.update(now.observers);
        if (now.settles)
          if (auto settled = of.settle(); !settled) failure = settled.error();
      } catch (const std::bad_alloc&) {  // of a table that outgrows its size: what is there stands, and the next frame asks again
        failure = Error{ErrorCode::kIo, "", "", "out of memory while streaming", "close other programs"};
      }
      const StreamStats stats = of.stats();
      tiles_pending = stats.pending_tiles > 0;
      lock.lock();
      stats_ = stats;
      looked_at_ = now.observers;
      done_ = now.number;
      if (now.settles) failure_ = failure;
      if (changed) {
        ready_ = of.activeList();
        fresh_ = true;
      }
      settled_.notify_all();
    }
  }

  // The caller's.
  StripList active_;
  std::vector<Hint> expected_;
  bool hinted_ = false;  // expected_ was not handed over
  Observers observers_, looked_at_taken_;
  StreamStats stats_taken_;
  uint64_t taken_ = 0;   // number of what stats_taken_ came of
  bool updated_ = false;  // ever, whether the thread was told of it or not
  Lead lead_;
  // What is handed over.
  mutable std::mutex mutex_;
  std::condition_variable asked_again_, settled_;
  Asked asked_;
  StripList ready_;
  bool fresh_ = false;   // ready_ was not taken up
  uint64_t done_ = 0;    // number of what was asked last and is done
  StreamStats stats_;
  Observers looked_at_;  // by stats_
  std::optional<Error> failure_;
  bool stop_ = false, sleeps_ = false;
  std::unique_ptr<Streamer> of_;
  std::thread thread_;
};

}  // namespace

std::unique_ptr<Streamer> inBackground(std::unique_ptr<Streamer> of) try {
  return std::make_unique<BackgroundStreamer>(of);
} catch (const std::system_error&) {
  return of;
}

}  // namespace ff::stream
