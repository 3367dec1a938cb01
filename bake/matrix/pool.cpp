#include "bake/matrix/pool.h"

#include <numeric>
#include <utility>

namespace ff::bake {

double ExchangeRow::total_m2() const { return std::accumulate(area_m2.begin(), area_m2.end(), sky_m2 + absorbed_m2); }

PooledPatches::PooledPatches(HitRows rows, std::vector<float> areas_m2)
    : rows_(std::move(rows)), areas_(std::move(areas_m2)) {
  const size_t n = areas_.size();
  exposed_.resize(n);
  for (size_t i = 0; i < n; ++i) exposed_[i] = exposedFraction(rows_, i);
  column_start_.assign(n + 1, 0);
  for (uint32_t j : rows_.column) ++column_start_[j + 1];
  for (size_t j = 0; j < n; ++j) column_start_[j + 1] += column_start_[j];
  source_.resize(rows_.column.size());
  count_.resize(rows_.column.size());
  std::vector<uint64_t> at(column_start_.begin(), column_start_.end() - 1);
  for (uint32_t i = 0; i < n; ++i)
    for (uint64_t k = rows_.start[i]; k < rows_.start[i + 1]; ++k) {
      const uint64_t to = at[rows_.column[k]]++;
      source_[to] = i;
      count_[to] = rows_.count[k];
    }
}

void PooledPatches::row(uint32_t i, ExchangeRow& out) const {
  out.column.clear();
  out.area_m2.clear();
  const auto density = [&](uint32_t node) { return rows_.rays[node] / static_cast<double>(areas_[node]); };
  const double own = density(i);
  uint64_t a = rows_.start[i], b = column_start_[i];
  const uint64_t a_end = rows_.start[i + 1], b_end = column_start_[i + 1];
  while (a < a_end || b < b_end) {
    const uint32_t ja = a < a_end ? rows_.column[a] : kNone, jb = b < b_end ? source_[b] : kNone;
    const uint32_t j = ja < jb ? ja : jb;
    uint32_t hits = 0;
    if (ja == j) hits += rows_.count[a++];
    if (jb == j) hits += count_[b++];
    out.column.push_back(j);
    out.area_m2.push_back(hits / (own + density(j)));
  }
  const auto whole = static_cast<double>(areas_[i]);
  out.sky_m2 = static_cast<double>(rows_.sky_fraction[i]) * whole;
  out.lamps = rows_.lamps[i];
  for (LampIrradiance& lamp : out.lamps)
    for (double& power : lamp.rgb) power *= whole;
  out.absorbed_m2 = rows_.absorbed[i] / own;
  out.sky_means = rows_.sky_means[i];
}

}  // namespace ff::bake
