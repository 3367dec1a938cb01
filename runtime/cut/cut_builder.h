// The cut, and its local matrix: chosen and brought up to date within a frame or, while the ones before are in use, on a thread of its own: then a frame only
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

#include "runtime/cut/cut_budget.h"
#include "runtime/cut/cut_choice.h"
#include "runtime/cut/matrix_assembler.h"
#include "stream/rate_limit.h"
#include "stream/strip_lists.h"

namespace ff::runtime {

// Whoever makes something beside the matrix of a new cut: build() on the thread that has put that together, take() on the caller's, when it is taken up.
class CutCompanion {
 public:
  virtual ~CutCompanion() = default;
  virtual void build(const MatrixAssembler& cut) = 0;  // whose change() is that from the cut before
  virtual void take() = 0;
};

struct CutLimits {
  uint32_t max_slots = kMaxSlots;     // as MatrixAssembler
  uint32_t max_fading_nodes = 0;      // as CutChoice
  uint32_t max_entering_tiles = 0;    // as CutBudget
};

// What a cut is chosen by.
struct CutWish {
  stream::StripList active;                  // as Streamer::activeList()
  std::span<const float> own{};              // by tile of the matrix, how much of what it shows is its own; empty: nothing fades out
  bool one_has_gone = false;                 // a tile that fades out has come to its end
  stream::Observers observers{};             // the nearest to these enters first
  bool whole = false;                        // all that is active, whatever the limits
};

// One thread calls. Nothing but a matrix that outgrows its capacity takes memory there.
class CutBuilder {
 public:
  // World and companion must outlive it. background: there is a thread; where the system has none, as without. packs: it writes changes for a device, too
  // (MatrixChange::packed). now: the time that latencySeconds() counts by.
  CutBuilder(const formats::World& world, FarLight far_light, bool background, CutCompanion* companion = nullptr, bool packs = false, stream::Now now = std::chrono::steady_clock::now,
             const CutLimits& limits = {});
  ~CutBuilder();

  // Stays where it is; with a background it changes with take() only, without one with ask().
  const LocalMatrix& matrix() const { return back_ ? shown_ : front_->matrix(); }
  // What the last take() changed.
  const MatrixChange& change() const { return *change_; }
  // By number in LocalMatrix::tiles.
  const stream::ResidentStrip& strip(size_t tile) const { return front_->strip(tile); }

  // Has the cut chosen and built, if it may be another than the last one asked for, and nothing is under way or ready; what a caller wishes in the meantime waits until it calls
  // again. Without a background it is ready then; with one it is from begin() or await() on that the thread builds. Whether it is asked for. Errors, without a background: as
  // MatrixAssembler::update.
  Result<bool> ask(const CutWish& wish);
  // Takes up what is ready, and says whether anything was: a cut, of which the matrix may be as it was, as change() then says. Errors, of the background: as MatrixAssembler::update.
  Result<bool> take();
  // The thread finds out by itself within stream::kLook; one that sleeps is woken, which may take the caller's core for a while: so a frame does it when all else is done.
  void begin() const {
    if (state_.load() == kAsked && sleeps_) wake();
  }
  bool inBackground() const { return back_ != nullptr; }
  // From a cut's ask() to the take() of it, s: longestOfLate(); 0 without a background.
  float latencySeconds() const { return latency_seconds_; }
  // Blocks until nothing is being built.
  void await() const;
  // Whether the matrix is that of all that is active, and of nothing else.
  bool holds(std::span<const stream::StripPtr> active) const;
  // Of the cut of the matrix: what fades out, sorted, and tiles that max_entering_tiles kept back.
  std::span<const FadingTile> fading() const { return fading_; }
  uint32_t waiting() const { return waiting_; }
  void renumberNext() { renumber_next_ = true; }  // for tests

 private:
  enum State : uint32_t { kIdle, kAsked, kBuilding, kReady, kStop };
  void work();
  uint32_t awaitAsked();
  void wake() const;
  void choose();

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
  uint32_t waiting_ = 0;
  // Handed to the thread and back by state_.
  stream::StripList asked_active_;  // these four as CutWish has them
  std::vector<float> asked_own_;
  stream::Observers asked_observers_;
  bool asked_whole_ = false;
  CutChoice choice_;
  CutBudget budget_;
  std::vector<stream::StripPtr> cut_, next_cut_;   // the front's; the one being built
  std::vector<FadingTile> fading_, next_fading_;  // of these
  bool renumbered_ = false, renumber_ = false;     // whether slots were given out anew for cut_, and are for next_cut_, because somebody wished it
  std::optional<Error> error_;
  mutable std::atomic<uint32_t> state_{kIdle};
  std::atomic<bool> sleeps_ = false;
  mutable std::mutex wake_mutex_;
  mutable std::condition_variable wake_;
  std::thread thread_;
};

}  // namespace ff::runtime
