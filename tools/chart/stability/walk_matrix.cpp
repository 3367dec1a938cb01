#include "tools/chart/stability/walk_matrix.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace ff::chart {

using namespace runtime;
using namespace walks;

namespace {

constexpr uint32_t kMaxEliminated = 512;

double channel(const Vec4& v, size_t c) { return static_cast<double>(c == 0 ? v.x : c == 1 ? v.y : v.z); }

bool isGrey(const SceneRows& set) {
  return std::ranges::all_of(set.albedo, [](const Vec4& a) { return a.x == a.y && a.y == a.z; });
}

std::vector<Rgb> byElimination(const SceneRows& set, std::span<const uint32_t> present, std::span<const Vec4> light) {
  const auto n = static_cast<Eigen::Index>(present.size());
  std::vector<Eigen::Index> number(set.patches(), -1);
  for (Eigen::Index i = 0; i < n; ++i) number[present[static_cast<size_t>(i)]] = i;
  Eigen::MatrixXd f = Eigen::MatrixXd::Zero(n, n), rho(n, 3), m(n, 3), e(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const uint32_t p = present[static_cast<size_t>(i)];
    for (uint32_t k = set.row_start[p]; k < set.row_start[p + 1]; ++k)
      if (const Eigen::Index j = number[set.columns[k]]; j >= 0) f(i, j) = static_cast<double>(set.row_values[k]);
    for (Eigen::Index c = 0; c < 3; ++c) {
      rho(i, c) = channel(set.albedo[p], static_cast<size_t>(c));
      m(i, c) = channel(light[p], static_cast<size_t>(c));
    }
  }
  const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(n, n);
  if (isGrey(set)) {
    e = Eigen::PartialPivLU<Eigen::MatrixXd>(identity - f * rho.col(0).asDiagonal()).solve(f * m);
  } else {
    for (Eigen::Index c = 0; c < 3; ++c)
      e.col(c) = Eigen::PartialPivLU<Eigen::MatrixXd>(identity - f * rho.col(c).asDiagonal()).solve(f * m.col(c));
  }
  std::vector<Rgb> reflected(set.patches(), Rgb{});
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index c = 0; c < 3; ++c)
      reflected[present[static_cast<size_t>(i)]][static_cast<size_t>(c)] = rho(i, c) * e(i, c);
  return reflected;
}

std::vector<Rgb> byIteration(const SceneRows& set, std::span<const uint32_t> present, std::span<const Vec4> light) {
  Placement at(set, static_cast<uint32_t>(present.size()));
  (void)at.enter(present);
  std::vector<Vec4> source(at.places());
  for (const uint32_t p : present) source[at.place(p)] = light[p];
  const std::vector<Rgb> e = exactIrradiance(at, source);
  std::vector<Rgb> reflected(set.patches(), Rgb{});
  for (const uint32_t p : present)
    for (size_t c = 0; c < 3; ++c) reflected[p][c] = channel(set.albedo[p], c) * e[at.place(p)][c];
  return reflected;
}

}  // namespace

std::vector<FormFactorRow> quantised(std::span<const FormFactorRow> rows) {
  std::vector<FormFactorRow> result(rows.begin(), rows.end());
  std::vector<std::pair<double, size_t>> rest;  // what rounding down took, most first
  for (FormFactorRow& row : result) {
    double sum = 0;
    int64_t left = 0;
    rest.clear();
    for (size_t k = 0; k < row.size(); ++k) {
      const double exact = static_cast<double>(row[k].second) * kWalkQuanta, down = std::max(1.0, std::floor(exact));
      sum += exact;
      left -= static_cast<int64_t>(down);
      rest.push_back({exact - down, k});
      row[k].second = static_cast<float>(down);
    }
    left += std::llround(sum);
    std::ranges::sort(rest, [](const auto& a, const auto& b) {
      return a.first != b.first ? a.first > b.first : a.second < b.second;
    });
    for (size_t k = 0; k < rest.size() && left > 0; ++k, --left) row[rest[k].second].second += 1;
    for (size_t k = rest.size(); k-- > 0 && left < 0;)  // entries that were raised to 1 are paid for by the large ones
      if (float& count = row[rest[k].second].second; count > 1) count -= 1, ++left;
    for (auto& [column, count] : row) count /= static_cast<float>(kWalkQuanta);
  }
  return result;
}

SceneRows quantisedScene(const SceneSettings& settings) {
  return makeSceneRows(quantised(makeRows(settings)), makeAlbedos(settings));
}

WalkMatrix::WalkMatrix(const SceneRows& set) : set_(set), in_(set.patches(), 0) {
  const uint32_t slots = set.patches();
  matrix_.row_scale.assign(slots, 1.0f / static_cast<float>(kWalkQuanta));
  matrix_.albedo = set.albedo;
  matrix_.area_m2.assign(slots, 1);
  matrix_.leaf.assign(slots, 0);
  matrix_.parent_slot.assign(slots, kNoSlot);
  matrix_.refined_level_start.assign(1, 0);
}

void WalkMatrix::set(std::span<const uint32_t> present, std::span<const uint32_t> left,
                     std::span<const uint32_t> entered) {
  LocalMatrix& m = matrix_;
  const uint32_t slots = m.slots();
  std::fill(m.leaf.begin(), m.leaf.end(), uint8_t{0});
  for (const uint32_t p : present) m.leaf[p] = 1;
  m.leaves.assign(present.begin(), present.end());
  m.tiles.clear();
  for (const uint32_t p : present) m.tiles.push_back({{0, p}, p, p, 1});
  m.row_start.assign(slots, 0);
  m.row_entries.assign(slots, 0);
  m.entries.clear();
  m.used_entries = 0;
  for (const uint32_t p : present) {
    m.row_start[p] = static_cast<uint32_t>(m.entries.size());
    for (uint32_t k = set_.row_start[p]; k < set_.row_start[p + 1]; ++k)
      if (m.leaf[set_.columns[k]])
        m.entries.push_back(packEntry(set_.columns[k], static_cast<uint32_t>(std::lround(set_.row_values[k] * static_cast<float>(kWalkQuanta)))));
    m.row_entries[p] = static_cast<uint32_t>(m.entries.size()) - m.row_start[p];
    m.used_entries += m.row_entries[p];
    m.entries.resize((m.entries.size() + kRowPadding - 1) / kRowPadding * kRowPadding, 0);
  }
  change_ = {.any = true};
  for (const uint32_t p : left) change_.left.push_back({{0, p}, p, p, 1});
  for (const uint32_t p : entered)
    change_.entered.push_back(
        static_cast<uint32_t>(std::lower_bound(present.begin(), present.end(), p) - present.begin()));
  change_.rows.resize(present.size());
  std::iota(change_.rows.begin(), change_.rows.end(), 0u);
}

std::vector<Rgb> exactReflected(const SceneRows& set, std::span<const uint32_t> present, std::span<const Vec4> light) {
  return present.size() <= kMaxEliminated ? byElimination(set, present, light) : byIteration(set, present, light);
}

double relativeDifference(std::span<const Rgb> a, std::span<const Rgb> b, std::span<const uint32_t> present) {
  double difference = 0, norm = 0;
  for (const uint32_t p : present)
    for (size_t c = 0; c < 3; ++c) {
      difference += (a[p][c] - b[p][c]) * (a[p][c] - b[p][c]);
      norm += b[p][c] * b[p][c];
    }
  if (!std::isfinite(difference)) return std::numeric_limits<double>::infinity();
  return norm > 0 ? std::sqrt(difference / norm) : std::sqrt(difference);
}

}  // namespace ff::chart
