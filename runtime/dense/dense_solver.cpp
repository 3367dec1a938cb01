#include "runtime/dense/dense_solver.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>
#include <vector>

#include "runtime/dense/cut_places.h"
#include "runtime/gather_kernels.h"
#include "runtime/worker_pool.h"

namespace ff::runtime {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t kPartLeaves = 256;  // of a part handed to a thread
constexpr uint32_t kProbeFrames = 16, kProbeRows = 8;

Vec4 operator*(const Vec4& a, const Vec4& b) { return {a.x * b.x, a.y * b.y, a.z * b.z, 0}; }
Vec4 operator+(const Vec4& a, const Vec4& b) { return {a.x + b.x, a.y + b.y, a.z + b.z, 0}; }
double squared(const Vec4& v) {
  return static_cast<double>(v.x) * static_cast<double>(v.x) + static_cast<double>(v.y) * static_cast<double>(v.y) +
         static_cast<double>(v.z) * static_cast<double>(v.z);
}

class Dense final : public DenseSolver {
 public:
  Dense(std::unique_ptr<BounceMatrix> matrix, const DenseSettings& settings)
      : bounces_(std::move(matrix)),
        settings_(settings),
        limit_(settings.probe_limit > 0 ? settings.probe_limit : defaultProbeLimit(bounces_->name())),
        pool_(settings.threads),
        name_(std::string("dense: ") + bounces_->name()),
        places_(bounces_->capacity()) {
    if (const GatherKernel fast = gatherAvx2()) kernel_ = fast;
    for (auto* v : {&source_, &irradiance_, &radiosity_, &scale_, &minus_, &residual_, &work_}) v->reserve(kMaxSlots);
    by_place_.assign(bounces_->capacity(), {});
    out_by_place_.assign(bounces_->capacity(), {});
    for (auto* list : {&sampled_, &probe_places_}) list->reserve(kMaxSlots);
    probe_x_.reserve(bounces_->capacity());
  }

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override {
    const bool first = std::exchange(matrix_, &matrix) != &matrix;
    const uint32_t slots = matrix.slots();
    if (first)
      if (auto cleared = bounces_->clear(); !cleared) return cleared;
    const std::span<const uint32_t> leaving = places_.update(matrix, change, first);

    const bool anew = first || change.renumbered;
    if (first) fresh_ = -1, untouched_ = true;
    for (auto* v : {&irradiance_, &radiosity_, &source_}) {
      if (anew) v->clear();
      v->resize(slots);
    }
    for (auto* v : {&scale_, &minus_, &residual_, &work_}) v->assign(slots, {});
    for (const uint32_t s : matrix.leaves)
      scale_[s] = {matrix.row_scale[s], matrix.row_scale[s], matrix.row_scale[s], 0};
    if (!anew)
      for (const uint32_t t : change.entered) {  // parents first
        const SlotRange& range = matrix.tiles[t];
        for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
          const uint32_t parent = matrix.parent_slot[s];
          irradiance_[s] = parent != kNoSlot ? irradiance_[parent] : Vec4{};
          radiosity_[s] = parent != kNoSlot ? radiosity_[parent] : Vec4{};
        }
      }
    before_ = -1;
    if (!leaving.empty()) {
      untouched_ = false;
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

  Result<void> setSource(std::span<const Vec4> source) override {
    FF_CHECK_EQ(source.size(), source_.size());
    std::copy(source.begin(), source.end(), source_.begin());
    before_ = -1;
    return {};
  }

  // E such that M + C E is it, where that says anything about E.
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override {
    FF_CHECK_EQ(radiosity.size(), radiosity_.size());
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto solve = [](float b, float m, float rho) { return rho > 1e-3f ? std::max(0.0f, (b - m) / rho) : 0.0f; };
    for (uint32_t s = 0; s < radiosity.size(); ++s) {
      const Vec4 b = radiosity[s], m = source_[s], rho = matrix_->albedo[s];
      radiosity_[s] = {b.x, b.y, b.z, 0};
      irradiance_[s] = {solve(b.x, m.x, rho.x), solve(b.y, m.y, rho.y), solve(b.z, m.z, rho.z), 0};
    }
    before_ = -1;
    return {};
  }

  Result<void> iterate(int k) override {
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto start = Clock::now();
    const uint32_t blocks =
        rebuilding_ ? std::max(settings_.blocks_per_frame, kRebuildBlocks) : settings_.blocks_per_frame;
    if (blocks > 0 && stats_.waiting > 0)
      if (auto entered = enter(blocks); !entered) return entered;
    if (rebuilding_ && stats_.waiting == 0) rebuilding_ = false;
    if (auto advanced = bounces_->advance(settings_.columns_per_frame); !advanced) return advanced.error();
    for (int i = 0; i < k; ++i)
      if (auto done = settings_.correct ? correct() : relight(); !done) return done;
    compose();
    if (settings_.correct)
      if (auto probed = probe(); !probed) return probed;
    last_ms_ = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return {};
  }

  Result<void> radiosity(std::span<Vec4> out) override {
    FF_CHECK_EQ(out.size(), radiosity_.size());
    std::copy(radiosity_.begin(), radiosity_.end(), out.begin());
    return {};
  }

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
      const auto inserted = bounces_->insert(places_.seat(first, count));
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
    rebuilding_ = true;
    countPlaces();
    probe_frame_ = 0;
    probe_left_ = probe_norm_ = 0;
    fresh_ = before_ = -1;
    untouched_ = true;
    return {};
  }

