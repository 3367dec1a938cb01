// Jacobi iterations on the CPU. Nothing is allocated or locked after the start. Every row is summed by one
// thread in the order of its entries, so the result does not depend on the number of threads.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include "runtime/clock.h"
#include "runtime/gather/gather_kernels.h"
#include "runtime/gather/semi_iteration.h"
#include "runtime/solver/held_light.h"
#include "runtime/solver/solver.h"
#include "runtime/solver/sound_light.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kPartRefined = 2048;  // slots of a part handed to a thread; a single part is done without a meeting
constexpr uint32_t kPartChanged = 256;   // rows of one
constexpr uint32_t kPartTiles = 32;      // tiles of one

class CpuGather final : public Solver {
 public:
  explicit CpuGather(int threads) : pool_(threads) {
    if (const GatherKernel fast = gatherAvx2()) kernel_ = fast;
    for (auto* per_slot : {&from_, &to_, &before_, &source_}) per_slot->reserve(kMaxSlots);
    for (auto* tiles : {&entering_, &left_}) tiles->reserve(kMaxSlots / 16);
  }

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override {
    const bool all = std::exchange(matrix_, &matrix) != &matrix || change.renumbered;
    if (all) {
      entering_.clear();
      left_.clear();
    } else {
      std::erase_if(entering_, [&](const SlotRange& range) { return std::ranges::find(change.left, range.first_slot, &SlotRange::first_slot) != change.left.end(); });
    }
    enter();
    if (all)
      for (auto* per_slot : {&from_, &to_}) per_slot->clear();
    else
      left_.assign(change.left.begin(), change.left.end());
    before_is_clear_ = false;
    for (auto* per_slot : {&from_, &to_, &before_, &source_}) {
      if (all) touchMemory(*per_slot, matrix.most_slots);
      per_slot->resize(matrix.slots());
    }
    if (all) stepped_ = false;
    if (all) held_.touch(matrix.most_slots);
    knows_changed_ = !held_.due();
    held_.rowsChanged(matrix.slots(), stepped_);
    shows_parents_light_ = held_.due();
    if (!all)
      for (const uint32_t t : change.entered) entering_.push_back(matrix.tiles[t]);  // parents first
    pace_.forget();
    return {};
  }

  bool resolvesRows() const override { return false; }
  Result<void> setSource(std::span<const Vec4> source) override {
    FF_CHECK_EQ(source.size(), source_.size());
    if (held_.goesBefore()) hold();
    repaired_ += copySound(source, source_);
    pace_.forget();
    return {};
  }

  Result<void> setEnteredSource(std::span<const Vec4> source, const MatrixChange&, bool stays) override {
    FF_CHECK_EQ(source.size(), source_.size());
    if (held_.goesBefore()) hold();
    entered_source_ = source;
    if (!stays) enter();
    pace_.forget();
    return {};
  }

  Result<void> setRadiosity(std::span<const Vec4> radiosity) override {
    FF_CHECK_EQ(radiosity.size(), from_.size());
    enter();
    repaired_ += copySound(radiosity, from_);
    stepped_ = false;
    held_.letGo();
    pace_.forget();
    return {};
  }

  void ease(uint32_t frames) override { held_.ease(frames); }
  void pace(const LightPace& pace) override { held_.pace(pace); }

  Result<void> iterate(int k) override {
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto start = Clock::now();
    enter();
    if (held_.due()) hold();
    if (held_.holds()) held_.release(*matrix_, from_, source_, [&](auto&& work) { forTiles(work); });
    for (int i = 0; i < k; ++i) step();
    last_ms_ = msSince(start);
    return {};
  }

  Result<void> approach(int k) override {
    FF_CHECK_EQ(matrix_ != nullptr, true);
    if (!pace_.suits(k)) return iterate(k);
    const auto start = Clock::now();
    enter();
    step();
    const double first = lastChange();
    step();
    pace_.learn(first, lastChange());
    if (!std::exchange(before_is_clear_, true)) std::ranges::fill(before_, Vec4{});
    for (int i = 2; i < k; ++i) {
      const float omega = pace_.omega();
      if (omega != 1) before_.swap(to_);  // `to_` held the values of a step ago
      step(omega);
    }
    last_ms_ = msSince(start);
    return {};
  }

