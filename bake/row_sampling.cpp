#include "bake/row_sampling.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "formats/layout.h"

namespace ff::bake {
namespace {

// Two ascending runs of columns, the first `lamps` long, become one.
void mergeColumns(SampledRow& row, ptrdiff_t lamps) {
  if (lamps == 0 || lamps == static_cast<ptrdiff_t>(row.column.size())) return;
  std::vector<std::pair<uint32_t, uint16_t>> both(row.column.size());
  for (size_t k = 0; k < both.size(); ++k) both[k] = {row.column[k], row.count[k]};
  std::inplace_merge(both.begin(), both.begin() + lamps, both.end());
  for (size_t k = 0; k < both.size(); ++k) std::tie(row.column[k], row.count[k]) = both[k];
}

}  // namespace

uint32_t quantaFor(const ExchangeRow& row, uint32_t quanta, std::span<const uint8_t> shines) {
  constexpr double kClose = 0.01;  // of the lamps' light
  double lamps = 0, sum = row.sky_m2 + row.absorbed_m2;
  for (size_t k = 0; k < row.column.size(); ++k) {
    sum += row.area_m2[k];
    if (shines[row.column[k]]) lamps += row.area_m2[k];
  }
  if (!(lamps > 0)) return quanta;
  uint32_t best = quanta;
  double least = std::numeric_limits<double>::infinity();
  for (uint32_t q = quanta; q <= formats::mostQuanta(quanta) && least > kClose; ++q) {
    const double counts = lamps / sum * q;
    if (const double off = std::abs(counts - std::round(counts)) / counts; off < least) {
      least = off;
      best = q;
    }
  }
  return best;
}

void sampleRow(const ExchangeRow& row, float area_m2, uint32_t quanta, double offset, SampledRow& out,
               std::span<const uint8_t> shines) {
  out.column.clear();
  out.count.clear();
  double sum = row.sky_m2 + row.absorbed_m2;
  for (double x : row.area_m2) sum += x;
  out.total = sum > 0 ? sum / static_cast<double>(area_m2) : 1;  // a row without exchange has nothing to scale
  if (!(sum > 0)) {
    out.sky = 0;
    out.absorbed = quanta;
    return;
  }
  const double scale = quanta / sum;
  double at = 0;
  uint32_t taken = 0;
  const auto step = [&](double area) {
    at += area * scale;
    const uint32_t reached = std::min(quanta, static_cast<uint32_t>(std::floor(at + offset)));
    return reached - std::exchange(taken, reached);
  };
  const auto isLamp = [&](size_t k) { return !shines.empty() && shines[row.column[k]]; };
  for (size_t k = 0; k < row.column.size() && !shines.empty(); ++k)
    if (isLamp(k))
      if (const uint32_t n = step(row.area_m2[k]); n > 0) {
        out.column.push_back(row.column[k]);
        out.count.push_back(static_cast<uint16_t>(n));
      }
  const auto lamps = static_cast<ptrdiff_t>(out.column.size());
  for (size_t k = 0; k < row.column.size(); ++k)
    if (!isLamp(k))
      if (const uint32_t n = step(row.area_m2[k]); n > 0) {
        out.column.push_back(row.column[k]);
        out.count.push_back(static_cast<uint16_t>(n));
      }
  mergeColumns(out, lamps);
  out.sky = step(row.sky_m2);
  out.absorbed = step(row.absorbed_m2);
  // Rounding may leave the last point untaken: it belongs to whatever the row ends with.
  const uint32_t rest = quanta - taken;
  if (row.absorbed_m2 > 0) {
    out.absorbed += rest;
  } else if (row.sky_m2 > 0) {
    out.sky += rest;
  } else if (rest > 0) {
    if (out.column.empty() || out.column.back() != row.column.back()) {
      out.column.push_back(row.column.back());
      out.count.push_back(0);
    }
    out.count.back() = static_cast<uint16_t>(out.count.back() + rest);
  }
}

}  // namespace ff::bake
