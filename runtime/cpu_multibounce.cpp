#include "runtime/cpu_multibounce.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "runtime/bounce_kernels.h"
#include "runtime/page_memory.h"
#include "runtime/small_inverse.h"
#include "runtime/worker_pool.h"

namespace ff::runtime {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t kB = kMaxBlock, kP = kPanelRows;
// Rows of the matrix that a part of a task takes: gathers keep a tile's columns in the second-level cache; in the pass
// the tall factor's rows (256 KiB) stay there while columns stream by.
constexpr uint32_t kGatherRows = 128, kLightRows = 512, kLightColumns = 256, kPassRows = 1024, kPassColumns = 192;
constexpr uint16_t kNotEntering = 0xffff;

uint32_t roundUp(uint32_t value, uint32_t multiple) { return (value + multiple - 1) / multiple * multiple; }
float channelOf(const Vec4& v, uint32_t c) { return c == 0 ? v.x : c == 1 ? v.y : v.z; }
double msSince(Clock::time_point t) { return std::chrono::duration<double, std::milli>(Clock::now() - t).count(); }
Error refusal(std::string message) {
  return Error{ErrorCode::kInvalidFile, "", "", std::move(message), "store fp32, or use the gather solver"};
}

// The matrix of one colour channel, and what an update of it needs.
template <class Element>
struct Plane {
  PageMemory<Element> matrix;
  std::vector<float> albedo;  // per place, 0 where free
  std::vector<float> tall;    // panels of 16 rows, k columns
  std::vector<float> wide;    // k values a column, kMaxBlock apart
  std::vector<float> rows;    // V, or rows of the matrix, as `wide`
  std::vector<float> small;   // a k x k matrix as panels
  std::vector<float> corner;  // k x k, column by column
  SmallMatrix s, k, work;
  bool solved = false;
};

template <class Element>
class CpuMultibounce final : public BounceMatrix {
 public:
  explicit CpuMultibounce(const MultibounceSettings& settings)
      : settings_(settings),
        pool_(settings.threads),
        places_(settings.places),
        rows_(roundUp(settings.places, kP)),
        stride_(rows_ + kP),  // no power of two: columns would share the same few sets of the caches
        planes_(settings.luminance ? 1 : 3),
        scratch_(static_cast<size_t>(pool_.threads())),
        scratch_taken_(static_cast<size_t>(pool_.threads())) {
    for (Plane<Element>& p : planes_) {
      p.matrix = PageMemory<Element>(stride_ * rows_);
      p.albedo.assign(rows_, 0);
      p.tall.assign(size_t{rows_} * kB, 0);
      p.wide.assign(size_t{rows_} * kB, 0);
      p.rows.assign(size_t{rows_} * kB, 0);
      p.small.assign(size_t{kB} * kB, 0);
      p.corner.assign(size_t{kB} * kB, 0);
    }
    for (auto& s : scratch_) s.assign(size_t{rows_} * kP, 0);
    present_.assign(rows_, 0);
    order_.assign(rows_, kNotEntering);
    colour_.assign(rows_, {});
    row_sum_.assign(rows_, 0);
    row_sum_before_.assign(rows_, 0);
    columns_.assign(rows_, 0);
    changed_at_.assign(rows_, 0);
    blocks_.assign(rows_ / 8, 0);
    block_used_.assign(rows_ / 8, 0);
    for (auto& f : factors_) f.assign(rows_, 0);
    for (auto& e : light_) e.assign(rows_, 0);
    partial_.assign(size_t{(rows_ + kLightColumns - 1) / kLightColumns} * 3 * rows_, 0);
    name_ = std::string("multibounce cpu ") + (sizeof(Element) == 2 ? "fp16" : "fp32") +
            (settings.luminance ? " luminance" : "");
  }

  bool allocated() const {
    return std::all_of(planes_.begin(), planes_.end(), [](const auto& p) { return static_cast<bool>(p.matrix); });
  }

  uint32_t capacity() const override { return places_; }
  uint64_t bytes() const override { return uint64_t{stride_} * rows_ * sizeof(Element) * planes_.size(); }
  const char* name() const override { return name_.c_str(); }
  BounceStats stats() const override {
    BounceStats stats = stats_;
    stats.pending_columns = pending_k_ > 0 ? used_ - frontier_ : 0;
    return stats;
  }

