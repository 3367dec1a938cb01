#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "runtime/dense/bounce_kernels.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/page_memory.h"
#include "runtime/dense/places.h"
#include "runtime/worker_pool.h"

namespace ff::runtime {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t kColumns = 256;  // of a part of a task

double msSince(Clock::time_point t) { return std::chrono::duration<double, std::milli>(Clock::now() - t).count(); }

template <class Element>
class CpuPlainLocal final : public BounceMatrix {
 public:
  CpuPlainLocal(const MultibounceSettings& settings, int bounces)
      : places_(settings.places),
        rows_((settings.places + kPanelRows - 1) / kPanelRows * kPanelRows),
        stride_(rows_ + kPanelRows),
        bounces_(bounces),
        pool_(settings.threads),
        matrix_(stride_ * rows_),
        name_("plain local cpu, " + std::to_string(bounces) + " products, " +
              (sizeof(Element) == 2 ? "fp16" : "fp32")) {
    colour_.assign(rows_, {});
    columns_.assign(rows_, 0);
    changed_.assign(rows_, {});
    for (auto& f : factors_) f.assign(rows_, 0);
    for (auto& e : light_) e.assign(rows_, 0);
    partial_.assign(size_t{(rows_ + kColumns - 1) / kColumns} * 3 * rows_, 0);
  }

  bool allocated() const { return static_cast<bool>(matrix_); }
  uint32_t capacity() const override { return places_.capacity(); }
  uint64_t bytes() const override { return uint64_t{stride_} * rows_ * sizeof(Element); }
  BounceStats stats() const override { return stats_; }
  const char* name() const override { return name_.c_str(); }

  Result<void> insert(const EnteringBlock& block) override {
    const auto start = Clock::now();
    if (!hasValidFormFactors(block))
      return Error{ErrorCode::kInvalidFile, "", "", "a form factor is not a finite number >= 0", ""};
    for (uint32_t r = 0; r < block.places.size(); ++r) {
      const uint32_t p = block.places[r];
      places_.take(p);
      colour_[p] = block.albedo[r];
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e)
        set(p, block.columns[e], block.row_values[e]);
      for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
        set(block.receivers[e], p, block.column_values[e]);
    }
    stats_.entered += block.places.size();
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> remove(std::span<const uint32_t> places) override {
    const auto start = Clock::now();
    for (const uint32_t p : places) {
      zeroPlace(matrix_.data(), stride_, places_.used(), p);
      colour_[p] = {};
      places_.give(p);
    }
    stats_.left += places.size();
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> clear() override {
    std::memset(static_cast<void*>(matrix_.data()), 0, size_t{stride_} * places_.used() * sizeof(Element));
    std::fill(colour_.begin(), colour_.end(), Vec4{});
    places_.clear();
    return {};
  }

  Result<uint32_t> advance(uint32_t) override { return 0u; }

  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkLight(source, irradiance);
    bounce(source);
    for (uint32_t i = 0; i < irradiance.size(); ++i)
      irradiance[i] = places_.taken(i) ? Vec4{light_[0][i], light_[1][i], light_[2][i], 0} : Vec4{};
    stats_.last_relight_ms = msSince(start);
    return {};
  }

  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkChange(places, difference, irradiance);
    for (size_t i = 0; i < places.size(); ++i) changed_[places[i]] = difference[i];
    bounce(changed_);
    for (const uint32_t place : places) changed_[place] = {};
    for (uint32_t i = 0; i < irradiance.size(); ++i) {
      if (!places_.taken(i)) continue;
      irradiance[i].x += light_[0][i];
      irradiance[i].y += light_[1][i];
      irradiance[i].z += light_[2][i];
    }
    stats_.last_relight_ms = msSince(start);
    return {};
  }

 private:
  void set(uint32_t row, uint32_t column, float value) {
    Element& to = matrix_.data()[column * stride_ + row];
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
      const uint32_t chunks = (n + kColumns - 1) / kColumns;
      const auto partial = [&](uint32_t c, uint32_t chunk) {
        return partial_.data() + (size_t{chunk} * 3 + c) * rows_;
      };
      pool_.run(chunks, [&](uint32_t chunk) {
        const uint32_t first = chunk * kColumns;
        const float* const factors[3] = {&factors_[0][first], &factors_[1][first], &factors_[2][first]};
        float* const out[3] = {partial(0, chunk), partial(1, chunk), partial(2, chunk)};
        for (float* e : out) std::fill_n(e, rows, 0.0f);
        kernels_.addColumns3(matrix_.data(), stride_, 0, rows, &columns_[first], factors, std::min(kColumns, n - first),
                             out);
      });
      pool_.run(3, [&](uint32_t c) {
        std::fill_n(light_[c].data(), rows, 0.0f);
        for (uint32_t chunk = 0; chunk < chunks; ++chunk)
          for (uint32_t row = 0; row < rows; ++row) light_[c][row] += partial(c, chunk)[row];
      });
    }
  }

  Places places_;
  uint32_t rows_;
  size_t stride_;
  int bounces_;
  WorkerPool pool_;
  BounceKernels<Element> kernels_ = bounceKernels<Element>();
  PageMemory<Element> matrix_;
  std::vector<Vec4> colour_, changed_;
  std::vector<uint32_t> columns_;
  std::vector<float> factors_[3], light_[3], partial_;
  BounceStats stats_;
  std::string name_;
};

template <class Element>
Result<std::unique_ptr<BounceMatrix>> make(const MultibounceSettings& settings, int bounces) {
  auto matrix = std::make_unique<CpuPlainLocal<Element>>(settings, bounces);
  if (!matrix->allocated()) return tooLittleMemory(settings.places, "ask for fewer places, or for fp16");
  return std::unique_ptr<BounceMatrix>(std::move(matrix));
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeCpuPlainLocal(const MultibounceSettings& settings, int bounces) {
  FF_CHECK_LT(0, bounces);
  if (auto sound = checkPlaces(settings.places); !sound) return sound.error();
  return settings.storage == Storage::kFloat16 ? make<Half>(settings, bounces) : make<float>(settings, bounces);
}

}  // namespace ff::runtime
