#include "tools/chart/patch_rows.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "bake/matrix/row_sampling.h"

namespace ff::chart {

using namespace bake;

PatchRows pooledRows(const PatchSet& set, HitRows hits, uint32_t quanta) {
  std::vector<float> areas;
  for (const Patch& p : set.patches) areas.push_back(p.area_m2);
  const PooledPatches pooled(hits, areas);
  hits = {};
  PatchRows rows;
  ExchangeRow row;
  SampledRow sampled;
  for (uint32_t i = 0; i < pooled.nodes(); ++i) {
    pooled.row(i, row);
    if (quanta > 0) {
      sampleRow(row, areas[i], quanta, unitOf(i + 1), sampled);
      for (size_t k = 0; k < sampled.column.size(); ++k) {
        rows.column.push_back(sampled.column[k]);
        rows.f.push_back(static_cast<float>(sampled.count[k]) / static_cast<float>(quanta));
      }
    } else {
      const double sum = row.total_m2();
      for (size_t k = 0; k < row.column.size(); ++k) {
        rows.column.push_back(row.column[k]);
        rows.f.push_back(static_cast<float>(row.area_m2[k] / sum));
      }
    }
    // As a world holds them: not sampled.
    rows.sky.push_back(std::min(1.0f, static_cast<float>(row.sky_m2) / areas[i]));
    Vec3& lamps = rows.lamps.emplace_back();
    for (size_t k = 0; k < row.column.size(); ++k)
      lamps += set.patches[row.column[k]].emission * (static_cast<float>(row.area_m2[k]) / areas[i]);
    rows.start.push_back(rows.column.size());
  }
  return rows;
}

std::vector<double> solveRows(const PatchSet& set, const PatchRows& rows, std::span<const double> source,
                              double tolerance, int most) {
  const size_t n = set.patches.size();
  std::vector<double> b(source.begin(), source.end()), next(b);
  for (int k = 0; k < most; ++k) {
    tbb::parallel_for(size_t{0}, n, [&](size_t i) {
      double sum[3] = {};
      for (uint64_t q = rows.start[i]; q < rows.start[i + 1]; ++q)
        for (size_t c = 0; c < 3; ++c) sum[c] += static_cast<double>(rows.f[q]) * b[3 * rows.column[q] + c];
      for (size_t c = 0; c < 3; ++c)
        next[3 * i + c] = source[3 * i + c] + static_cast<double>(set.patches[i].albedo[static_cast<int>(c)]) * sum[c];
    });
    std::swap(b, next);
    double change = 0, largest = 0;
    for (size_t i = 0; i < b.size(); ++i) {
      change = std::max(change, std::abs(b[i] - next[i]));
      largest = std::max(largest, std::abs(b[i]));
    }
    if (change <= tolerance * largest) break;
  }
  return b;
}

std::vector<double> sunAndSky(const PatchSet& set, const PatchRows& rows, std::span<const double> sun) {
  std::vector<double> source;
  for (size_t i = 0; i < set.patches.size(); ++i)
    for (int c = 0; c < 3; ++c)
      source.push_back(static_cast<double>(set.patches[i].albedo[c]) *
                       (sun[i] + std::numbers::pi * 2.0 * static_cast<double>(rows.sky[i]) + static_cast<double>(rows.lamps[i][c])));
  return source;
}

std::vector<double> sunOnPatches(const PatchSet& set, const RayCaster& caster) {
  const Vec3 to_sun = normalized({0.4f, 0.8f, 0.3f});
  std::vector<double> sun(set.patches.size());
  for (size_t i = 0; i < sun.size(); ++i) {
    const Patch& p = set.patches[i];
    const float c = dot(p.normal, to_sun);
    if (c > 0 && !caster.occluded({p.centroid + p.normal * (10 * caster.surfaceOffset(set.triangles[p.first_triangle].source)), to_sun}, 1e9f))
      sun[i] = 10.0 * static_cast<double>(c);
  }
  return sun;
}

double reflectedDifference(std::span<const double> a, std::span<const double> b) {
  double error = 0, norm = 0;
  for (size_t k = 0; k < b.size(); ++k) {
    error += (a[k] - b[k]) * (a[k] - b[k]);
    norm += b[k] * b[k];
  }
  return norm > 0 ? std::sqrt(error / norm) : std::sqrt(error);
}

}  // namespace ff::chart
