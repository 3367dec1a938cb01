#include "runtime/dense/cpu_seed.h"

#include <algorithm>
#include <vector>

#include "runtime/dense/cpu_baseline.h"
#include "runtime/dense/seed_kernels.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kTaskColumns = 64, kTaskRows = 256, kChunk = 256;  // of a part of a task

Half4 toHalf4(const Vec4& v) { return {toHalf(v.x), toHalf(v.y), toHalf(v.z), {}}; }

class CpuSeed final : public CpuBaseline<Half4> {
 public:
  explicit CpuSeed(const MultibounceSettings& settings) : CpuBaseline(settings, 8), pool_(settings.threads) {
    for (auto* v : {&f_col_, &f_row_, &g_col_, &g_row_, &weighted_, &col_, &row_}) v->assign(rows_, {});
    partial_.assign(size_t{(rows_ + kChunk - 1) / kChunk} * rows_, {});
  }
  const char* name() const override { return "seed cpu"; }

 private:
  void light(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    for (uint32_t j = 0; j < places_.used(); ++j) weighted_[j] = places_.taken(j) ? source[j] : Vec4{};
    multiply(weighted_, col_);
    std::copy_n(col_.begin(), places_.used(), irradiance.begin());
    std::fill(irradiance.begin() + places_.used(), irradiance.end(), Vec4{});
  }

  void addLight(std::span<const uint32_t> places, std::span<const Vec4> difference, std::span<Vec4> irradiance) override {
    std::fill_n(col_.begin(), usedRows(), Vec4{});
    pool_.run((usedRows() + kTaskRows - 1) / kTaskRows, [&](uint32_t part) {
      const uint32_t begin = part * kTaskRows, end = std::min(begin + kTaskRows, usedRows());
      for (size_t i = 0; i < places.size(); ++i)
        if (places_.taken(places[i]))
          kernels_.multiply(column(places[i]), stride_, begin, end, 1, &difference[i], col_.data());
    });
    for (uint32_t i = 0; i < places_.used(); ++i) irradiance[i] = irradiance[i] + col_[i];
  }

  uint32_t usedRows() const { return (places_.used() + 7) / 8 * 8; }

  // out = F_local factor.
  void multiply(const std::vector<Vec4>& factor, std::vector<Vec4>& out) {
    const uint32_t rows = usedRows();
    const uint32_t chunks = (places_.used() + kChunk - 1) / kChunk;
    pool_.run(chunks, [&](uint32_t chunk) {  // whole columns: memory is read in long runs
      const uint32_t first = chunk * kChunk;
      Vec4* sum = partial_.data() + size_t{chunk} * rows_;
      std::fill_n(sum, rows, Vec4{});
      kernels_.multiply(column(first), stride_, 0, rows, std::min(kChunk, places_.used() - first),
                        &factor[first], sum);
    });
    pool_.run((rows + kTaskRows - 1) / kTaskRows, [&](uint32_t part) {
      const uint32_t begin = part * kTaskRows, end = std::min(begin + kTaskRows, rows);
      std::fill(out.begin() + begin, out.begin() + end, Vec4{});
      for (uint32_t chunk = 0; chunk < chunks; ++chunk)
        for (uint32_t i = begin; i < end; ++i) out[i] = out[i] + partial_[size_t{chunk} * rows_ + i];
    });
  }

  // Equations (1) to (5), and the six shaders, in their order.
  void enter(const EnteringBlock& block, uint32_t r) override {
    const uint32_t p = block.places[r];
    const uint32_t rows = usedRows();
    std::fill_n(f_col_.begin(), rows, Vec4{});
    std::fill_n(f_row_.begin(), rows, Vec4{});
    const auto grey = [](float f) { return Vec4{f, f, f, 0}; };
    for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e)
      if (places_.taken(block.columns[e]) && block.columns[e] != p) f_row_[block.columns[e]] = grey(block.row_values[e]);
    for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
      f_col_[block.receivers[e]] = grey(block.column_values[e]);
    for (uint32_t i = 0; i < r; ++i)  // the block's own, as far as they are in
      for (uint32_t e = block.row_start[i]; e < block.row_start[i + 1]; ++e)
        if (block.columns[e] == p) f_col_[block.places[i]] = grey(block.row_values[e]);
    const Vec4 rho = block.albedo[r] * grey(1);

    Vec4 twice;  // (1)
    for (uint32_t i = 0; i < rows; ++i) twice = twice + f_row_[i] * colour_[i] * f_col_[i];
    for (uint32_t i = 0; i < rows; ++i) {  // (2)
      g_col_[i] = f_col_[i] * rho * twice;
      g_row_[i] = f_row_[i] * rho * twice;
    }
    for (uint32_t i = 0; i < rows; ++i) weighted_[i] = colour_[i] * (f_col_[i] + g_col_[i]);
    multiply(weighted_, col_);  // (3)
    for (uint32_t i = 0; i < rows; ++i) weighted_[i] = colour_[i] * (f_row_[i] + g_row_[i]);
    pool_.run((places_.used() + kTaskColumns - 1) / kTaskColumns, [&](uint32_t part) {
      kernels_.multiplyLeft(matrix_.data(), stride_, rows, part * kTaskColumns, std::min((part + 1) * kTaskColumns, places_.used()),
                            weighted_.data(), row_.data());
    });
    for (uint32_t i = 0; i < rows; ++i) {  // (4)
      col_[i] = col_[i] + g_col_[i] + f_col_[i];
      row_[i] = row_[i] + g_row_[i] + f_row_[i];
    }
    for (uint32_t i = 0; i < rows; ++i) weighted_[i] = rho * row_[i];
    pool_.run((places_.used() + kTaskColumns - 1) / kTaskColumns, [&](uint32_t part) {  // (5)
      kernels_.addOuter(matrix_.data(), stride_, rows, part * kTaskColumns, std::min((part + 1) * kTaskColumns, places_.used()),
                        col_.data(), weighted_.data());
    });
    for (uint32_t i = 0; i < places_.used(); ++i) {  // (6)
      column(p)[i] = toHalf4(col_[i]);
      column(i)[p] = toHalf4(row_[i]);
    }
    column(p)[p] = toHalf4(twice);
  }

  WorkerPool pool_;
  SeedKernels kernels_ = seedKernels();
  std::vector<Vec4> f_col_, f_row_, g_col_, g_row_, weighted_, col_, row_;
  std::vector<Vec4> partial_;  // per chunk of columns: a sum of all rows
};

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeCpuSeed(const MultibounceSettings& settings) {
  return makeCpuBaseline<CpuSeed>("ask for fewer places", settings);
}

}  // namespace ff::runtime
