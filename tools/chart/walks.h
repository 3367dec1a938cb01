// Synthetic form factors and walks through them: what the tests and the bench of the dense solvers share. No file, no
// geometry: patches are numbers, their form factors keep reciprocity up to a sampling noise, rows sum to what is asked.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <span>
#include <utility>
#include <vector>

#include "runtime/dense/bounce_matrix.h"

namespace ff::walks {

using runtime::EnteringBlock;
using runtime::Vec4;

// One row: (column, form factor), columns ascending.
using FormFactorRow = std::vector<std::pair<uint32_t, float>>;

// The same values by rows and by columns.
struct SceneRows {
  std::vector<Vec4> albedo;
  std::vector<uint32_t> row_start, columns;
  std::vector<float> row_values;
  std::vector<uint32_t> column_start, receivers;
  std::vector<float> column_values;
  uint32_t patches() const { return static_cast<uint32_t>(albedo.size()); }
};

inline SceneRows makeSceneRows(std::span<const FormFactorRow> rows, std::vector<Vec4> albedo) {
  SceneRows set;
  set.albedo = std::move(albedo);
  set.column_start.assign(rows.size() + 1, 0);
  set.row_start.push_back(0);
  for (const FormFactorRow& row : rows) {
    for (const auto& [column, value] : row) {
      set.columns.push_back(column);
      set.row_values.push_back(value);
      ++set.column_start[column + 1];
    }
    set.row_start.push_back(static_cast<uint32_t>(set.columns.size()));
  }
  for (size_t i = 0; i < rows.size(); ++i) set.column_start[i + 1] += set.column_start[i];
  set.receivers.resize(set.columns.size());
  set.column_values.resize(set.columns.size());
  std::vector<uint32_t> next(set.column_start.begin(), set.column_start.end() - 1);
  for (uint32_t i = 0; i < rows.size(); ++i)
    for (const auto& [column, value] : rows[i]) {
      set.receivers[next[column]] = i;
      set.column_values[next[column]++] = value;
    }
  return set;
}

enum class SceneKind {
  kCorridor,    // a ring of patches that see their neighbourhood; 8 % of the light leaves
  kClosedBox,   // anyone may see anyone; every row sums to 1
  kEnclosures,  // closed; pairs that see almost only each other
};

struct SceneSettings {
  SceneKind kind = SceneKind::kCorridor;
  uint32_t patches = 1024;
  uint32_t entries_per_row = 100;
  float albedo = 0;     // 0: random colours between 0.2 and 0.8
  double noise = 0.05;  // rows are sampled independently: relative deviation of each entry
  uint64_t seed = 1;
};

inline std::vector<FormFactorRow> makeRows(const SceneSettings& s) {
  std::mt19937_64 random(s.seed);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) / 9007199254740992.0; };
  const uint32_t n = s.patches, reach = std::max(2u, std::min(n / 2, 4 * s.entries_per_row));
  std::vector<std::vector<std::pair<uint32_t, double>>> exchange(n);  // area times form factor, symmetric
  const auto connect = [&](uint32_t i, uint32_t j, double x) {
    if (i == j) return;
    exchange[i].push_back({j, x});
    exchange[j].push_back({i, x});
  };
  for (uint32_t i = 0; i < n; ++i) {
    connect(i, (i + 1) % n, 0.5 + uniform());  // nobody is alone
    for (uint32_t e = 2; e < std::min(n, s.entries_per_row); e += 2) {
      const double u = uniform(), x = 0.1 + uniform();
      if (s.kind == SceneKind::kCorridor)  // denser and stronger nearby
        connect(i, (i + 1 + static_cast<uint32_t>(u * u * reach)) % n, x / (0.1 + u));
      else
        connect(i, static_cast<uint32_t>(u * n), x);
    }
    if (s.kind == SceneKind::kEnclosures && i % 2 == 0 && i + 1 < n) connect(i, i + 1, 100.0 * s.entries_per_row);
  }
  const double kept = s.kind == SceneKind::kCorridor ? 0.92 : 1.0;
  std::vector<FormFactorRow> rows(n);
  for (uint32_t i = 0; i < n; ++i) {
    auto& row = exchange[i];
    std::sort(row.begin(), row.end());
    double sum = 0;
    std::vector<std::pair<uint32_t, double>> merged;
    for (const auto& [j, x] : row) {
      if (merged.empty() || merged.back().first != j) merged.push_back({j, 0});
      merged.back().second += x;
    }
    for (auto& [j, x] : merged) sum += x *= 1 + s.noise * (2 * uniform() - 1);
    for (const auto& [j, x] : merged) rows[i].push_back({j, static_cast<float>(kept * x / sum)});
  }
  return rows;
}

inline std::vector<Vec4> makeAlbedos(const SceneSettings& s) {
  std::mt19937_64 random(s.seed + 1000);
  const auto uniform = [&] { return 0.2f + 0.6f * static_cast<float>(random() >> 40) / 16777216.0f; };
  std::vector<Vec4> albedo(s.patches, {s.albedo, s.albedo, s.albedo, 0});
  for (Vec4& a : albedo)
    if (s.albedo == 0) a = {uniform(), uniform(), uniform(), 0};
  return albedo;
}