  Result<void> radiosity(std::span<Vec4> out) override {
    FF_CHECK_EQ(out.size(), from_.size());
    enter();
    std::copy(from_.begin(), from_.end(), out.begin());
    return {};
  }

  std::span<const Vec4> inMemory() override {
    enter();
    return from_;
  }

  uint64_t repaired() const override { return repaired_; }
  double lastMs() const override { return last_ms_; }
  const char* name() const override { return "cpu"; }

 private:
  template <class Work>  // work(leaves, number of the first one, of the one after the last)
  void forLeaves(Work&& work) {
    const std::vector<uint32_t>& parts = matrix_->leaf_parts;
    pool_.run(static_cast<uint32_t>(parts.size() - 1), [&](uint32_t part) {
      work(std::span<const uint32_t>(matrix_->leaves).subspan(parts[part], parts[part + 1] - parts[part]), parts[part], parts[part + 1]);
    });
  }

  template <class Work>  // work(tile), by number
  void forTiles(Work&& work) {
    const auto tiles = static_cast<uint32_t>(matrix_->tiles.size());
    pool_.run((tiles + kPartTiles - 1) / kPartTiles, [&](uint32_t part) {
      for (uint32_t tile = part * kPartTiles; tile < std::min(tiles, (part + 1) * kPartTiles); ++tile) work(tile);
    });
  }

  // What nodes that have entered start from, on all threads, and so when they are next asked for: with the next step, as a rule.
  void enter() {
    // No step writes a free slot, and steps take turns with these: what stood there would seem to change for ever.
    pool_.run(static_cast<uint32_t>(left_.size()), [&](uint32_t tile) {
      for (auto* per_slot : {&from_, &to_}) std::fill_n(per_slot->begin() + left_[tile].first_slot, left_[tile].nodes, Vec4{});
    });
    left_.clear();
    for (size_t first = 0, end = 0; first < entering_.size(); first = end) {
      while (end < entering_.size() && entering_[end].id.level == entering_[first].id.level) ++end;
      pool_.run(static_cast<uint32_t>(end - first), [&](uint32_t tile) { enter(entering_[first + tile]); });
    }
    entering_.clear();
    entered_source_ = {};
  }

