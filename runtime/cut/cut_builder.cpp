#include "runtime/cut/cut_builder.h"

#include <algorithm>
#include <new>
#include <system_error>
#include <utility>

#include "runtime/cut/strip_list.h"
#include "stream/latency.h"
#include "stream/start_threads.h"

namespace ff::runtime {

CutBuilder::CutBuilder(const formats::World& world, FarLight far_light, bool background, CutCompanion* companion, bool packs, stream::Now now, uint32_t max_slots)
    : companion_(companion), packs_(packs), now_(std::move(now)), front_(std::make_unique<MatrixAssembler>(world, far_light, max_slots)) {
  for (auto* cut : {&cut_, &next_cut_, &spare_}) cut->reserve(kMaxSlots / 16);
  for (auto* fading : {&fading_, &next_fading_}) fading->reserve(kMaxSlots / 16);
  if (!background) return;
  back_ = std::make_unique<MatrixAssembler>(world, far_light, max_slots);
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
      takeOver(next_cut_, asked_, spare_);
      next_fading_.assign(asked_fading_.begin(), asked_fading_.end());
      state_ = kBuilding;
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

void CutBuilder::start(std::span<const stream::StripPtr> active, std::span<const FadingTile> fading) {
  started_ = now_();
  asked_ = active;
  asked_fading_ = fading;
  renumber_ = std::exchange(renumber_next_, false);
  state_ = kAsked;
}

Result<void> CutBuilder::take() {
  state_ = kIdle;
  if (error_) return *error_;
  latency_seconds_ = stream::longestOfLate(latency_seconds_, std::chrono::duration<float>(now_() - started_).count());
  front_->swap(shown_);
  back_->swap(shown_);
  front_.swap(back_);
  cut_.swap(next_cut_);
  fading_.swap(next_fading_);
  renumbered_ = renumber_;
  change_ = &front_->change();
  if (companion_) companion_->take();
  return {};
}

Result<void> CutBuilder::next(std::span<const stream::StripPtr> active, std::span<const FadingTile> fading) {
  change_ = &none_;
  if (!back_) {
    if (std::exchange(renumber_next_, false)) front_->renumberNext();
    auto updated = front_->update(active, fading);
    change_ = &front_->change();
    if (!updated) return updated;
    if (companion_ && change_->any) companion_->build(*front_), companion_->take();
    if (!std::ranges::equal(active, cut_)) takeOver(cut_, active, spare_);
    return {};
  }
  if (state_ == kReady)
    if (auto taken = take(); !taken) return taken;
  if (state_ == kIdle && !holds(active)) start(active, fading);
  return {};
}

void CutBuilder::await() const {
  if (reads()) wake();
  for (uint32_t seen = state_.load(); seen == kAsked || seen == kBuilding; seen = state_.load()) state_.wait(seen);
}

bool CutBuilder::holds(std::span<const stream::StripPtr> active) const { return !back_ || (!renumber_next_ && std::ranges::equal(active, cut_)); }

}  // namespace ff::runtime