  Result<void> insert(const EnteringBlock& block) override {
    const auto start = Clock::now();
    const auto k = static_cast<uint32_t>(block.places.size());
    FF_CHECK_LT(0u, k);
    FF_CHECK_LE(k, kB);
    if (!hasValidFormFactors(block)) return refusal("a form factor is not a finite number >= 0");
    pass(used_);
    row_sum_before_ = row_sum_;
    const uint32_t used_before = used_;
    seat(block);
    const auto clamped = clamp(block);
    if (!clamped) {
      unseat(block, used_before);
      return clamped.error();
    }
    gather(block);
    solveCorners(block);
    for (const Plane<Element>& p : planes_) {
      if (trusted(p, k)) continue;
      unseat(block, used_before);
      return refusal(std::string("light would be multiplied more than ") + (sizeof(Element) == 2 ? "fp16" : "fp32") +
                     " storage can carry: I - S C is singular to its precision");
    }
    writeColumns(block);
    makeWide(k);
    for (const uint32_t place : block.places) {
      present_[place] = 1;
      order_[place] = kNotEntering;
    }
    startPass(k, {});
    stats_.entered += k;
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> remove(std::span<const uint32_t> places) override {
    const auto start = Clock::now();
    for (size_t first = 0; first < places.size(); first += kB) {
      const auto some = places.subspan(first, std::min<size_t>(kB, places.size() - first));
      pass(used_);
      for (Plane<Element>& p : planes_)
        for (uint32_t i = 0; i < some.size(); ++i) {
          FF_CHECK_EQ(int{present_[some[i]]}, 1);
          delta_[planeIndex(p)][i] = -static_cast<double>(p.albedo[some[i]]);
        }
      if (!changeAlbedo(some)) return refusal("the matrix has lost its precision: I + G C is singular; rebuild it");
      for (const uint32_t place : some) {
        present_[place] = 0;
        row_sum_[place] = 0;
        colour_[place] = {};
        for (Plane<Element>& p : planes_) {
          p.albedo[place] = 0;
          std::memset(static_cast<void*>(p.matrix.data() + place * stride_), 0, stride_ * sizeof(Element));
          std::memset(p.wide.data() + size_t{place} * kB, 0, kB * sizeof(float));
        }
      }
      startPass(static_cast<uint32_t>(some.size()), some);
      stats_.left += some.size();
    }
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> clear() override {
    for (Plane<Element>& p : planes_) {
      std::memset(static_cast<void*>(p.matrix.data()), 0, size_t{stride_} * used_ * sizeof(Element));
      std::fill(p.albedo.begin(), p.albedo.end(), 0.0f);
    }
    std::fill(present_.begin(), present_.end(), uint8_t{0});
    std::fill(colour_.begin(), colour_.end(), Vec4{});
    std::fill(row_sum_.begin(), row_sum_.end(), 0.0f);
    used_ = frontier_ = pending_k_ = 0;
    return {};
  }

  Result<uint32_t> advance(uint32_t columns) override {
    const auto start = Clock::now();
    if (pending_k_ > 0) {
      pass(std::min(columns, used_ - frontier_));
      stats_.last_update_ms = msSince(start);
    }
    return pending_k_ > 0 ? used_ - frontier_ : 0;
  }

  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    FF_CHECK_EQ(source.size(), size_t{places_});
    FF_CHECK_EQ(irradiance.size(), size_t{places_});
    light([&](uint32_t j) { return source[j]; }, used_, [](uint32_t i) { return i; });
    if (settings_.luminance)
      for (int i = 1; i < kLuminanceProducts; ++i) reflectColours([&](uint32_t j) { return source[j]; });
    for (uint32_t i = 0; i < places_; ++i)
      irradiance[i] = present_[i] ? Vec4{light_[0][i], light_[1][i], light_[2][i], 0} : Vec4{};
    stats_.last_relight_ms = msSince(start);
    return {};
  }

  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    FF_CHECK_EQ(places.size(), difference.size());
    FF_CHECK_LE(places.size(), size_t{places_});
    FF_CHECK_EQ(irradiance.size(), size_t{places_});
    light([&](uint32_t i) { return difference[i]; }, static_cast<uint32_t>(places.size()),
          [&](uint32_t i) { return places[i]; });
    if (settings_.luminance) {
      for (uint32_t i = 0; i < places.size(); ++i) changed_at_[places[i]] = i + 1;
      const auto at = [&](uint32_t j) { return changed_at_[j] ? difference[changed_at_[j] - 1] : Vec4{}; };
      for (int i = 1; i < kLuminanceProducts; ++i) reflectColours(at);
      for (const uint32_t place : places) changed_at_[place] = 0;
    }
    for (uint32_t i = 0; i < places_; ++i) {
      if (!present_[i]) continue;
      irradiance[i].x += light_[0][i];
      irradiance[i].y += light_[1][i];
      irradiance[i].z += light_[2][i];
    }
    stats_.last_relight_ms = msSince(start);
    return {};
  }

