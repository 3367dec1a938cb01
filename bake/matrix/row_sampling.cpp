#include "bake/matrix/row_sampling.h"

#include <algorithm>
#include <utility>

namespace ff::bake {

void sampleRow(const ExchangeRow& row, float area_m2, uint32_t quanta, double offset, SampledRow& out) {
  const double sum = row.total_m2();
  out.total = sum > 0 ? sum / static_cast<double>(area_m2) : 1;  // a row without exchange has nothing to scale
  if (!(sum > 0)) {
    out.column.clear();
    out.count.clear();
    out.sky = 0;
    out.absorbed = quanta;
    return;
  }
  const double scale = quanta / sum;
  double at = 0;
  uint32_t taken = 0;
  const auto step = [&](double area) {
    at += area * scale;
    const uint32_t reached = std::min(quanta, static_cast<uint32_t>(at + offset));
    return reached - std::exchange(taken, reached);
  };
  // Without a branch that no processor foresees: what has no sample is overwritten by the next.
  out.column.resize(row.column.size());
  out.count.resize(row.column.size());
  size_t kept = 0;
  for (size_t k = 0; k < row.column.size(); ++k) {
    const uint32_t n = step(row.area_m2[k]);
    out.column[kept] = row.column[k];
    out.count[kept] = static_cast<uint16_t>(n);
    kept += n > 0;
  }
  out.column.resize(kept);
  out.count.resize(kept);
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
