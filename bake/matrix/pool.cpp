#include "bake/matrix/pool.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <numeric>
#include <tuple>
#include <utility>

#include "bake/packing.h"

namespace ff::bake {
namespace {

using formats::ByteReader, formats::ByteWriter;

// What the rays of one end stand for, as it is put aside: rays of the node or of the other one, by geometry or counted.
struct HitWeight {
  uint32_t parts;  // in 1 / kRayParts of a ray, if by geometry; else rays
  bool by_geometry, whole, of_other;

  static HitWeight of(const HitRows& rows, uint64_t entry, bool other) {
    const bool told = rows.estimate[entry] > 0;
    return {told ? rows.estimate[entry] : rows.count[entry], told, rows.whole[entry] > 0, other};
  }
  static HitWeight of(uint32_t bits) { return {bits >> 3, (bits & 1) != 0, (bits & 2) != 0, (bits & 4) != 0}; }
  uint32_t bits() const { return parts << 3 | uint32_t{of_other} << 2 | uint32_t{whole} << 1 | uint32_t{by_geometry}; }
  double rays() const { return by_geometry ? parts / kRayParts : parts; }
};

// A hit as wanted at one end.
struct Wanted {
  uint32_t node, column, weight;
  friend bool operator<(const Wanted& a, const Wanted& b) { return std::tie(a.node, a.column) < std::tie(b.node, b.column); }
};

// What one range of patches has for one bucket.
struct Parcel {
  std::vector<Wanted> hits;                         // by node and column
  std::vector<std::pair<uint32_t, size_t>> patches;  // node, number in the range: what it sees besides
};

void putRuns(ByteWriter& out, std::span<const Wanted> hits, uint32_t first_node) {
  size_t runs = 0;
  for (size_t k = 0; k < hits.size(); ++k) runs += k == 0 || hits[k].node != hits[k - 1].node;
  putVarint(out, hits.size());
  putVarint(out, runs);
  uint32_t last_node = first_node;
  for (size_t k = 0; k < hits.size();) {
    size_t end = k + 1;
    while (end < hits.size() && hits[end].node == hits[k].node) ++end;
    putVarint(out, hits[k].node - std::exchange(last_node, hits[k].node));
    putVarint(out, end - k);
    for (uint32_t last = 0; k < end; ++k) {
      putVarint(out, hits[k].column - std::exchange(last, hits[k].column));
      putVarint(out, hits[k].weight);
    }
  }
}

}  // namespace

double ExchangeRow::total_m2() const { return std::accumulate(area_m2.begin(), area_m2.end(), sky_m2 + absorbed_m2); }

void HitPool::add(uint32_t first_patch, const HitRows& rows) {
  const auto bucketOf = [&](uint32_t node) {
    return static_cast<size_t>(std::upper_bound(bucket_start_.begin(), bucket_start_.end(), node) - bucket_start_.begin()) - 1;
  };
  std::vector<Parcel> parcels(buckets());
  for (size_t p = 0; p < rows.patches(); ++p) {
    const uint32_t i = number_[first_patch + p];
    Parcel& own = parcels[bucketOf(i)];
    own.patches.emplace_back(i, p);
    for (uint64_t k = rows.start[p]; k < rows.start[p + 1]; ++k) {
      const uint32_t j = number_[rows.column[k]];
      own.hits.push_back({i, j, HitWeight::of(rows, k, false).bits()});
      parcels[bucketOf(j)].hits.push_back({j, i, HitWeight::of(rows, k, true).bits()});
    }
  }
  for (size_t b = 0; b < parcels.size(); ++b) {
    Parcel& parcel = parcels[b];
    if (parcel.hits.empty() && parcel.patches.empty()) continue;
    std::sort(parcel.hits.begin(), parcel.hits.end());
    ByteWriter out;
    putVarint(out, parcel.patches.size());
    for (const auto& [node, p] : parcel.patches) {
      const auto whole = static_cast<double>(area_m2_[first_patch + p]);
      putVarint(out, node - bucket_start_[b]);
      out.f64(static_cast<double>(rows.sky_fraction[p]) * whole);
      out.f64(rows.absorbed[p] / density_[node]);
      skyFields(out, rows.sky_means[p]);
      std::vector<LampIrradiance> lamps = rows.lamps[p];
      for (LampIrradiance& lamp : lamps)
        for (double& x : lamp.rgb) x *= whole;
      putLamps(out, lamps);
    }
    putRuns(out, parcel.hits, bucket_start_[b]);
    Spill::Block block = spill_.put(out.data());
    const std::lock_guard lock(bucket_[b].mutex);
    bucket_[b].blocks.push_back(std::move(block));
  }
}

PooledRows HitPool::take(size_t bucket) {
  const uint32_t first = bucket_start_[bucket], n = bucket_start_[bucket + 1] - first;
  std::vector<Spill::Block> blocks = std::move(bucket_[bucket].blocks);
  PooledRows pooled;
  pooled.density_ = density_;
  pooled.first_ = first;
  pooled.ends_.resize(n);
  pooled.hits_.resize(blocks.size());
  std::vector<std::vector<std::pair<uint32_t, PooledRows::Run>>> runs(blocks.size());  // node from `first` on
  tbb::parallel_for(size_t{0}, blocks.size(), [&](size_t k) {
    const std::vector<std::byte> raw = spill_.get(std::exchange(blocks[k], {}));
    ByteReader in(raw);
    for (uint64_t left = takeVarint(in); left > 0; --left) {
      PooledRows::Ends& ends = pooled.ends_[takeVarint(in)];  // of one block alone
      in.f64(ends.sky_m2);
      in.f64(ends.absorbed_m2);
      skyFields(in, ends.sky_means);
      ends.lamps = takeLamps(in);
    }
    std::vector<PooledRows::Hits>& hits = pooled.hits_[k];
    hits.reserve(takeVarint(in));
    runs[k].resize(takeVarint(in));
    uint32_t node = 0;
    for (auto& [of, run] : runs[k]) {
      of = node += static_cast<uint32_t>(takeVarint(in));
      run.block = static_cast<uint32_t>(k);
      run.begin = static_cast<uint32_t>(hits.size());
      run.end = run.begin + static_cast<uint32_t>(takeVarint(in));
      for (uint32_t column = 0; hits.size() < run.end;) {
        column += static_cast<uint32_t>(takeVarint(in));
        hits.push_back({column, static_cast<uint32_t>(takeVarint(in))});
      }
    }
  });
  pooled.run_start_.assign(n + 1, 0);
  for (const auto& of_block : runs)
    for (const auto& run : of_block) ++pooled.run_start_[run.first + 1];
  std::partial_sum(pooled.run_start_.begin(), pooled.run_start_.end(), pooled.run_start_.begin());
  pooled.runs_.resize(pooled.run_start_.back());
  std::vector<uint64_t> next(pooled.run_start_.begin(), pooled.run_start_.end() - 1);
  for (const auto& of_block : runs)
    for (const auto& [node, run] : of_block) pooled.runs_[next[node]++] = run;
  return pooled;
}

void PooledRows::row(uint32_t node, ExchangeRow& out) const {
  const uint32_t i = node - first_;
  std::vector<std::pair<uint32_t, uint32_t>> all;  // column, weight
  for (uint64_t r = run_start_[i]; r < run_start_[i + 1]; ++r)
    for (size_t k = runs_[r].begin; k < runs_[r].end; ++k) all.emplace_back(hits_[runs_[r].block][k].column, hits_[runs_[r].block][k].weight);
  std::sort(all.begin(), all.end());
  out.column.clear();
  out.area_m2.clear();
  const double own = density_[node];
  for (size_t k = 0; k < all.size();) {
    const uint32_t j = all[k].first;
    double told = 0, told_density = 0, counted = 0;  // rays, by geometry and counted; how dense those of the ends are where geometry tells
    bool whole = false;
    for (; k < all.size() && all[k].first == j; ++k) {
      const HitWeight weight = HitWeight::of(all[k].second);
      (weight.by_geometry ? told : counted) += weight.rays();
      if (weight.by_geometry) told_density += weight.of_other ? density_[j] : own;
      whole |= weight.whole;
    }
    out.column.push_back(j);
    out.area_m2.push_back(whole ? told / told_density : (told + counted) / (own + density_[j]));
  }
  out.sky_m2 = ends_[i].sky_m2;
  out.absorbed_m2 = ends_[i].absorbed_m2;
  out.sky_means = ends_[i].sky_means;
  out.lamps = ends_[i].lamps;
}

PooledPatches::PooledPatches(const HitRows& rows, std::span<const float> areas_m2) : density_(areas_m2.size()) {
  for (size_t i = 0; i < density_.size(); ++i) density_[i] = rows.rays[i] / static_cast<double>(areas_m2[i]);
  std::vector<uint32_t> same(density_.size());
  std::iota(same.begin(), same.end(), 0u);
  Spill spill({}, ~uint64_t{0});
  HitPool pool(same, areas_m2, density_, {0, static_cast<uint32_t>(same.size())}, spill);
  pool.add(0, rows);
  rows_ = pool.take(0);
}

}  // namespace ff::bake
