#include <algorithm>
#include <string>
#include <vector>

#include "runtime/dense/bounce_kernels.h"
#include "runtime/dense/cpu_baseline.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/solver/worker_pool.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kTaskColumns = 256;  // of a part of a task

template <class Element>
class CpuPlainLocal final : public CpuBaseline<Element> {
 public:
  CpuPlainLocal(const MultibounceSettings& settings, int bounces)
      : CpuBaseline<Element>(settings, kPanelRows),
        bounces_(bounces),
        pool_(settings.threads),
        name_("plain local cpu, " + std::to_string(bounces) + " products, " +
              (sizeof(Element) == 2 ? "fp16" : "fp32")) {
    columns_.assign(rows_, 0);
    changed_.assign(rows_, {});
    for (auto& f : factors_) f.assign(rows_, 0);
    for (auto& e : light_) e.assign(rows_, 0);
    partial_.assign(size_t{(rows_ + kTaskColumns - 1) / kTaskColumns} * 3 * rows_, 0);
  }
  const char* name() const override { return name_.c_str(); }

 private:
  using CpuBaseline<Element>::colour_;
  using CpuBaseline<Element>::column;
  using CpuBaseline<Element>::places_;
  using CpuBaseline<Element>::rows_;
  using CpuBaseline<Element>::stride_;

  void enter(const EnteringBlock& block, uint32_t r) override {
    const uint32_t p = block.places[r];
    for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) set(p, block.columns[e], block.row_values[e]);
    for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
      set(block.receivers[e], p, block.column_values[e]);
  }

  void light(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    bounce(source);
    for (uint32_t i = 0; i < irradiance.size(); ++i)
      irradiance[i] = places_.taken(i) ? Vec4{light_[0][i], light_[1][i], light_[2][i], 0} : Vec4{};
  }

  void addLight(std::span<const uint32_t> places, std::span<const Vec4> difference, std::span<Vec4> irradiance) override {
    for (size_t i = 0; i < places.size(); ++i) changed_[places[i]] = difference[i];
    bounce(changed_);
    for (const uint32_t place : places) changed_[place] = {};
    for (uint32_t i = 0; i < irradiance.size(); ++i) {
      if (!places_.taken(i)) continue;
      irradiance[i].x += light_[0][i];
      irradiance[i].y += light_[1][i];
      irradiance[i].z += light_[2][i];
    }
  }

  void set(uint32_t row, uint32_t from, float value) {
    Element& to = column(from)[row];
    if constexpr (sizeof(Element) == sizeof(Half))
      to = toHalf(value * kHalfScale);
    else
      to = value;
  }

  // light_ = F (source + C F (source + C F source ...)), so many products.
  void bounce(std::span<const Vec4> source) {
    const uint32_t rows = (places_.used() + kPanelRows - 1) / kPanelRows * kPanelRows;
    for (int b = 0; b < bounces_; ++b) {
      uint32_t n = 0;
      for (uint32_t j = 0; j < places_.used(); ++j) {
        if (!places_.taken(j)) continue;
        columns_[n] = j;
        factors_[0][n] = source[j].x + (b > 0 ? colour_[j].x * light_[0][j] : 0);
        factors_[1][n] = source[j].y + (b > 0 ? colour_[j].y * light_[1][j] : 0);
        factors_[2][n] = source[j].z + (b > 0 ? colour_[j].z * light_[2][j] : 0);
        ++n;
      }
      const uint32_t chunks = (n + kTaskColumns - 1) / kTaskColumns;
      const auto partial = [&](uint32_t c, uint32_t chunk) {
        return partial_.data() + (size_t{chunk} * 3 + c) * rows_;
      };
      pool_.run(chunks, [&](uint32_t chunk) {
        const uint32_t first = chunk * kTaskColumns;
        const float* const factors[3] = {&factors_[0][first], &factors_[1][first], &factors_[2][first]};
        float* const out[3] = {partial(0, chunk), partial(1, chunk), partial(2, chunk)};
        for (float* e : out) std::fill_n(e, rows, 0.0f);
        kernels_.addColumns3(column(0), stride_, 0, rows, &columns_[first], factors, std::min(kTaskColumns, n - first),
                             out);
      });
      pool_.run(3, [&](uint32_t c) {
        std::fill_n(light_[c].data(), rows, 0.0f);
        for (uint32_t chunk = 0; chunk < chunks; ++chunk)
          for (uint32_t row = 0; row < rows; ++row) light_[c][row] += partial(c, chunk)[row];
      });
    }
  }

  int bounces_;
  WorkerPool pool_;
  BounceKernels<Element> kernels_ = bounceKernels<Element>();
  std::vector<Vec4> changed_;
  std::vector<uint32_t> columns_;
  std::vector<float> factors_[3], light_[3], partial_;
  std::string name_;
};

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeCpuPlainLocal(const MultibounceSettings& settings, int bounces) {
  FF_CHECK_LT(0, bounces);
  const char* remedy = "ask for fewer places, or for fp16";
  return settings.storage == Storage::kFloat16 ? makeCpuBaseline<CpuPlainLocal<Half>>(remedy, settings, bounces)
                                               : makeCpuBaseline<CpuPlainLocal<float>>(remedy, settings, bounces);
}

}  // namespace ff::runtime
