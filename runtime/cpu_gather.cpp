// Jacobi iterations on the CPU. Nothing is allocated or locked between setMatrix() calls. Every row is summed by one
// thread in the order of its entries, so the result does not depend on the number of threads.
#include <algorithm>
#include <chrono>

#include "runtime/gather_kernels.h"
#include "runtime/solver.h"
#include "runtime/worker_pool.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kPartEntries = 16384;  // of a part handed to a thread: some 10 us, fine enough to share out evenly

class CpuGather final : public Solver {
 public:
  explicit CpuGather(int threads) : pool_(threads) {
    if (const GatherKernel fast = gatherAvx2()) kernel_ = fast;
  }

  Result<void> setMatrix(std::shared_ptr<const LocalMatrix> matrix, std::span<const Vec4> warm_start) override {
    const uint32_t slots = matrix->slots();
    if (!warm_start.empty()) FF_CHECK_EQ(warm_start.size(), size_t{slots});
    matrix_ = std::move(matrix);
    from_.assign(warm_start.begin(), warm_start.end());
    from_.resize(slots);
    for (Vec4& value : from_) value.w = 0;
    to_.assign(slots, {});
    source_.resize(slots);
    reflectance_.resize(slots);
    for (uint32_t s = 0; s < slots; ++s) {
      const Vec4 albedo = matrix_->albedo[s];
      const float scale = matrix_->row_scale[s];
      reflectance_[s] = {albedo.x * scale, albedo.y * scale, albedo.z * scale, 0};
    }
    divideRows();
    weighChildren();
    return {};
  }

  Result<void> setSource(std::span<const Vec4> source) override {
    FF_CHECK_EQ(source.size(), source_.size());
    std::copy(source.begin(), source.end(), source_.begin());
    return {};
  }

  Result<void> iterate(int k) override {
    FF_CHECK_EQ(matrix_ != nullptr, true);
    const auto start = std::chrono::steady_clock::now();
    for (int i = 0; i < k; ++i) {
      const GatherJob job{matrix_->row_start.data(),
                          matrix_->entries.data(),
                          leaves_.data(),
                          reflectance_.data(),
                          source_.data(),
                          from_.data(),
                          to_.data()};
      pool_.run(static_cast<uint32_t>(parts_.size() - 1),
                [&](uint32_t part) { kernel_(job, parts_[part], parts_[part + 1]); });
      refine();
      from_.swap(to_);
    }
    last_ms_ = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    return {};
  }

  Result<void> radiosity(std::span<Vec4> out) override {
    FF_CHECK_EQ(out.size(), from_.size());
    std::copy(from_.begin(), from_.end(), out.begin());
    return {};
  }

  double lastMs() const override { return last_ms_; }
  const char* name() const override { return "cpu"; }

 private:
  void divideRows() {
    leaves_.clear();
    parts_.assign(1, 0);
    uint32_t entries = 0;
    for (uint32_t s = 0; s < matrix_->slots(); ++s) {
      if (!matrix_->leaf[s]) continue;
      leaves_.push_back(s);
      entries += matrix_->row_start[s + 1] - matrix_->row_start[s];
      if (entries < kPartEntries) continue;
      parts_.push_back(static_cast<uint32_t>(leaves_.size()));
      entries = 0;
    }
    if (parts_.back() != leaves_.size()) parts_.push_back(static_cast<uint32_t>(leaves_.size()));
  }

  void weighChildren() {
    child_weight_.assign(matrix_->slots(), 0);
    for (const LocalMatrix::Refined& refined : matrix_->refined) {
      const float* area = matrix_->area_m2.data() + refined.first_child;
      double total = 0;
      for (uint32_t c = 0; c < refined.children; ++c) total += static_cast<double>(area[c]);
      for (uint32_t c = 0; c < refined.children; ++c)
        child_weight_[refined.first_child + c] = total > 0 ? static_cast<float>(static_cast<double>(area[c]) / total)
                                                           : 1.0f / static_cast<float>(refined.children);
    }
  }

  // A few thousand sums; not worth a second meeting of the threads.
  void refine() {
    for (const LocalMatrix::Refined& refined : matrix_->refined) {
      Vec4 mean;
      for (uint32_t c = refined.first_child; c < refined.first_child + refined.children; ++c) {
        mean.x += child_weight_[c] * to_[c].x;
        mean.y += child_weight_[c] * to_[c].y;
        mean.z += child_weight_[c] * to_[c].z;
      }
      to_[refined.slot] = mean;
    }
  }

  WorkerPool pool_;
  GatherKernel kernel_ = gatherPortable;
  std::shared_ptr<const LocalMatrix> matrix_;
  std::vector<Vec4> reflectance_, source_, from_, to_;
  std::vector<float> child_weight_;  // per slot: its area over its parent's children's
  std::vector<uint32_t> leaves_;     // slots with rows
  std::vector<uint32_t> parts_;      // ranges of leaves_ of about kPartEntries entries
  double last_ms_ = 0;
};

}  // namespace

std::unique_ptr<Solver> makeCpuGather(int threads) { return std::make_unique<CpuGather>(threads); }

}  // namespace ff::runtime