  void enter(const SlotRange& range) {
    if (!entered_source_.empty()) repaired_ += copySound(entered_source_.subspan(range.first_slot, range.nodes), std::span(source_).subspan(range.first_slot, range.nodes));
    for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
      const uint32_t parent = matrix_->parent_slot[s];
      held_.enter(s);
      if (parent == kNoSlot)
        from_[s] = {};
      else if (shows_parents_light_)
        inherit(s, parent);
      else
        from_[s] = from_[parent];
    }
  }

  // A node that enters shows the irradiance that its parent had.
  void inherit(uint32_t slot, uint32_t parent) {
    for (auto* per_slot : {&from_, &to_}) {
      const Vec4 b = (*per_slot)[parent];
      (*per_slot)[slot] = onAlbedo(b, matrix_->albedo[parent], matrix_->albedo[slot], b);
    }
  }

  // The last step, made with the new rows, would have come to something else than it did: what it did stays, and the difference is held back. (to_ has what
  // that step came from.) Of rows that are as they were that is what is held back already.
  void hold() {
    enter();
    before_.resize(to_.size());
    const std::vector<uint32_t>& rows = knows_changed_ && !matrix_->changed_leaves.empty() ? matrix_->changed_leaves : matrix_->leaves;
    GatherJob job = jobOf(source_, to_, before_);
    job.leaves = rows.data();
    const auto count = static_cast<uint32_t>(rows.size());
    pool_.run((count + kPartChanged - 1) / kPartChanged, [&](uint32_t part) {
      const uint32_t begin = part * kPartChanged, end = std::min(begin + kPartChanged, count);
      (void)kernel_(job, begin, end);
      for (uint32_t r = begin; r < end; ++r) held_.take(rows[r], from_[rows[r]] + before_[rows[r]] * Vec4{-1, -1, -1, 0});
    });
    held_.taken();
  }

  GatherJob jobOf(const std::vector<Vec4>& source, const std::vector<Vec4>& from, std::vector<Vec4>& to) const {
    return {matrix_->row_start.data(), matrix_->row_entries.data(), matrix_->entries.data(), matrix_->leaves.data(), matrix_->albedo.data(), matrix_->row_scale.data(), source.data(), from.data(), to.data()};
  }

  // from_ <- M + albedo F from_; with omega, the step goes on from before_ and omega times as far.
  void step(float omega = 1) {
    std::atomic<uint32_t> unsound = 0;
    forLeaves([&](std::span<const uint32_t> leaves, uint32_t begin, uint32_t end) {
      bool sound = kernel_(jobOf(held_.holds() ? held_.lit() : source_, from_, to_), begin, end);
      if (held_.holds())
        for (const uint32_t s : leaves) to_[s] = {std::max(to_[s].x, 0.0f), std::max(to_[s].y, 0.0f), std::max(to_[s].z, 0.0f), 0};
      if (omega != 1) sound = stepFurther(leaves, omega);
      if (!sound) unsound += repair(leaves);
    });
    repaired_ += unsound;
    refine();
    from_.swap(to_);
    stepped_ = true;
  }

  // Whether all of them are sound.
  bool stepFurther(std::span<const uint32_t> leaves, float omega) {
    bool sound = true;
    for (const uint32_t s : leaves) {
      const Vec4 old = before_[s], m = source_[s], b = to_[s];
      to_[s] = {std::max(m.x, old.x + omega * (b.x - old.x)), std::max(m.y, old.y + omega * (b.y - old.y)),
                std::max(m.z, old.z + omega * (b.z - old.z)), 0};
      sound &= isSound(to_[s]);
    }
    return sound;
  }

  uint32_t repair(std::span<const uint32_t> leaves) {
    uint32_t repaired = 0;
    for (const uint32_t s : leaves) {
      if (isSound(to_[s])) continue;
      to_[s] = source_[s];
      ++repaired;
    }
    return repaired;
  }

  // Of the last step, over the leaves.
  double lastChange() const {
    double sum = 0;
    for (const uint32_t s : matrix_->leaves) {
      const double x = static_cast<double>(from_[s].x) - static_cast<double>(to_[s].x);
      const double y = static_cast<double>(from_[s].y) - static_cast<double>(to_[s].y);
      const double z = static_cast<double>(from_[s].z) - static_cast<double>(to_[s].z);
      sum += x * x + y * y + z * z;
    }
    return std::sqrt(sum);
  }

  // Level by level from the finest up: a level's children are done.
  void refine() {
    const auto& starts = matrix_->refined_level_start;
    for (size_t level = 0; level + 1 < starts.size(); ++level) {
      const uint32_t first = starts[level], end = starts[level + 1];
      const uint32_t parts = (end - first + kPartRefined - 1) / kPartRefined;
      pool_.run(parts, [&](uint32_t part) {
        refineSlots(*matrix_, to_.data(), first + part * kPartRefined,
                    std::min(end, first + (part + 1) * kPartRefined));
      });
    }
  }

  WorkerPool pool_;
  GatherKernel kernel_ = gatherPortable;
  const LocalMatrix* matrix_ = nullptr;
  std::vector<Vec4> source_, from_, to_;
  std::vector<Vec4> before_;         // of two steps ago, in approach(); scratch of hold()
  bool before_is_clear_ = false;     // of what free slots had when they were taken
  HeldLight held_;
  bool stepped_ = false;  // to_ is what the last step came from
  bool knows_changed_ = false;  // LocalMatrix::changed_leaves has all that is due: no change before it still is
  std::vector<SlotRange> entering_;   // since enter(); the coarsest level of an update first
  std::span<const Vec4> entered_source_;  // of these, where they have others than zero
  std::vector<SlotRange> left_;       // since enter()
  bool shows_parents_light_ = false;  // of these
  SemiIteration pace_;
  std::atomic<uint64_t> repaired_ = 0;
  double last_ms_ = 0;
};

}  // namespace

std::unique_ptr<Solver> makeCpuGather(int threads) { return std::make_unique<CpuGather>(threads); }

}  // namespace ff::runtime
