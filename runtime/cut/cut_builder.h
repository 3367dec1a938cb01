// The local matrix of the cut, brought up to date within a frame or, while the one before is in use, on a thread of its own: then a frame only
// swaps. For that two assemblers take turns. Each takes up every change in the same order, so that a node has the same slot in both.
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <thread>
#include <vector>

#include "runtime/cut/matrix_assembler.h"
#include "stream/rate_limit.h"

namespace ff::runtime {

// Whoever makes something beside the matrix of a new cut: build() on the thread that has put that together, take() on the caller's, when it is taken up.
class CutCompanion {
 public:
  virtual ~CutCompanion() = default;
  virtual void build(const MatrixAssembler& cut) = 0;  // whose change() is that from the cut before
  virtual void take() = 0;
};

// One thread calls. Nothing but a matrix that outgrows its capacity takes memory there.
class CutBuilder {
 public:
  // World and companion must outlive it. background: there is a thread; where the system has none, as without. packs: it writes changes for a device, too
  // (MatrixChange::packed). now: the time that latencySeconds() counts by. max_slots: as MatrixAssembler.
  CutBuilder(const formats::World& world, FarLight far_light, bool background, CutCompanion* companion = nullptr, bool packs = false, stream::Now now = std::chrono::steady_clock::now,
             uint32_t max_slots = kMaxSlots);
  ~CutBuilder();

  // Stays where it is; changes with next() only.
  const LocalMatrix& matrix() const { return back_ ? shown_ : front_->matrix(); }
  // What the last next() changed.
  const MatrixChange& change() const { return *change_; }
  // By number in LocalMatrix::tiles.
  const stream::ResidentStrip& strip(size_t tile) const { return front_->strip(tile); }

  // Without a background: brings the matrix to the cut `active`. With one: takes up what is ready, which change() then says, and has `active` built, from
  // begin() or await() on, if nothing is under way; what a caller brings in the meantime waits until it calls again. Both lists then stay as they are while
  // reads(). Errors: as MatrixAssembler::update. fading: as MatrixAssembler::update.
  Result<void> next(std::span<const stream::StripPtr> active, std::span<const FadingTile> fading = {});
  // The thread finds out by itself within stream::kLook; one that sleeps is woken, which may take the caller's core for a while: so a frame does it when all else is done.
  void begin() const {
    if (reads() && sleeps_) wake();
  }
  // Whether the thread has yet to read the lists of the last next(): counts of strips are changed there.
  bool reads() const { return state_.load() == kAsked; }
  // From a cut's first call of next() to the one that took it up, s: longestOfLate(); 0 without a background.
  float latencySeconds() const { return latency_seconds_; }
  // Blocks until nothing is being built.
  void await() const;
  // Whether the matrix is that of a cut.
  bool holds(std::span<const stream::StripPtr> active) const;
  // The cut that was last begun to be put together, whether or not the matrix is there. Not while reads().
  std::span<const stream::StripPtr> latest() const { return state_ == kIdle ? cut_ : next_cut_; }
  void renumberNext() { renumber_next_ = true; }  // for tests

 private:
  enum State : uint32_t { kIdle, kAsked, kBuilding, kReady, kStop };
  void work();
  uint32_t awaitAsked();
  void wake() const;
  void start(std::span<const stream::StripPtr> active, std::span<const FadingTile> fading);
  Result<void> take();

  CutCompanion* const companion_;
  const bool packs_;
  const stream::Now now_;
  std::unique_ptr<MatrixAssembler> front_, back_;  // back_: null without a background
  LocalMatrix shown_;                              // the front's, while it is in front
  const MatrixChange none_;
  const MatrixChange* change_ = &none_;
  bool renumber_next_ = false;
  std::chrono::steady_clock::time_point started_;
  float latency_seconds_ = 0;
  // Handed to the thread and back by state_.
  std::span<const stream::StripPtr> asked_;        // of the last next(); these two until the thread has made them next_cut_ and next_fading_
  std::span<const FadingTile> asked_fading_;
  std::vector<stream::StripPtr> cut_, next_cut_;   // the front's; the one being built
  std::vector<FadingTile> fading_, next_fading_;  // of these
  std::vector<stream::StripPtr> spare_;            // of takeOver()
  bool renumbered_ = false, renumber_ = false;     // whether slots were given out anew for cut_, and are for next_cut_, because somebody wished it
  std::optional<Error> error_;
  mutable std::atomic<uint32_t> state_{kIdle};
  std::atomic<bool> sleeps_ = false;
  mutable std::mutex wake_mutex_;
  mutable std::condition_variable wake_;
  std::thread thread_;
};

}  // namespace ff::runtime