  // Refined slots: the mean of their children.
  void refine(std::vector<Vec4>& values) {
    for (const LocalMatrix::Refined& refined : matrix_->refined) {
      Vec4 mean;
      for (uint32_t c = refined.first_child; c < refined.first_child + refined.children; ++c) {
        const float weight = places_.blocks().childWeight(c);
        mean = mean + values[c] * Vec4{weight, weight, weight, 0};
      }
      values[refined.slot] = mean;
    }
  }

  void compose() {
    for (const uint32_t s : matrix_->leaves) radiosity_[s] = source_[s] + matrix_->albedo[s] * irradiance_[s];
    refine(radiosity_);
    refine(irradiance_);  // for slots that become leaves when their children leave
  }

  // to[s] = F from - minus, for the slots listed.
  void gather(const std::vector<uint32_t>& slots, const std::vector<Vec4>& from, const std::vector<Vec4>& minus,
              std::vector<Vec4>& to) {
    const GatherJob job{matrix_->row_start.data(),
                        matrix_->row_entries.data(),
                        matrix_->entries.data(),
                        slots.data(),
                        scale_.data(),
                        minus.data(),
                        from.data(),
                        to.data()};
    const auto count = static_cast<uint32_t>(slots.size());
    pool_.run((count + kPartLeaves - 1) / kPartLeaves,
              [&](uint32_t part) { kernel_(job, part * kPartLeaves, std::min((part + 1) * kPartLeaves, count)); });
  }

  Result<void> relight() {
    for (uint32_t p = 0; p < bounces_->capacity(); ++p)
      by_place_[p] = places_.slotOf(p) != kNoSlot ? source_[places_.slotOf(p)] : Vec4{};
    if (auto lit = bounces_->relight(by_place_, out_by_place_); !lit) return lit;
    for (uint32_t p = 0; p < bounces_->capacity(); ++p)
      if (places_.slotOf(p) != kNoSlot) irradiance_[places_.slotOf(p)] = out_by_place_[p];
    return {};
  }

  Result<void> correct() {
    compose();
    for (const uint32_t s : matrix_->leaves) minus_[s] = irradiance_[s] * Vec4{-1, -1, -1, 0};
    gather(matrix_->leaves, radiosity_, minus_, residual_);
    double left = 0, norm = 0;
    for (const uint32_t s : matrix_->leaves) {
      left += squared(residual_[s]);
      norm += squared(irradiance_[s] + residual_[s]);  // F (M + C E)
    }
    if (!std::isfinite(left)) {  // nothing of E can be kept
      std::fill(irradiance_.begin(), irradiance_.end(), Vec4{});
      return startRebuild("radiosity was not finite");
    }
    stats_.residual = norm > 0 ? std::sqrt(left / norm) : 0;
    // With the light and the nodes as they were, a correction that leaves more than it found is none.
    if (before_ > 0.01 && stats_.residual > 1.5 * before_ && !rebuilding_)
      return startRebuild("corrections made the error grow from " + std::to_string(before_) + " to " +
                          std::to_string(stats_.residual));
    before_ = stats_.residual;
    if (stats_.on_places > 0) {
      for (uint32_t p = 0; p < bounces_->capacity(); ++p) {
        const uint32_t s = places_.slotOf(p);
        by_place_[p] = s != kNoSlot ? matrix_->albedo[s] * residual_[s] : Vec4{};
      }
      if (auto lit = bounces_->relight(by_place_, out_by_place_); !lit) return lit;
      double all = 0;
      for (const Vec4& e : out_by_place_) all += squared(e);
      if (!std::isfinite(all)) {
        if (auto rebuilt = startRebuild("the matrix is not finite"); !rebuilt) return rebuilt;
      }
      for (uint32_t p = 0; p < bounces_->capacity(); ++p)  // after a rebuild there is none
        if (const uint32_t s = places_.slotOf(p); s != kNoSlot) residual_[s] = residual_[s] + out_by_place_[p];
    }
    for (const uint32_t s : matrix_->leaves) irradiance_[s] = irradiance_[s] + residual_[s];
    return {};
  }