 private:
  size_t planeIndex(const Plane<Element>& p) const { return static_cast<size_t>(&p - planes_.data()); }
  uint32_t usedRows() const { return roundUp(used_, kP); }
  float planeAlbedo(const Vec4& colour, size_t plane) const {
    return settings_.luminance ? (colour.x + colour.y + colour.z) / 3 : channelOf(colour, static_cast<uint32_t>(plane));
  }

  // Calls task(plane, part) for the parts of each plane.
  template <class Task>
  void forParts(uint32_t parts, Task&& task) {
    pool_.run(parts * static_cast<uint32_t>(planes_.size()),
              [&](uint32_t part) { task(planes_[part / parts], part % parts); });
  }

  void setAlbedo(uint32_t place, const Vec4& colour) {
    colour_[place] = colour;
    for (size_t c = 0; c < planes_.size(); ++c) planes_[c].albedo[place] = planeAlbedo(colour, c);
  }

  void seat(const EnteringBlock& block) {
    const auto k = static_cast<uint32_t>(block.places.size());
    for (uint32_t r = 0; r < k; ++r) {
      const uint32_t place = block.places[r];
      FF_CHECK_LT(place, places_);
      FF_CHECK_EQ(int{present_[place]}, 0);
      FF_CHECK_EQ(order_[place], kNotEntering);
      order_[place] = static_cast<uint16_t>(r);
      used_ = std::max(used_, place + 1);
      float sum = 0;
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) sum += block.row_values[e];
      row_sum_[place] = sum;
    }
    for (size_t e = 0; e < block.receivers.size(); ++e) row_sum_[block.receivers[e]] += block.column_values[e];
  }

  void unseat(const EnteringBlock& block, uint32_t used_before) {
    row_sum_ = row_sum_before_;
    for (const uint32_t place : block.places) {
      order_[place] = kNotEntering;
      setAlbedo(place, {});
    }
    used_ = used_before;
  }

  // Lowers albedos that would keep all light. A row holds at most a whole hemisphere, so a sum that grew past 1 over
  // the comings and goings of its columns counts as 1; only albedos above kMostKept are ever touched.
  bool lower(Vec4& colour, float row_sum) const {
    const float whole = std::min(row_sum, 1.0f), most = whole > 0 ? kMostKept / whole : 2.0f;
    const Vec4 before = colour;
    colour = {std::min(colour.x, most), std::min(colour.y, most), std::min(colour.z, most), 0};
    return colour.x < before.x || colour.y < before.y || colour.z < before.z;
  }

  Result<void> clamp(const EnteringBlock& block) {
    for (uint32_t r = 0; r < block.places.size(); ++r) {
      Vec4 colour = block.albedo[r];
      if (!(std::isfinite(colour.x + colour.y + colour.z) && std::min({colour.x, colour.y, colour.z}) >= 0))
        return refusal("an albedo is not a finite number >= 0");
      if (lower(colour, row_sum_[block.places[r]])) ++stats_.clamped;
      setAlbedo(block.places[r], colour);
    }
    uint32_t lowered = 0;
    for (size_t e = 0; e < block.receivers.size(); ++e) {
      const uint32_t place = block.receivers[e];
      Vec4 colour = colour_[place];
      if (lower(colour, row_sum_[place])) {
        ++stats_.clamped;
        for (size_t c = 0; c < planes_.size(); ++c)
          delta_[c][lowered] =
              static_cast<double>(planeAlbedo(colour, c)) - static_cast<double>(planes_[c].albedo[place]);
        lowered_places_[lowered++] = place;
        setAlbedo(place, colour);
      }
      if (lowered == kB || (lowered > 0 && e + 1 == block.receivers.size())) {
        if (!changeAlbedo({lowered_places_.data(), lowered})) return refusal("the matrix has lost its precision");
        startPass(lowered, {});
        pass(used_);
        lowered = 0;
      }
    }
    return {};
  }

