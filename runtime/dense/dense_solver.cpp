#include "runtime/dense/dense_solver.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "runtime/clock.h"
#include "runtime/dense/bounce_monitor.h"
#include "runtime/solver/held_light.h"
#include "runtime/solver/sound_light.h"

namespace ff::runtime {
namespace {

class Dense final : public DenseSolver {
 public:
  Dense(std::unique_ptr<BounceMatrix> matrix, const DenseSettings& settings)
      : bounces_(std::move(matrix)),
        settings_(settings),
        name_(std::string("dense: ") + bounces_->name()),
        places_(bounces_->capacity()),
        rows_(settings.threads),
        probe_(bounces_->capacity(), settings.probe_limit > 0 ? settings.probe_limit : defaultProbeLimit(bounces_->name())) {
    for (auto* v : {&source_, &irradiance_, &radiosity_, &minus_, &residual_}) v->reserve(kMaxSlots);
    by_place_.assign(bounces_->capacity(), {});
    out_by_place_.assign(bounces_->capacity(), {});
  }

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override {
    const bool first = std::exchange(matrix_, &matrix) != &matrix;
    const uint32_t slots = matrix.slots();
    if (first)
      if (auto cleared = bounces_->clear(); !cleared) return cleared;
    const std::span<const uint32_t> leaving = places_.update(matrix, change, first);

    const bool anew = first || change.renumbered;
    if (first) probe_.builtAnew();
    for (auto* v : {&irradiance_, &radiosity_, &source_}) {
      if (anew) v->clear();
      v->resize(slots);
    }
    for (auto* v : {&minus_, &residual_}) v->assign(slots, {});
    rows_.takeUp(matrix);
    if (anew) stepped_ = false;
    held_.rowsChanged(slots, stepped_ && settings_.correct);
    if (!anew)
      for (const uint32_t t : change.entered) {  // parents first
        const SlotRange& range = matrix.tiles[t];
        for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
          const uint32_t parent = matrix.parent_slot[s];
          irradiance_[s] = parent != kNoSlot ? irradiance_[parent] : Vec4{};
          const Vec4 b = parent != kNoSlot ? radiosity_[parent] : Vec4{};
          radiosity_[s] = parent != kNoSlot && held_.due() ? onAlbedo(b, matrix.albedo[parent], matrix.albedo[s], b) : b;
          held_.enter(s);
        }
      }
    before_ = -1;
    if (!leaving.empty()) {
      probe_.nodesLeft();
      stats_.left += leaving.size();
      if (auto removed = bounces_->remove(leaving); !removed) {
        if (removed.error().cause != ErrorCause::kOther) return removed;
        if (auto rebuilt = startRebuild(removed.error().line()); !rebuilt) return rebuilt;
      }
    }
    const bool at_once = settings_.blocks_per_frame == 0 && !rebuilding_;
    if (auto entered = enter(at_once ? bounces_->capacity() : 0); !entered) return entered;
    if (!settings_.correct && stats_.waiting > 0)
      return Error{ErrorCode::kUsage, "", "",
                   std::to_string(matrix.leaves.size()) + " nodes do not fit on " +
                       std::to_string(bounces_->capacity()) + " places",
                   "raise the places, lower the radius, or correct with the sparse rows"};
    return {};
  }

  bool resolvesRows() const override { return false; }
  Result<void> setSource(std::span<const Vec4> source) override {
    FF_CHECK_EQ(source.size(), source_.size());
    if (held_.goesBefore()) hold();
    repaired_ += copySound(source, source_);
    before_ = -1;
    return {};
  }

  // E such that M + C E is it, where that says anything about E.
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override {
    FF_CHECK_EQ(radiosity.size(), radiosity_.size());
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto solve = [](float b, float m, float rho) { return rho > 1e-3f ? std::max(0.0f, (b - m) / rho) : 0.0f; };
    repaired_ += copySound(radiosity, radiosity_);
    stepped_ = false;
    held_.letGo();
    for (uint32_t s = 0; s < radiosity.size(); ++s) {
      const Vec4 b = radiosity_[s], m = source_[s], rho = matrix_->albedo[s];
      irradiance_[s] = {solve(b.x, m.x, rho.x), solve(b.y, m.y, rho.y), solve(b.z, m.z, rho.z), 0};
    }
    before_ = -1;
    return {};
  }

  void ease(uint32_t frames) override { held_.ease(frames); }
  void pace(const LightPace& pace) override { held_.pace(pace); }

