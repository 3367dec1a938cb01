#include "runtime/dense/sparse_rows.h"

#include <algorithm>

namespace ff::runtime {
namespace {

constexpr uint32_t kPartLeaves = 256;  // of a part handed to a thread

}  // namespace

SparseRows::SparseRows(int threads) : pool_(threads) {
  if (const GatherKernel fast = gatherAvx2()) kernel_ = fast;
  white_.reserve(kMaxSlots);
}

void SparseRows::takeUp(const LocalMatrix& matrix) {
  matrix_ = &matrix;
  if (const size_t most = std::max(matrix.slots(), matrix.most_slots); white_.size() < most) white_.resize(most, {1, 1, 1, 0});
}

void SparseRows::gather(std::span<const uint32_t> leaves, std::span<const Vec4> from, std::span<const Vec4> minus,
                        std::span<Vec4> to) {
  const GatherJob job{matrix_->row_start.data(),
                      matrix_->row_entries.data(),
                      matrix_->entries.data(),
                      leaves.data(),
                      white_.data(),
                      matrix_->row_scale.data(),
                      minus.data(),
                      from.data(),
                      to.data()};
  const auto count = static_cast<uint32_t>(leaves.size());
  pool_.run((count + kPartLeaves - 1) / kPartLeaves,
            [&](uint32_t part) { (void)kernel_(job, part * kPartLeaves, std::min((part + 1) * kPartLeaves, count)); });
}

void SparseRows::refine(std::span<Vec4> values) const {
  refineSlots(*matrix_, values.data(), 0, static_cast<uint32_t>(matrix_->refined.size()));
}

}  // namespace ff::runtime