  // U in `tall`, V in `rows`.
  void gather(const EnteringBlock& block) {
    const auto k = static_cast<uint32_t>(block.places.size());
    const uint32_t rows = usedRows();
    forParts((rows + kGatherRows - 1) / kGatherRows, [&](Plane<Element>& p, uint32_t part) {
      const uint32_t begin = part * kGatherRows, end = std::min(begin + kGatherRows, rows);
      kernels_.gatherColumns(
          p.matrix.data(), stride_, begin, end,
          {k, block.column_start.data(), block.receivers.data(), block.column_values.data(), p.albedo.data()},
          p.tall.data());
    });
    std::fill_n(block_used_.begin(), rows / 8, uint8_t{0});
    for (const uint32_t place : block.columns) block_used_[place / 8] = 1;
    uint32_t blocks = 0;
    for (uint32_t b = 0; b < rows / 8; ++b)
      if (block_used_[b]) blocks_[blocks++] = b;
    forParts(rows / kP, [&](Plane<Element>& p, uint32_t part) {
      uint32_t own = 0;  // there is a scratch per thread, so one is free
      while (scratch_taken_[own].test_and_set(std::memory_order_acquire))
        own = (own + 1) % static_cast<uint32_t>(scratch_.size());
      kernels_.gatherRows(p.matrix.data(), stride_, part * kP, blocks_.data(), blocks,
                          {k, block.row_start.data(), block.columns.data(), block.row_values.data(), p.albedo.data()},
                          scratch_[own].data(), p.rows.data());
      scratch_taken_[own].clear(std::memory_order_release);
    });
    for (Plane<Element>& p : planes_)
      for (uint32_t r = 0; r < k; ++r) {
        for (uint32_t e = block.column_start[r]; e < block.column_start[r + 1]; ++e)
          p.tall[panelIndex(block.receivers[e], r, k)] += block.column_values[e];
        for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e)
          if (order_[block.columns[e]] == kNotEntering)
            p.rows[size_t{block.columns[e]} * kB + r] += block.row_values[e];
      }
  }

  static size_t panelIndex(uint32_t row, uint32_t p, uint32_t k) { return (size_t{row / kP} * k + p) * kP + row % kP; }

  // S in `s`, K in `k`, K S in `work`; what S has from the matrix, as the most of a row, in carried_.
  void solveCorners(const EnteringBlock& block) {
    const auto k = static_cast<uint32_t>(block.places.size());
    forParts(k, [&](Plane<Element>& plane, uint32_t r) {
      double carried = 0;
      double* s = &plane.s(r, 0);
      std::fill_n(s, k, 0.0);
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) {
        const uint32_t place = block.columns[e];
        if (order_[place] != kNotEntering) continue;
        const double factor = static_cast<double>(block.row_values[e]) * static_cast<double>(plane.albedo[place]);
        const float* u = plane.tall.data() + panelIndex(place, 0, k);
        for (uint32_t p = 0; p < k; ++p) s[p] += factor * static_cast<double>(u[size_t{p} * kP]);
      }
      for (uint32_t p = 0; p < k; ++p) carried += s[p] * static_cast<double>(plane.albedo[block.places[p]]);
      carried_[planeIndex(plane)][r] = carried;
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) {
        const uint16_t p = order_[block.columns[e]];
        if (p != kNotEntering) s[p] += static_cast<double>(block.row_values[e]);
      }
    });
    forParts(1, [&](Plane<Element>& p, uint32_t) {
      for (uint32_t i = 0; i < k; ++i)
        for (uint32_t j = 0; j < k; ++j)
          p.work(i, j) = (i == j ? 1 : 0) - p.s(i, j) * static_cast<double>(p.albedo[block.places[j]]);
      p.solved = invert(p.work, k, p.k);
      if (p.solved) multiply(p.k, p.s, k, p.work);
    });
  }

  // K = I + S C + (S C)^2 + ...: nothing in it is negative, and it multiplies the rounding errors of S (stored fp16 is
  // off by up to 2^-12 of a value). That is what one block can be judged by; what a walk gathers, the caller's residual
  // shows.
  bool trusted(const Plane<Element>& p, uint32_t k) const {
    if (!p.solved) return false;
    const double norm = rowNorm(p.k, k);
    if (!std::isfinite(norm)) return false;
    for (uint32_t i = 0; i < k; ++i)
      for (uint32_t j = 0; j < k; ++j)
        if (p.k(i, j) < -1e-3 * norm) return false;
    const auto& carried = carried_[planeIndex(p)];
    const double most = *std::max_element(carried.begin(), carried.begin() + k);
    const double error = most * (sizeof(Element) == 2 ? 0x1p-12 : 0x1p-21) + 0x1p-22;
    return error * norm < 0.1;
  }

  // G_LP and G_PP into the matrix; then U C_P with ones at P in `tall`, so that the product with `wide` writes G_PL
  // too.
  void writeColumns(const EnteringBlock& block) {
    const std::span<const uint32_t> places = block.places;
    const auto k = static_cast<uint32_t>(places.size());
    for (Plane<Element>& p : planes_)
      for (uint32_t j = 0; j < k; ++j)
        for (uint32_t i = 0; i < k; ++i)
          p.corner[size_t{j} * kB + i] =
              static_cast<float>((i == j ? 1 : 0) + static_cast<double>(p.albedo[places[i]]) * p.work(i, j));
    const uint32_t rows = usedRows();
    forParts((rows + kGatherRows - 1) / kGatherRows, [&](Plane<Element>& p, uint32_t part) {
      const uint32_t begin = part * kGatherRows, end = std::min(begin + kGatherRows, rows);
      for (uint32_t j = 0, run; j < k; j += run) {
        for (run = 1; j + run < k && places[j + run] == places[j] + run;) ++run;
        kernels_.addProduct(p.tall.data(), k, p.corner.data() + size_t{j} * kB, p.matrix.data() + places[j] * stride_,
                            stride_, begin, end, run);
      }
      for (uint32_t row = begin; row < end; row += kP)
        for (uint32_t j = 0; j < k; ++j) {
          float* u = p.tall.data() + panelIndex(row, j, k);
          for (uint32_t i = 0; i < kP; ++i) u[i] *= p.albedo[places[j]];
        }
    });
    for (Plane<Element>& p : planes_)
      for (uint32_t j = 0; j < k; ++j) {
        p.tall[panelIndex(places[j], j, k)] = 1;
        for (uint32_t i = 0; i < k; ++i)
          setStored(p.matrix.data()[places[j] * stride_ + places[i]], static_cast<float>(p.work(i, j)));
      }
  }

  static void setStored(float& to, float value) { to = value; }
  static void setStored(Half& to, float value) { to = toHalf(value * kHalfScale); }
  static float stored(float from) { return from; }
  static float stored(Half from) { return toFloat(from) / kHalfScale; }

  // wide = K rows.
  void makeWide(uint32_t k) {
    const uint32_t padded = roundUp(k, kP), columns = usedRows();
    for (Plane<Element>& p : planes_)
      for (uint32_t j = 0; j < k; ++j)
        for (uint32_t i = 0; i < padded; ++i)
          p.small[panelIndex(i, j, k)] = i < k ? static_cast<float>(p.k(i, j)) : 0.0f;
    forParts((columns + kPassColumns - 1) / kPassColumns, [&](Plane<Element>& p, uint32_t part) {
      const uint32_t begin = part * kPassColumns, end = std::min(begin + kPassColumns, columns);
      float* wide = p.wide.data() + size_t{begin} * kB;
      std::fill_n(wide, size_t{end - begin} * kB, 0.0f);
      small_product_(p.small.data(), k, p.rows.data() + size_t{begin} * kB, wide, kB, 0, padded, end - begin);
    });
  }

  // The factors by which the matrix changes when the albedos of Q change by delta_. False where it cannot be.
  bool changeAlbedo(std::span<const uint32_t> q) {
    const auto k = static_cast<uint32_t>(q.size());
    const uint32_t rows = usedRows();
    forParts((rows + kGatherRows - 1) / kGatherRows, [&](Plane<Element>& p, uint32_t part) {
      const uint32_t begin = part * kGatherRows, end = std::min(begin + kGatherRows, rows);
      for (uint32_t j = 0; j < k; ++j) {
        const Element* column = p.matrix.data() + q[j] * stride_;
        for (uint32_t row = begin; row < end; ++row) p.tall[panelIndex(row, j, k)] = stored(column[row]);
      }
      for (uint32_t column = begin; column < end; ++column) {
        const Element* from = p.matrix.data() + column * stride_;
        for (uint32_t j = 0; j < k; ++j) p.rows[size_t{column} * kB + j] = stored(from[q[j]]);
      }
    });
    bool solved = true;
    for (Plane<Element>& p : planes_) {
      const auto& delta = delta_[planeIndex(p)];
      for (uint32_t i = 0; i < k; ++i)
        for (uint32_t j = 0; j < k; ++j)
          p.work(i, j) =
              (i == j ? 1 : 0) - static_cast<double>(stored(p.matrix.data()[q[j] * stride_ + q[i]])) * delta[j];
      solved = solved && invert(p.work, k, p.k);
      for (uint32_t i = 0; i < k; ++i)
        for (uint32_t j = 0; j < k; ++j) p.k(i, j) *= delta[i];
      solved = solved && std::isfinite(rowNorm(p.k, k));
    }
    if (solved) makeWide(k);
    return solved;
  }

  void startPass(uint32_t k, std::span<const uint32_t> zero_rows) {
    pending_k_ = k;
    frontier_ = 0;
    zero_count_ = static_cast<uint32_t>(zero_rows.size());
    std::copy(zero_rows.begin(), zero_rows.end(), zero_rows_.begin());
    if (!settings_.time_slice) pass(used_);
  }

  // matrix += tall wide for so many more columns, and the rows of those that left to zero.
  void pass(uint32_t columns) {
    if (pending_k_ == 0) return;
    const uint32_t rows = usedRows(), begin = frontier_, end = std::min(used_, frontier_ + columns);
    const uint32_t row_parts = (rows + kPassRows - 1) / kPassRows;
    const uint32_t column_parts = (end - begin + kPassColumns - 1) / kPassColumns;
    forParts(row_parts * column_parts, [&](Plane<Element>& p, uint32_t part) {
      const uint32_t first = begin + part % column_parts * kPassColumns, last = std::min(first + kPassColumns, end);
      const uint32_t top = part / column_parts * kPassRows, bottom = std::min(top + kPassRows, rows);
      kernels_.addProduct(p.tall.data(), pending_k_, p.wide.data() + size_t{first} * kB,
                          p.matrix.data() + first * stride_, stride_, top, bottom, last - first);
      for (uint32_t z = 0; z < zero_count_; ++z)
        if (zero_rows_[z] >= top && zero_rows_[z] < bottom)
          for (uint32_t column = first; column < last; ++column)
            p.matrix.data()[column * stride_ + zero_rows_[z]] = Element{};
    });
    frontier_ = end;
    if (frontier_ < used_) return;
    pending_k_ = 0;
    if (zero_count_ > 0)
      while (used_ > 0 && !present_[used_ - 1]) --used_;
  }

  // light_ = G value, over the places named.
  template <class Value, class Place>
  void light(Value&& value, uint32_t count, Place&& place) {
    uint32_t n = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const Vec4 v = value(i);
      const uint32_t at = place(i);
      if (!present_[at] || (v.x == 0 && v.y == 0 && v.z == 0)) continue;
      columns_[n] = at;
      for (uint32_t c = 0; c < 3; ++c) factors_[c][n] = channelOf(v, c);
      ++n;
    }
    const uint32_t rows = usedRows(), parts = (rows + kLightRows - 1) / kLightRows, k = pending_k_;
    if (k > 0)
      pool_.run(3, [&](uint32_t c) {
        const Plane<Element>& p = planes_[c % planes_.size()];
        auto& y = pending_light_[c];
        y.fill(0);
        for (uint32_t i = 0; i < n; ++i) {
          if (columns_[i] < frontier_) continue;
          const float* w = p.wide.data() + size_t{columns_[i]} * kB;
          for (uint32_t j = 0; j < k; ++j) y[j] += w[j] * factors_[c][i];
        }
      });
    // Whole columns to each part: memory is read in long runs. Their sums are added in order, whoever made them.
    const uint32_t chunks = (n + kLightColumns - 1) / kLightColumns;
    forParts(chunks, [&](Plane<Element>& p, uint32_t chunk) {
      const uint32_t first = chunk * kLightColumns, some = std::min(kLightColumns, n - first);
      const auto plane = static_cast<uint32_t>(planeIndex(p));
      if (settings_.luminance) {
        float* const out[3] = {partial(0, chunk), partial(1, chunk), partial(2, chunk)};
        const float* const factors[3] = {&factors_[0][first], &factors_[1][first], &factors_[2][first]};
        for (float* e : out) std::fill_n(e, rows, 0.0f);
        kernels_.addColumns3(p.matrix.data(), stride_, 0, rows, &columns_[first], factors, some, out);
      } else {
        float* out = partial(plane, chunk);
        std::fill_n(out, rows, 0.0f);
        kernels_.addColumns(p.matrix.data(), stride_, 0, rows, &columns_[first], &factors_[plane][first], some, out);
      }
    });
    pool_.run(3 * parts, [&](uint32_t part) {
      const uint32_t c = part / parts, begin = part % parts * kLightRows, end = std::min(begin + kLightRows, rows);
      float* out = light_[c].data();
      std::fill(out + begin, out + end, 0.0f);
      for (uint32_t chunk = 0; chunk < chunks; ++chunk) {
        const float* sum = partial(c, chunk);
        for (uint32_t row = begin; row < end; ++row) out[row] += sum[row];
      }
      for (uint32_t row = begin; row < end; row += kP)
        for (uint32_t j = 0; j < k; ++j) {
          const float* u = planes_[c % planes_.size()].tall.data() + panelIndex(row, j, k);
          for (uint32_t i = 0; i < kP; ++i) out[row + i] += u[i] * pending_light_[c][j];
        }
    });
  }

  float* partial(uint32_t channel, uint32_t chunk) { return partial_.data() + (size_t{chunk} * 3 + channel) * rows_; }

  // light_ = G (value + (C_c - C) light_): brings the channels' own albedos in (cpu_multibounce.h).
  template <class Value>
  void reflectColours(Value&& value) {
    light(
        [&](uint32_t j) {
          const Vec4 v = value(j);
          const float mean = planes_[0].albedo[j];
          return Vec4{v.x + (colour_[j].x - mean) * light_[0][j], v.y + (colour_[j].y - mean) * light_[1][j],
                      v.z + (colour_[j].z - mean) * light_[2][j], 0};
        },
        used_, [](uint32_t j) { return j; });
  }

  MultibounceSettings settings_;
  WorkerPool pool_;
  BounceKernels<Element> kernels_ = bounceKernels<Element>();
  decltype(BounceKernels<float>::addProduct) small_product_ = bounceKernels<float>().addProduct;
  uint32_t places_, rows_;
  size_t stride_;
  std::vector<Plane<Element>> planes_;
  std::vector<std::vector<float>> scratch_;
  std::vector<std::atomic_flag> scratch_taken_;
  std::vector<uint8_t> present_, block_used_;
  std::vector<uint16_t> order_;  // place to number in the entering block
  std::vector<Vec4> colour_;     // per place, after clamping; 0 where free
  std::vector<float> row_sum_, row_sum_before_;
  std::vector<uint32_t> columns_, blocks_, changed_at_;
  std::vector<float> factors_[3], light_[3];
  std::vector<float> partial_;  // per chunk of columns: three sums of all rows
  std::array<double, kB> delta_[3], carried_[3];
  std::array<float, kB> pending_light_[3];
  std::array<uint32_t, kB> lowered_places_, zero_rows_;
  uint32_t zero_count_ = 0;
  uint32_t used_ = 0;       // one past the highest place in use
  uint32_t pending_k_ = 0;  // columns of `tall` that still go into the matrix; 0: none
  uint32_t frontier_ = 0;   // columns before it are up to date
  BounceStats stats_;
  std::string name_;
};

template <class Element>
Result<std::unique_ptr<BounceMatrix>> make(const MultibounceSettings& settings) {
  auto matrix = std::make_unique<CpuMultibounce<Element>>(settings);
  if (!matrix->allocated())
    return Error{ErrorCode::kUsage, "", "",
                 "not enough memory for a matrix of " + std::to_string(settings.places) + " places",
                 "ask for fewer places, or for fp16 or luminance"};
  return std::unique_ptr<BounceMatrix>(std::move(matrix));
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeCpuMultibounce(const MultibounceSettings& settings) {
  if (settings.places == 0 || settings.places > kMaxSlots)
    return Error{ErrorCode::kUsage, "", "", "a dense matrix has 1 to " + std::to_string(kMaxSlots) + " places", ""};
  return settings.storage == Storage::kFloat16 ? make<Half>(settings) : make<float>(settings);
}

}  // namespace ff::runtime