  Result<void> iterate(int k) override {
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto start = Clock::now();
    if (held_.due()) hold();
    if (held_.holds()) {
      held_.release(*matrix_, radiosity_, source_, [&](auto&& work) {
        for (uint32_t tile = 0; tile < matrix_->tiles.size(); ++tile) work(tile);
      });
      before_ = -1;
    }
    const uint32_t blocks =
        rebuilding_ ? std::max(settings_.blocks_per_frame, kRebuildBlocks) : settings_.blocks_per_frame;
    if (blocks > 0 && stats_.waiting > 0)
      if (auto entered = enter(blocks); !entered) return entered;
    if (rebuilding_ && stats_.waiting == 0) rebuilding_ = false;
    if (auto advanced = bounces_->advance(settings_.columns_per_frame); !advanced) return advanced.error();
    for (int i = 0; i < k; ++i)
      if (auto done = settings_.correct ? correct() : relight(); !done) return done;
    compose();
    stepped_ = true;
    if (settings_.correct)
      if (auto probed = probe(); !probed) return probed;
    last_ms_ = msSince(start);
    return {};
  }

  Result<void> radiosity(std::span<Vec4> out) override {
    FF_CHECK_EQ(out.size(), radiosity_.size());
    std::copy(radiosity_.begin(), radiosity_.end(), out.begin());
    return {};
  }

  uint64_t repaired() const override { return repaired_; }
  double lastMs() const override { return last_ms_; }
  const char* name() const override { return name_.c_str(); }
  const DenseStats& stats() const override { return stats_; }
  const BounceMatrix& matrix() const override { return *bounces_; }

 private:
  // Up to so many blocks of the leaves that wait.
  Result<void> enter(uint32_t blocks) {
    const uint32_t entering = places_.choose(uint64_t{blocks} * kMaxBlock);
    for (uint32_t first = 0; first < entering; first += kMaxBlock) {
      const uint32_t count = std::min(kMaxBlock, entering - first);
      const auto inserted = bounces_->insert(places_.take(first, count));
      if (inserted) {
        stats_.entered += count;
        continue;
      }
      places_.unseat(first, count, true);
      if (!settings_.correct || inserted.error().cause != ErrorCause::kOther) return inserted.error();
      ++stats_.refused;
      stats_.last_event = inserted.error().line();
    }
    countPlaces();
    return {};
  }

  void countPlaces() {
    stats_.waiting = places_.waiting();
    stats_.on_places = places_.taken();
  }

  // Built anew a few blocks a frame; until then the sparse rows do what the matrix does not.
  Result<void> startRebuild(std::string why) {
    ++stats_.rebuilds;
    stats_.last_event = std::move(why);
    if (auto cleared = bounces_->clear(); !cleared) return cleared;
    places_.clear();
    rebuilding_ = settings_.correct;
    countPlaces();
    probe_.builtAnew();
    before_ = -1;
    return settings_.correct ? Result<void>() : enter(bounces_->capacity());  // a baseline has nothing else
  }

  // B stays what it is: E becomes what the rows of now make of it, and the difference is held back.
  void hold() {
    std::ranges::fill(minus_, Vec4{});
    rows_.gather(matrix_->leaves, radiosity_, minus_, residual_);
    for (const uint32_t s : matrix_->leaves) {
      irradiance_[s] = residual_[s];
      held_.take(s, radiosity_[s] + (source_[s] + matrix_->albedo[s] * irradiance_[s]) * Vec4{-1, -1, -1, 0});
    }
    held_.taken();
  }

  void compose() {
    const std::vector<Vec4>& source = held_.holds() ? held_.lit() : source_;
    for (const uint32_t s : matrix_->leaves) {
      const Vec4 b = source[s] + matrix_->albedo[s] * irradiance_[s];
      radiosity_[s] = held_.holds() ? Vec4{std::max(b.x, 0.0f), std::max(b.y, 0.0f), std::max(b.z, 0.0f), 0} : b;
      if (isSound(radiosity_[s])) continue;
      radiosity_[s] = source_[s];
      ++repaired_;
    }
    rows_.refine(radiosity_);
    rows_.refine(irradiance_);  // for slots that become leaves when their children leave
  }

  // E = G M of what is on places; how many values of it were no light and are 0.
  Result<uint32_t> product() {
    for (uint32_t p = 0; p < bounces_->capacity(); ++p)
      by_place_[p] = places_.slotOf(p) != kNoSlot ? source_[places_.slotOf(p)] : Vec4{};
    if (auto lit = bounces_->relight(by_place_, out_by_place_); !lit) return lit.error();
    return copySound(out_by_place_, out_by_place_);
  }