  // One sixteenth of the round (dense_solver.h). Among the nodes on places only: G is theirs alone.
  Result<void> probe() {
    if (rebuilding_ || stats_.on_places == 0) return {};
    const auto random = [this] {
      random_ = random_ * 6364136223846793005u + 1442695040888963407u;
      return static_cast<float>(random_ >> 40) / 16777216.0f;
    };
    probe_places_.clear();
    probe_x_.clear();
    sampled_.clear();
    std::fill(work_.begin(), work_.end(), Vec4{});
    std::fill(out_by_place_.begin(), out_by_place_.end(), Vec4{});
    const uint32_t row_phase = static_cast<uint32_t>(random_ >> 33) % kProbeRows;
    for (uint32_t p = 0, n = 0; p < bounces_->capacity(); ++p) {
      const uint32_t s = places_.slotOf(p);
      if (s == kNoSlot) continue;
      if (n % kProbeFrames == probe_frame_) {
        probe_places_.push_back(p);
        probe_x_.push_back({random(), random(), random(), 0});
        work_[s] = probe_x_.back();
      }
      if (n++ / kProbeFrames % kProbeRows == row_phase) sampled_.push_back(s);
    }
    if (auto lit = bounces_->relightChanged(probe_places_, probe_x_, out_by_place_); !lit) return lit;
    // F x, then F (x + C y) - y.
    refine(work_);
    for (const uint32_t s : sampled_) minus_[s] = {};
    gather(sampled_, work_, minus_, residual_);
    for (const uint32_t s : sampled_) {
      probe_norm_ += squared(residual_[s]);
      minus_[s] = out_by_place_[places_.placeOf(s)] * Vec4{-1, -1, -1, 0};
    }
    for (uint32_t p = 0; p < bounces_->capacity(); ++p)
      if (const uint32_t s = places_.slotOf(p); s != kNoSlot)
        work_[s] = work_[s] + matrix_->albedo[s] * out_by_place_[p];
    refine(work_);
    gather(sampled_, work_, minus_, residual_);
    for (const uint32_t s : sampled_) probe_left_ += squared(residual_[s]);
    if (++probe_frame_ < kProbeFrames) return {};
    probe_frame_ = 0;
    stats_.probe = probe_norm_ > 0 ? std::sqrt(probe_left_ / probe_norm_) : 0;
    probe_left_ = probe_norm_ = 0;
    if (untouched_ && std::isfinite(stats_.probe) && (fresh_ < 0 || stats_.probe < fresh_)) fresh_ = stats_.probe;
    const double limit = std::max(limit_, kOfFresh * fresh_);
    if (stats_.probe <= limit) return {};
    return startRebuild("residual probe " + std::to_string(stats_.probe) + " above its limit of " +
                        std::to_string(limit));
  }

  std::unique_ptr<BounceMatrix> bounces_;
  DenseSettings settings_;
  double limit_;
  WorkerPool pool_;
  GatherKernel kernel_ = gatherPortable;
  std::string name_;
  CutPlaces places_;
  const LocalMatrix* matrix_ = nullptr;
  std::vector<Vec4> source_, irradiance_, radiosity_, scale_, minus_, residual_, work_;  // per slot
  std::vector<Vec4> by_place_, out_by_place_, probe_x_;
  std::vector<uint32_t> sampled_, probe_places_;
  bool rebuilding_ = false;
  double before_ = -1;  // residual before the last correction; -1: not to be compared with
  uint32_t probe_frame_ = 0;
  double probe_left_ = 0, probe_norm_ = 0;
  bool untouched_ = true;  // no node has left since the matrix was built
  double fresh_ = -1;  // the least of the rounds while it was untouched; -1: none yet
  uint64_t random_ = 1;
  double last_ms_ = 0;
  DenseStats stats_;
};

}  // namespace

double defaultProbeLimit(const std::string& matrix_name) {
  if (matrix_name.find("luminance") != std::string::npos) return 5e-2;
  return matrix_name.find("fp16") != std::string::npos ? 2e-2 : 1e-4;
}

std::unique_ptr<DenseSolver> makeDenseSolver(std::unique_ptr<BounceMatrix> matrix, const DenseSettings& settings) {
  return std::make_unique<Dense>(std::move(matrix), settings);
}

}  // namespace ff::runtime
