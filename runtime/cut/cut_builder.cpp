#include "runtime/cut/cut_builder.h"

#include <algorithm>
#include <new>
#include <system_error>
#include <utility>

#include "stream/latency.h"
#include "stream/start_threads.h"

namespace ff::runtime {

CutBuilder::CutBuilder(const formats::World& world, FarLight far_light, bool background, CutCompanion* companion, bool packs, stream::Now now, const CutLimits& limits)
    : companion_(companion), packs_(packs), now_(std::move(now)), front_(std::make_unique<MatrixAssembler>(world, far_light, limits.max_slots)), choice_(limits.max_fading_nodes, limits.max_slots), budget_(world, limits.max_entering_tiles) {
  for (auto* cut : {&cut_, &next_cut_}) cut->reserve(kMaxSlots / 16);
  for (auto* fading : {&fading_, &next_fading_}) fading->reserve(kMaxSlots / 16);
  asked_own_.reserve(kMaxSlots / 16);
  if (!background) return;
  back_ = std::make_unique<MatrixAssembler>(world, far_light, limits.max_slots);
  front_->swap(shown_);
  try {
    thread_ = stream::startThread([this] { work(); });
  } catch (const std::system_error&) {
    front_->swap(shown_);
    back_.reset();
  }
}

CutBuilder::~CutBuilder() {
  if (!thread_.joinable()) return;
  await();
  state_ = kStop;
  wake();
  thread_.join();
}

// Of two that miss each other in begin(), either the thread sees that it is asked or the caller that it sleeps.
uint32_t CutBuilder::awaitAsked() {
  const auto asked = [this] { return state_ == kAsked || state_ == kStop; };
  std::unique_lock lock(wake_mutex_);
  for (int looks = 0; !asked(); ++looks) {
    sleeps_ = looks >= stream::kLooks;
    if (sleeps_)
      wake_.wait(lock, asked);
    else
      wake_.wait_for(lock, stream::kLook, asked);
  }
  sleeps_ = false;
  return state_;
}

void CutBuilder::wake() const {
  { const std::lock_guard lock(wake_mutex_); }
  wake_.notify_one();
}

void CutBuilder::work() {
  while (awaitAsked() != kStop) {
    Result<void> built;
    try {
      state_ = kBuilding;
      choose();
      if (renumbered_) back_->renumberNext();
      if (!cut_.empty()) built = back_->update(cut_, fading_);  // what the front has taken up since
      renumbered_ = false;
      if (renumber_) back_->renumberNext();
      if (built) built = back_->update(next_cut_, next_fading_);
      if (built && packs_) back_->pack();
      if (built && companion_) companion_->build(*back_);
    } catch (const std::bad_alloc&) {
      built = Error{ErrorCode::kIo, "", "", "out of memory for the local matrix", ""};
    }
    error_.reset();
    if (!built) error_ = built.error();
    state_ = kReady;
    state_.notify_one();
  }
}

// Into next_cut_ and next_fading_.
void CutBuilder::choose() {
  choice_.choose(*asked_active_, cut_, matrix().tiles, asked_own_, next_cut_, next_fading_);
  if (asked_whole_) return;
  const std::span<const stream::StripPtr> limited = budget_.limit(next_cut_, cut_, asked_observers_);
  if (limited.size() < next_cut_.size()) next_cut_.assign(limited.begin(), limited.end());
}

Result<bool> CutBuilder::ask(const CutWish& wish) {
  if (state_ != kIdle) return false;
  const bool same = wish.whole ? holds(*wish.active) : wish.active == asked_active_ && !wish.one_has_gone && waiting_ == 0 && !renumber_next_;
  if (same) return false;
  started_ = now_();
  asked_active_ = wish.active;
  asked_own_.assign(wish.own.begin(), wish.own.end());
  asked_observers_ = wish.observers;
  asked_whole_ = wish.whole;
  renumber_ = std::exchange(renumber_next_, false);
  if (back_) {
    state_ = kAsked;
    return true;
  }
  choose();
  if (renumber_) front_->renumberNext();
  if (auto updated = front_->update(next_cut_, next_fading_); !updated) {
    asked_active_.reset();  // so that it is asked for once more
    return updated.error();
  }
  if (companion_ && front_->change().any) companion_->build(*front_);
  state_ = kReady;
  return true;
}

Result<bool> CutBuilder::take() {
  change_ = &none_;
  if (state_ != kReady) return false;
  state_ = kIdle;
  if (error_) {
    asked_active_.reset();  // so that it is asked for once more
    return *error_;
  }
  if (back_) {
    latency_seconds_ = stream::longestOfLate(latency_seconds_, std::chrono::duration<float>(now_() - started_).count());
    front_->swap(shown_);
    back_->swap(shown_);
    front_.swap(back_);
  }
  cut_.swap(next_cut_);
  fading_.swap(next_fading_);
  waiting_ = asked_whole_ ? 0 : budget_.waiting();
  renumbered_ = renumber_;
  change_ = &front_->change();
  if (companion_ && change_->any) companion_->take();
  return true;
}

void CutBuilder::await() const {
  if (state_.load() == kAsked) wake();
  for (uint32_t seen = state_.load(); seen == kAsked || seen == kBuilding; seen = state_.load()) state_.wait(seen);
}

bool CutBuilder::holds(std::span<const stream::StripPtr> active) const { return !renumber_next_ && std::ranges::equal(active, cut_); }

}  // namespace ff::runtime