  Result<void> relight() {
    auto unsound = product();
    if (!unsound) return unsound.error();
    if (*unsound > 0) {
      repaired_ += *unsound;
      if (auto rebuilt = startRebuild("the matrix is not finite"); !rebuilt) return rebuilt;
      if (unsound = product(); !unsound) return unsound.error();
      repaired_ += *unsound;
    }
    for (uint32_t p = 0; p < bounces_->capacity(); ++p)
      if (places_.slotOf(p) != kNoSlot) irradiance_[places_.slotOf(p)] = out_by_place_[p];
    return {};
  }

  Result<void> correct() {
    compose();
    for (const uint32_t s : matrix_->leaves) minus_[s] = irradiance_[s] * Vec4{-1, -1, -1, 0};
    rows_.gather(matrix_->leaves, radiosity_, minus_, residual_);
    double left = 0, norm = 0;
    for (const uint32_t s : matrix_->leaves) {
      left += squared(residual_[s]);
      norm += squared(irradiance_[s] + residual_[s]);  // F (M + C E)
    }
    uint32_t unsound = 0;
    for (const uint32_t s : matrix_->leaves) unsound += !isSound(irradiance_[s] + residual_[s]);
    if (unsound > 0) {  // nothing of E can be kept
      repaired_ += unsound;
      std::fill(irradiance_.begin(), irradiance_.end(), Vec4{});
      return startRebuild("radiosity was not finite");
    }
    stats_.residual = norm > 0 ? std::sqrt(left / norm) : 0;
    if (!rebuilding_)
      if (std::string why = whyGrown(before_, stats_.residual); !why.empty()) return startRebuild(std::move(why));
    before_ = stats_.residual;
    if (stats_.on_places > 0) {
      for (uint32_t p = 0; p < bounces_->capacity(); ++p) {
        const uint32_t s = places_.slotOf(p);
        by_place_[p] = s != kNoSlot ? matrix_->albedo[s] * residual_[s] : Vec4{};
      }
      if (auto lit = bounces_->relight(by_place_, out_by_place_); !lit) return lit;
      if (const uint32_t wrong = copySound(out_by_place_, out_by_place_); wrong > 0) {
        repaired_ += wrong;
        if (auto rebuilt = startRebuild("the matrix is not finite"); !rebuilt) return rebuilt;
      }
      for (uint32_t p = 0; p < bounces_->capacity(); ++p)  // after a rebuild there is none
        if (const uint32_t s = places_.slotOf(p); s != kNoSlot) residual_[s] = residual_[s] + out_by_place_[p];
    }
    for (const uint32_t s : matrix_->leaves) irradiance_[s] = irradiance_[s] + residual_[s];
    return {};
  }

  Result<void> probe() {
    if (rebuilding_ || stats_.on_places == 0) return {};
    probe_.draw(places_);
    std::fill(out_by_place_.begin(), out_by_place_.end(), Vec4{});
    if (auto lit = bounces_->relightChanged(probe_.places(), probe_.x(), out_by_place_); !lit) return lit;
    probe_.judge(*matrix_, places_, rows_, out_by_place_);
    stats_.probe = probe_.round();
    return probe_.verdict().empty() ? Result<void>() : startRebuild(probe_.verdict());
  }

  std::unique_ptr<BounceMatrix> bounces_;
  DenseSettings settings_;
  std::string name_;
  CutPlaces places_;
  SparseRows rows_;
  BounceMonitor probe_;
  const LocalMatrix* matrix_ = nullptr;
  std::vector<Vec4> source_, irradiance_, radiosity_, minus_, residual_;  // per slot
  std::vector<Vec4> by_place_, out_by_place_;
  bool rebuilding_ = false;
  HeldLight held_;
  bool stepped_ = false;  // radiosity_ is what a step came to
  double before_ = -1;  // residual before the last correction; -1: not to be compared with
  double last_ms_ = 0;
  uint64_t repaired_ = 0;
  DenseStats stats_;
};

}  // namespace

std::string whyGrown(double before, double now) {
  if (!(before > 0.01 && now > 1.5 * before)) return {};
  return "corrections made the error grow from " + std::to_string(before) + " to " + std::to_string(now);
}

std::unique_ptr<DenseSolver> makeDenseSolver(std::unique_ptr<BounceMatrix> matrix, const DenseSettings& settings) {
  return std::make_unique<Dense>(std::move(matrix), settings);
}

}  // namespace ff::runtime
