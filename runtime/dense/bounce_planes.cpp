#include "runtime/dense/bounce_planes.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace ff::runtime {
namespace {

// Rows of the matrix that a part of a task takes: gathers keep a tile's columns in the second-level cache; in the pass
// the tall factor's rows (512 KiB) stay there while columns stream by.
constexpr uint32_t kGatherRows = 128, kLightRows = 512, kLightColumns = 256, kPassRows = 1024, kPassColumns = 192;
constexpr uint16_t kNotEntering = 0xffff;

uint32_t roundUp(uint32_t value, uint32_t multiple) { return (value + multiple - 1) / multiple * multiple; }

void setStored(float& to, float value) { to = value; }
void setStored(Half& to, float value) { to = toHalf(value * kHalfScale); }
float stored(float from) { return from; }
float stored(Half from) { return toFloat(from) / kHalfScale; }

}  // namespace

template <class Element>
BouncePlanes<Element>::BouncePlanes(uint32_t places, uint32_t channels, WorkerPool& pool)
    : pool_(pool),
      rows_(roundUp(places, kPanelRows)),
      stride_(rows_ + kPanelRows),  // no power of two: columns would share the same few sets of the caches
      planes_(channels),
      scratch_(static_cast<size_t>(pool.threads())),
      scratch_taken_(static_cast<size_t>(pool.threads())) {
  for (Plane& p : planes_) {
    p.matrix = PageMemory<Element>(stride_ * rows_);
    p.albedo.assign(rows_, 0);
    p.tall.assign(size_t{rows_} * kMaxRank, 0);
    p.wide.assign(size_t{rows_} * kFactorStride, 0);
    p.rows.assign(size_t{rows_} * kFactorStride, 0);
    p.left.assign(size_t{kMaxBlock} * kMaxRank, 0);
    p.right.assign(size_t{kMaxBlock} * kFactorStride, 0);
  }
  for (auto& s : scratch_) s.assign(size_t{rows_} * kPanelRows, 0);
  order_.assign(rows_, kNotEntering);
  blocks_.assign(rows_ / 8, 0);
  block_used_.assign(rows_ / 8, 0);
  partial_.assign(size_t{(rows_ + kLightColumns - 1) / kLightColumns} * 3 * rows_, 0);
}

template <class Element>
bool BouncePlanes<Element>::allocated() const {
  return std::all_of(planes_.begin(), planes_.end(), [](const Plane& p) { return static_cast<bool>(p.matrix); });
}

template <class Element>
uint32_t BouncePlanes<Element>::usedRows() const {
  return roundUp(used_, kPanelRows);
}

// Calls task(plane, part) for the parts of each plane.
template <class Element>
template <class Task>
void BouncePlanes<Element>::forParts(uint32_t parts, Task&& task) {
  pool_.run(parts * static_cast<uint32_t>(planes_.size()),
            [&](uint32_t part) { task(planes_[part / parts], part % parts); });
}

// Calls task(plane, begin, end) for runs of the rows, or columns, in use.
template <class Element>
template <class Task>
void BouncePlanes<Element>::forRows(Task&& task) {
  const uint32_t rows = usedRows();
  forParts((rows + kGatherRows - 1) / kGatherRows, [&](Plane& p, uint32_t part) {
    task(p, part * kGatherRows, std::min((part + 1) * kGatherRows, rows));
  });
}

template <class Element>
void BouncePlanes<Element>::use(uint32_t used) {
  wanted_ = used;
  const uint32_t before = usedRows();
  used_ = rank_ > 0 ? std::max(used_, used) : used;
  const uint32_t after = usedRows();
  if (rank_ == 0 || after <= before) return;
  for (Plane& p : planes_) {  // what was pending does not concern them
    std::fill_n(p.tall.data() + panelIndex(before, 0), size_t{after - before} * kMaxRank, 0.0f);
    std::fill_n(p.wide.data() + size_t{before} * kFactorStride, size_t{after - before} * kFactorStride, 0.0f);
  }
}

// An update starts from factors that no column has taken in yet, with room for its own.
template <class Element>
void BouncePlanes<Element>::makeRoom(uint32_t k) {
  if (frontier_ > 0 || rank_ + k > kMaxRank) fold(used_);
}

