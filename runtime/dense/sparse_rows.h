// The sparse rows of a cut as the dense solvers on the CPU ask for them: F without albedo, for any of the leaves.
#pragma once
#include <span>
#include <vector>

#include "runtime/dense/entering_blocks.h"
#include "runtime/gather/gather_kernels.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {

// Over the channels.
inline double squared(const Vec4& v) {
  return static_cast<double>(v.x) * static_cast<double>(v.x) + static_cast<double>(v.y) * static_cast<double>(v.y) +
         static_cast<double>(v.z) * static_cast<double>(v.z);
}

// One caller at a time. Allocates at the start only.
class SparseRows {
 public:
  explicit SparseRows(int threads);  // 0 = all cores
  // The matrix stays where it is, and as it is until the next call.
  void takeUp(const LocalMatrix& matrix);
  // to[s] = F from - minus, for the leaves listed. All per slot; refined slots of `from` are the means of their children.
  void gather(std::span<const uint32_t> leaves, std::span<const Vec4> from, std::span<const Vec4> minus, std::span<Vec4> to);
  // Refined slots: the mean of their children.
  void refine(std::span<Vec4> values) const;

 private:
  WorkerPool pool_;
  GatherKernel kernel_ = gatherPortable;
  const LocalMatrix* matrix_ = nullptr;
  std::vector<Vec4> white_;  // per slot: F is asked without albedo
};

}  // namespace ff::runtime