inline SceneRows makeScene(const SceneSettings& s) { return makeSceneRows(makeRows(s), makeAlbedos(s)); }

inline std::vector<Vec4> randomLight(size_t count, uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto uniform = [&] { return static_cast<float>(random() >> 40) / 16777216.0f; };
  std::vector<Vec4> light(count);
  for (Vec4& v : light) v = {uniform(), 5 * uniform(), uniform() < 0.8f ? 0 : uniform(), 0};
  return light;
}

// Which patch sits where; builds the blocks that enter.
class Placement {
 public:
  static constexpr uint32_t kNone = 0xffffffffu;

  Placement(const SceneRows& set, uint32_t places)
      : set_(set), place_(set.patches(), kNone), patch_(places, kNone), entering_(set.patches(), 0) {}

  uint32_t place(uint32_t patch) const { return place_[patch]; }
  uint32_t patch(uint32_t place) const { return patch_[place]; }
  uint32_t places() const { return static_cast<uint32_t>(patch_.size()); }
  const SceneRows& set() const { return set_; }

  // Seats the patches on the lowest free places. The block's spans live until the next call.
  EnteringBlock enter(std::span<const uint32_t> patches) {
    places_now_.clear();
    albedo_.clear();
    row_start_.assign(1, 0);
    column_start_.assign(1, 0);
    columns_.clear();
    receivers_.clear();
    row_values_.clear();
    column_values_.clear();
    uint32_t free = 0;
    for (const uint32_t p : patches) {
      FF_CHECK_EQ(place_[p], kNone);
      while (free < places() && patch_[free] != kNone) ++free;
      FF_CHECK_LT(free, places());
      place_[p] = free;
      patch_[free] = p;
      entering_[p] = 1;
      places_now_.push_back(free);
      albedo_.push_back(set_.albedo[p]);
    }
    for (const uint32_t p : patches) {
      for (uint32_t e = set_.row_start[p]; e < set_.row_start[p + 1]; ++e) {
        if (place_[set_.columns[e]] == kNone) continue;
        columns_.push_back(place_[set_.columns[e]]);
        row_values_.push_back(set_.row_values[e]);
      }
      row_start_.push_back(static_cast<uint32_t>(columns_.size()));
      for (uint32_t e = set_.column_start[p]; e < set_.column_start[p + 1]; ++e) {
        const uint32_t i = set_.receivers[e];
        if (place_[i] == kNone || entering_[i]) continue;
        receivers_.push_back(place_[i]);
        column_values_.push_back(set_.column_values[e]);
      }
      column_start_.push_back(static_cast<uint32_t>(receivers_.size()));
    }
    for (const uint32_t p : patches) entering_[p] = 0;
    return {places_now_, albedo_, row_start_, columns_, row_values_, column_start_, receivers_, column_values_};
  }

  // The places that become free; lives until the next call.
  std::span<const uint32_t> leave(std::span<const uint32_t> patches) {
    leaving_.clear();
    for (const uint32_t p : patches) {
      FF_CHECK_LT(place_[p], places());
      leaving_.push_back(place_[p]);
      patch_[place_[p]] = kNone;
      place_[p] = kNone;
    }
    return leaving_;
  }

 private:
  const SceneRows& set_;
  std::vector<uint32_t> place_, patch_;
  std::vector<uint8_t> entering_;
  std::vector<uint32_t> places_now_, row_start_, columns_, column_start_, receivers_, leaving_;
  std::vector<Vec4> albedo_;
  std::vector<float> row_values_, column_values_;
};

using Rgb = std::array<double, 3>;

// The irradiance E of every place for M = source, from the patches' form factors alone, in double precision: solves
// (I - F C) E = F M by Gauss-Seidel to 1e-13, which works for any size, however near to 1 the albedos are (slowly).
inline std::vector<Rgb> exactIrradiance(const Placement& at, std::span<const Vec4> source) {
  const SceneRows& set = at.set();
  std::vector<Rgb> e(at.places(), Rgb{});
  double change = 1, largest = 0;
  for (int sweep = 0; sweep < 200000 && change > 1e-13 * largest; ++sweep) {
    change = 0;
    for (uint32_t i = 0; i < at.places(); ++i) {
      if (at.patch(i) == Placement::kNone) continue;
      const uint32_t p = at.patch(i);
      Rgb sum{};
      double own = 0;
      for (uint32_t k = set.row_start[p]; k < set.row_start[p + 1]; ++k) {
        const uint32_t q = set.columns[k], j = at.place(q);
        if (j == Placement::kNone) continue;
        const auto f = static_cast<double>(set.row_values[k]);
        if (j == i) own = f;
        const float m[3] = {source[j].x, source[j].y, source[j].z};
        const float rho[3] = {set.albedo[q].x, set.albedo[q].y, set.albedo[q].z};
        for (size_t c = 0; c < 3; ++c)
          sum[c] += f * (static_cast<double>(m[c]) + (j == i ? 0 : static_cast<double>(rho[c]) * e[j][c]));
      }
      const float rho[3] = {set.albedo[p].x, set.albedo[p].y, set.albedo[p].z};
      for (size_t c = 0; c < 3; ++c) {
        const double next = sum[c] / (1 - own * static_cast<double>(rho[c]));
        change = std::max(change, std::abs(next - e[i][c]));
        largest = std::max(largest, std::abs(next));
        e[i][c] = next;
      }
    }
    if (largest == 0) break;
  }
  return e;
}