template <class Element>
bool BouncePlanes<Element>::enter(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  makeRoom(k);
  for (uint32_t r = 0; r < k; ++r) order_[block.places[r]] = static_cast<uint16_t>(r);
  gather(block);
  solve(block);
  const bool taken =
      std::all_of(planes_.begin(), planes_.end(), [&](const Plane& p) { return trusted(p, k); });
  if (taken) {
    writeColumns(block.places);
    makeWide(k);
    rank_ += k;
  }
  for (const uint32_t place : block.places) order_[place] = kNotEntering;
  return taken;
}

// U in `tall`, V in `rows`.
template <class Element>
void BouncePlanes<Element>::gather(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  const uint32_t rows = usedRows();
  if (rank_ > 0)
    forParts(k, [&](Plane& p, uint32_t r) {  // wide C F_LP, F_PL C tall
      float* right = &p.right[size_t{r} * kFactorStride];
      std::fill_n(right, rank_, 0.0f);
      for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e) {
        const uint32_t place = block.receivers[e];
        const float factor = block.column_values[e] * p.albedo[place];
        const float* wide = &p.wide[size_t{place} * kFactorStride];
        for (uint32_t i = 0; i < rank_; ++i) right[i] += factor * wide[i];
      }
      std::array<float, kMaxRank> left{};
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) {
        const uint32_t place = block.columns[e];
        if (order_[place] != kNotEntering) continue;
        const float factor = block.row_values[e] * p.albedo[place];
        const float* tall = &p.tall[panelIndex(place, 0)];
        for (uint32_t i = 0; i < rank_; ++i) left[i] += factor * tall[size_t{i} * kPanelRows];
      }
      for (uint32_t i = 0; i < rank_; ++i) p.left[panelIndex(r, i)] = left[i];
    });
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    kernels_.gatherColumns(
        p.matrix.data(), stride_, begin, end,
        {k, block.column_start.data(), block.receivers.data(), block.column_values.data(), p.albedo.data()},
        &p.tall[panelIndex(0, rank_)]);
    addPendingToTall(p, begin, end, k);
  });
  std::fill_n(block_used_.begin(), rows / 8, uint8_t{0});
  for (const uint32_t place : block.columns) block_used_[place / 8] = 1;
  uint32_t blocks = 0;
  for (uint32_t b = 0; b < rows / 8; ++b)
    if (block_used_[b]) blocks_[blocks++] = b;
  forParts(rows / kPanelRows, [&](Plane& p, uint32_t part) {
    uint32_t own = 0;  // there is a scratch per thread, so one is free
    while (scratch_taken_[own].test_and_set(std::memory_order_acquire))
      own = (own + 1) % static_cast<uint32_t>(scratch_.size());
    kernels_.gatherRows(p.matrix.data(), stride_, part * kPanelRows, blocks_.data(), blocks,
                        {k, block.row_start.data(), block.columns.data(), block.row_values.data(), p.albedo.data()},
                        scratch_[own].data(), p.rows.data());
    scratch_taken_[own].clear(std::memory_order_release);
  });
  addPendingToRows(k);
  for (Plane& p : planes_)
    for (uint32_t r = 0; r < k; ++r) {
      for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
        p.tall[panelIndex(block.receivers[e], rank_ + r)] += block.column_values[e];
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e)
        if (order_[block.columns[e]] == kNotEntering)
          p.rows[size_t{block.columns[e]} * kFactorStride + r] += block.row_values[e];
    }
}

// The k columns after those pending += pending ones times `right`.
template <class Element>
void BouncePlanes<Element>::addPendingToTall(Plane& p, uint32_t begin, uint32_t end, uint32_t k) {
  if (rank_ == 0) return;
  for (uint32_t row = begin; row < end; row += kPanelRows)
    product_(&p.tall[panelIndex(row, 0)], rank_, p.right.data(), &p.tall[panelIndex(row, rank_)], kPanelRows, 0, kPanelRows, k);
}

