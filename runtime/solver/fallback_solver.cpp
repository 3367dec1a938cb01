#include "runtime/solver/fallback_solver.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace ff::runtime {
namespace {

class Fallback final : public FallbackSolver {
 public:
  Fallback(std::unique_ptr<Solver> first, std::unique_ptr<Solver> second)
      : first_(std::move(first)), second_(std::move(second)) {}

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override {
    matrix_ = &matrix;
    if (change.renumbered) last_seen_.clear();
    for (auto* per_slot : {&last_seen_, &source_}) per_slot->resize(matrix.slots());
    for (const uint32_t t : change.entered)
      for (uint32_t i = 0, slot = matrix.tiles[t].first_slot; i < matrix.tiles[t].nodes; ++i, ++slot)
        last_seen_[slot] = matrix.parent_slot[slot] != kNoSlot ? last_seen_[matrix.parent_slot[slot]] : Vec4{};
    return attempt([&](Solver& s) { return s.update(matrix, change); });
  }
  bool resolvesRows() const override { return first_->resolvesRows(); }
  Result<void> setSource(std::span<const Vec4> source) override {
    source_.assign(source.begin(), source.end());
    return attempt([&](Solver& s) { return s.setSource(source_); });
  }
  Result<void> setEnteredSource(std::span<const Vec4> source, const MatrixChange& change, bool stays) override {
    for (const uint32_t t : change.entered) {
      const SlotRange& range = matrix_->tiles[t];
      std::copy_n(source.begin() + range.first_slot, range.nodes, source_.begin() + range.first_slot);
    }
    return attempt([&](Solver& s) { return s.setEnteredSource(source_, change, stays); });
  }
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override {
    last_seen_.assign(radiosity.begin(), radiosity.end());
    return attempt([&](Solver& s) { return s.setRadiosity(radiosity); });
  }
  void ease(uint32_t frames) override {
    first_->ease(frames);
    second_->ease(frames);
  }
  void pace(const LightPace& pace) override {
    first_->pace(pace);
    second_->pace(pace);
  }
  Result<void> iterate(int k) override {
    return attempt([&](Solver& s) { return s.iterate(k); });
  }
  Result<void> approach(int k) override {
    return attempt([&](Solver& s) { return s.approach(k); });
  }
  Result<void> radiosity(std::span<Vec4> out) override {
    auto r = attempt([&](Solver& s) { return s.radiosity(out); });
    if (r) last_seen_.assign(out.begin(), out.end());
    return r;
  }
  std::span<const Vec4> inMemory() override { return reason_.empty() ? first_->inMemory() : second_->inMemory(); }
  uint64_t repaired() const override { return inUse().repaired(); }
  UploadedBytes uploaded() const override { return first_->uploaded(); }
  double lastMs() const override { return inUse().lastMs(); }
  const char* name() const override { return inUse().name(); }
  const std::string& reason() const override { return reason_; }

 private:
  const Solver& inUse() const { return reason_.empty() ? *first_ : *second_; }

  template <class Call>
  Result<void> attempt(const Call& call) {
    if (!reason_.empty()) return call(*second_);
    auto r = call(*first_);
    if (r || r.error().cause == ErrorCause::kOther) return r;
    reason_ = r.error().line();
    if (auto set = second_->update(*matrix_, {}); !set) return set;
    if (auto set = second_->setRadiosity(last_seen_); !set) return set;
    if (auto set = second_->setSource(source_); !set) return set;
    return call(*second_);
  }

  std::unique_ptr<Solver> first_, second_;
  std::string reason_;  // empty: first_ is in use
  const LocalMatrix* matrix_ = nullptr;
  std::vector<Vec4> source_, last_seen_;  // their memory is kept from frame to frame
};

}  // namespace

std::unique_ptr<FallbackSolver> makeFallbackSolver(std::unique_ptr<Solver> first, std::unique_ptr<Solver> second) {
  return std::make_unique<Fallback>(std::move(first), std::move(second));
}

}  // namespace ff::runtime