// ||a - b|| / ||b|| over places and channels.
inline double relativeError(std::span<const Vec4> a, std::span<const Rgb> b) {
  double difference = 0, norm = 0;
  for (size_t i = 0; i < b.size(); ++i) {
    const double x[3] = {static_cast<double>(a[i].x), static_cast<double>(a[i].y), static_cast<double>(a[i].z)};
    for (size_t c = 0; c < 3; ++c) {
      difference += (x[c] - b[i][c]) * (x[c] - b[i][c]);
      norm += b[i][c] * b[i][c];
    }
  }
  return norm > 0 ? std::sqrt(difference / norm) : std::sqrt(difference);
}
inline std::vector<Rgb> asDouble(std::span<const Vec4> v) {
  std::vector<Rgb> out;
  for (const Vec4& x : v) out.push_back({static_cast<double>(x.x), static_cast<double>(x.y), static_cast<double>(x.z)});
  return out;
}

enum class WalkKind {
  kStraight,     // the window moves on by a block a step
  kOscillation,  // forward, back, forward, ...: the same tile border crossed for ever
  kTeleports,    // to anywhere, a block a step until it is there
  kRandom,       // any block leaves, any block enters
};

// A window of patches that are in, out of a ring of all. Where all are in, those that leave come back.
class Walk {
 public:
  struct Step {
    std::vector<uint32_t> leaving, entering;  // block of each
  };

  Walk(WalkKind kind, uint32_t patches, uint32_t window, uint32_t block, uint64_t seed)
      : kind_(kind), patches_(patches), window_(window), block_(block), random_(seed), in_(patches, 0) {
    for (uint32_t i = 0; i < window; ++i) in_[i] = 1;
  }

  std::vector<uint32_t> present() const {
    std::vector<uint32_t> list;
    for (uint32_t i = 0; i < patches_; ++i)
      if (in_[i]) list.push_back(i);
    return list;
  }

  Step next() {
    Step step;
    const uint32_t outside = patches_ - window_, k = outside > 0 ? std::min(block_, outside) : block_;
    if (kind_ == WalkKind::kRandom || kind_ == WalkKind::kTeleports) {
      if (kind_ == WalkKind::kTeleports && toEnter(1).empty()) position_ = static_cast<uint32_t>(random_() % patches_);
      if (kind_ == WalkKind::kTeleports && outside > 0) {
        step.entering = toEnter(k);
        for (uint32_t i = 0; i < patches_ && step.leaving.size() < step.entering.size(); ++i)
          if (in_[i] && !inTarget(i)) step.leaving.push_back(i);
      } else {
        step.leaving = drawn(1, k);
        step.entering = outside > 0 ? drawn(0, k) : step.leaving;
      }
    } else {
      const bool back = kind_ == WalkKind::kOscillation && moved_;
      if (back) position_ = (position_ + patches_ - k) % patches_;
      for (uint32_t i = 0; i < k; ++i) {
        const uint32_t low = (position_ + i) % patches_;
        const uint32_t high = outside > 0 ? (position_ + window_ + i) % patches_ : low;
        step.leaving.push_back(back ? high : low);
        step.entering.push_back(back ? low : high);
      }
      if (!back) position_ = (position_ + k) % patches_;
      moved_ = !moved_;
    }
    for (const uint32_t p : step.leaving) in_[p] = 0;
    for (const uint32_t p : step.entering) in_[p] = 1;
    return step;
  }

 private:
  bool inTarget(uint32_t patch) const { return (patch + patches_ - position_) % patches_ < window_; }
  std::vector<uint32_t> toEnter(uint32_t most) const {
    std::vector<uint32_t> list;
    for (uint32_t i = 0; i < window_ && list.size() < most; ++i)
      if (!in_[(position_ + i) % patches_]) list.push_back((position_ + i) % patches_);
    return list;
  }
  std::vector<uint32_t> drawn(uint8_t in, uint32_t count) {
    std::vector<uint32_t> list, chosen;
    for (uint32_t i = 0; i < patches_; ++i)
      if (in_[i] == in) list.push_back(i);
    for (uint32_t i = 0; i < count; ++i) {
      std::swap(list[i], list[i + random_() % (list.size() - i)]);
      chosen.push_back(list[i]);
    }
    return chosen;
  }

  WalkKind kind_;
  uint32_t patches_, window_, block_, position_ = 0;
  bool moved_ = false;
  std::mt19937_64 random_;
  std::vector<uint8_t> in_;
};

}  // namespace ff::walks