// k of `rows` += `left` times the pending ones of `wide`.
template <class Element>
void BouncePlanes<Element>::addPendingToRows(uint32_t k) {
  if (rank_ == 0) return;
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    product_(p.left.data(), rank_, &p.wide[size_t{begin} * kFactorStride], &p.rows[size_t{begin} * kFactorStride],
             kFactorStride, 0, roundUp(k, kPanelRows), end - begin);
  });
}

// S in `s`, K in `k`, K S in `work`.
template <class Element>
void BouncePlanes<Element>::solve(const EnteringBlock& block) {
  const auto k = static_cast<uint32_t>(block.places.size());
  forParts(k, [&](Plane& plane, uint32_t r) {
    double carried = 0;
    double* s = &plane.s(r, 0);
    std::fill_n(s, k, 0.0);
    for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) {
      const uint32_t place = block.columns[e];
      if (order_[place] != kNotEntering) continue;
      const double factor = static_cast<double>(block.row_values[e]) * static_cast<double>(plane.albedo[place]);
      const float* u = &plane.tall[panelIndex(place, rank_)];
      for (uint32_t p = 0; p < k; ++p) s[p] += factor * static_cast<double>(u[size_t{p} * kPanelRows]);
    }
    for (uint32_t p = 0; p < k; ++p) carried += s[p] * static_cast<double>(plane.albedo[block.places[p]]);
    plane.carried[r] = carried;
    for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) {
      const uint16_t p = order_[block.columns[e]];
      if (p != kNotEntering) s[p] += static_cast<double>(block.row_values[e]);
    }
  });
  forParts(1, [&](Plane& p, uint32_t) {
    for (uint32_t i = 0; i < k; ++i)
      for (uint32_t j = 0; j < k; ++j)
        p.work(i, j) = (i == j ? 1 : 0) - p.s(i, j) * static_cast<double>(p.albedo[block.places[j]]);
    p.solved = invert(p.work, k, p.k);
    if (p.solved) runtime::multiply(p.k, p.s, k, p.work);
  });
}

// K = I + S C + (S C)^2 + ...: nothing in it is negative, and it multiplies the rounding errors of S (stored fp16 is
// off by up to 2^-12 of a value). That is what one block can be judged by; what a walk gathers, the caller's residual
// shows.
template <class Element>
bool BouncePlanes<Element>::trusted(const Plane& p, uint32_t k) const {
  if (!p.solved) return false;
  const double norm = rowNorm(p.k, k);
  if (!std::isfinite(norm)) return false;
  for (uint32_t i = 0; i < k; ++i)
    for (uint32_t j = 0; j < k; ++j)
      if (p.k(i, j) < -1e-3 * norm) return false;
  const double most = *std::max_element(p.carried, p.carried + k);
  const double error = most * (sizeof(Element) == 2 ? 0x1p-12 : 0x1p-21) + 0x1p-22;
  return error * norm < 0.1;
}

// G_LP and G_PP into the matrix; then U C_P with ones at P in `tall`, so that the product with `wide` writes G_PL too.
template <class Element>
void BouncePlanes<Element>::writeColumns(std::span<const uint32_t> places) {
  const auto k = static_cast<uint32_t>(places.size());
  for (Plane& p : planes_)
    for (uint32_t j = 0; j < k; ++j)
      for (uint32_t i = 0; i < k; ++i)
        p.right[size_t{j} * kFactorStride + i] =
            static_cast<float>((i == j ? 1 : 0) + static_cast<double>(p.albedo[places[i]]) * p.work(i, j));
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    for (uint32_t j = 0, run; j < k; j += run) {
      for (run = 1; j + run < k && places[j + run] == places[j] + run;) ++run;
      kernels_.addProduct(&p.tall[panelIndex(0, rank_)], k, &p.right[size_t{j} * kFactorStride],
                          p.matrix.data() + places[j] * stride_, stride_, begin, end, run);
    }
    for (uint32_t row = begin; row < end; row += kPanelRows)
      for (uint32_t j = 0; j < k; ++j) {
        float* u = &p.tall[panelIndex(row, rank_ + j)];
        for (uint32_t i = 0; i < kPanelRows; ++i) u[i] *= p.albedo[places[j]];
      }
  });
  for (Plane& p : planes_)
    for (uint32_t j = 0; j < k; ++j) {
      p.tall[panelIndex(places[j], rank_ + j)] = 1;
      for (uint32_t i = 0; i < k; ++i)
        setStored(p.matrix.data()[places[j] * stride_ + places[i]], static_cast<float>(p.work(i, j)));
    }
}

// The next k of `wide` = K rows.
template <class Element>
void BouncePlanes<Element>::makeWide(uint32_t k) {
  const uint32_t padded = roundUp(k, kPanelRows);
  for (Plane& p : planes_)
    for (uint32_t j = 0; j < k; ++j)
      for (uint32_t i = 0; i < padded; ++i) p.left[panelIndex(i, j)] = i < k ? static_cast<float>(p.k(i, j)) : 0.0f;
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    float* wide = &p.wide[size_t{begin} * kFactorStride + rank_];
    for (uint32_t column = 0; column < end - begin; ++column)
      std::fill_n(wide + size_t{column} * kFactorStride, padded, 0.0f);
    product_(p.left.data(), k, &p.rows[size_t{begin} * kFactorStride], wide, kFactorStride, 0, padded, end - begin);
  });
}

template <class Element>
bool BouncePlanes<Element>::change(std::span<const uint32_t> places, const Change& change, bool leave) {
  const auto k = static_cast<uint32_t>(places.size());
  makeRoom(k);
  for (Plane& p : planes_)
    for (uint32_t j = 0; j < k; ++j)
      for (uint32_t i = 0; i < rank_; ++i) {
        p.right[size_t{j} * kFactorStride + i] = p.wide[size_t{places[j]} * kFactorStride + i];
        p.left[panelIndex(j, i)] = p.tall[panelIndex(places[j], i)];
      }
  // Rows that leave are taken out where they are read: they are in the cache now.
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    for (uint32_t j = 0; j < k; ++j) {
      const Element* column = p.matrix.data() + places[j] * stride_;
      for (uint32_t row = begin; row < end; ++row) p.tall[panelIndex(row, rank_ + j)] = stored(column[row]);
    }
    addPendingToTall(p, begin, end, k);
  });
  forRows([&](Plane& p, uint32_t begin, uint32_t end) {
    for (uint32_t column = begin; column < end; ++column) {
      Element* from = p.matrix.data() + column * stride_;
      float* row = &p.rows[size_t{column} * kFactorStride];
      for (uint32_t j = 0; j < k; ++j) row[j] = stored(from[places[j]]);
      if (leave)
        for (uint32_t j = 0; j < k; ++j) from[places[j]] = {};
    }
  });
  addPendingToRows(k);
  bool solved = true;
  for (Plane& p : planes_) {
    const auto& by = change[number(p)];
    for (uint32_t i = 0; i < k; ++i)
      for (uint32_t j = 0; j < k; ++j)
        p.work(i, j) = (i == j ? 1 : 0) - static_cast<double>(p.tall[panelIndex(places[i], rank_ + j)]) * by[j];
    solved = solved && invert(p.work, k, p.k);
    for (uint32_t i = 0; i < k; ++i)
      for (uint32_t j = 0; j < k; ++j) p.k(i, j) *= by[i];
    solved = solved && std::isfinite(rowNorm(p.k, k));
  }
  if (!solved) return false;
  makeWide(k);
  rank_ += k;
  if (!leave) return true;
  for (Plane& p : planes_)
    for (const uint32_t place : places) {
      p.albedo[place] = 0;
      std::memset(static_cast<void*>(p.matrix.data() + place * stride_), 0, stride_ * sizeof(Element));
      std::fill_n(&p.wide[size_t{place} * kFactorStride], rank_, 0.0f);
      for (uint32_t i = 0; i < rank_; ++i) p.tall[panelIndex(place, i)] = 0;
    }
  return true;
}

template <class Element>
uint32_t BouncePlanes<Element>::fold(uint32_t columns) {
  if (rank_ == 0) return 0;
  const uint32_t rows = usedRows(), begin = frontier_, end = begin + std::min(columns, used_ - begin);
  const uint32_t row_parts = (rows + kPassRows - 1) / kPassRows;
  const uint32_t column_parts = (end - begin + kPassColumns - 1) / kPassColumns;
  forParts(row_parts * column_parts, [&](Plane& p, uint32_t part) {
    const uint32_t first = begin + part % column_parts * kPassColumns, last = std::min(first + kPassColumns, end);
    const uint32_t top = part / column_parts * kPassRows, bottom = std::min(top + kPassRows, rows);
    kernels_.addProduct(p.tall.data(), rank_, &p.wide[size_t{first} * kFactorStride],
                        p.matrix.data() + first * stride_, stride_, top, bottom, last - first);
  });
  frontier_ = end;
  if (frontier_ < used_) return used_ - frontier_;
  rank_ = frontier_ = 0;
  used_ = wanted_;
  return 0;
}

template <class Element>
void BouncePlanes<Element>::clear() {
  for (Plane& p : planes_) {
    std::memset(static_cast<void*>(p.matrix.data()), 0, size_t{stride_} * usedRows() * sizeof(Element));
    std::fill(p.albedo.begin(), p.albedo.end(), 0.0f);
  }
  used_ = wanted_ = frontier_ = rank_ = 0;
}

template <class Element>
void BouncePlanes<Element>::multiply(std::span<const uint32_t> columns, const float* const factors[3],
                                     float* const out[3]) {
  const auto n = static_cast<uint32_t>(columns.size()), rows = usedRows(), k = rank_;
  const auto planeOf = [&](uint32_t c) -> const Plane& { return planes_[c % planes_.size()]; };
  if (k > 0)
    pool_.run(3, [&](uint32_t c) {
      auto& y = pending_light_[c];
      y.fill(0);
      for (uint32_t i = 0; i < n; ++i) {
        if (columns[i] < frontier_) continue;
        const float* w = &planeOf(c).wide[size_t{columns[i]} * kFactorStride];
        for (uint32_t j = 0; j < k; ++j) y[j] += w[j] * factors[c][i];
      }
    });
  // Whole columns to each part: memory is read in long runs. Their sums are added in order, whoever made them.
  const uint32_t chunks = (n + kLightColumns - 1) / kLightColumns;
  const auto partial = [&](size_t c, uint32_t chunk) { return partial_.data() + (size_t{chunk} * 3 + c) * rows_; };
  forParts(chunks, [&](Plane& p, uint32_t chunk) {
    const uint32_t first = chunk * kLightColumns, some = std::min(kLightColumns, n - first);
    if (planes_.size() == 1) {
      float* const sums[3] = {partial(0, chunk), partial(1, chunk), partial(2, chunk)};
      const float* const of[3] = {factors[0] + first, factors[1] + first, factors[2] + first};
      for (float* sum : sums) std::fill_n(sum, rows, 0.0f);
      kernels_.addColumns3(p.matrix.data(), stride_, 0, rows, &columns[first], of, some, sums);
    } else {
      float* sum = partial(number(p), chunk);
      std::fill_n(sum, rows, 0.0f);
      kernels_.addColumns(p.matrix.data(), stride_, 0, rows, &columns[first], factors[number(p)] + first, some, sum);
    }
  });
  const uint32_t parts = (rows + kLightRows - 1) / kLightRows;
  pool_.run(3 * parts, [&](uint32_t part) {
    const uint32_t c = part / parts, begin = part % parts * kLightRows, end = std::min(begin + kLightRows, rows);
    std::fill(out[c] + begin, out[c] + end, 0.0f);
    for (uint32_t chunk = 0; chunk < chunks; ++chunk) {
      const float* sum = partial(c, chunk);
      for (uint32_t row = begin; row < end; ++row) out[c][row] += sum[row];
    }
    for (uint32_t row = begin; row < end; row += kPanelRows)
      for (uint32_t j = 0; j < k; ++j) {
        const float* u = &planeOf(c).tall[panelIndex(row, j)];
        for (uint32_t i = 0; i < kPanelRows; ++i) out[c][row + i] += u[i] * pending_light_[c][j];
      }
  });
}

template class BouncePlanes<float>;
template class BouncePlanes<Half>;

}  // namespace ff::runtime
