#include "bake/matrix/pool.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <ranges>
#include <utility>

#include "bake/memory.h"
#include "bake/packing.h"
#include "bake/sorting.h"

namespace ff::bake {
namespace {

using formats::ByteReader, formats::ByteWriter;

// What the rays of one end stand for, as it is put aside: rays of the node or of the other one, by geometry or counted.
struct HitWeight {
  uint32_t parts;  // in 1 / kRayParts of a ray, if by geometry; else rays
  bool by_geometry, whole, of_other;

  static HitWeight of(const HitRows& rows, uint64_t entry) {
    const bool told = rows.estimate[entry] > 0;
    return {told ? rows.estimate[entry] : rows.count[entry], told, rows.whole[entry] > 0, false};
  }
  static HitWeight of(uint32_t bits) { return {bits >> 3, (bits & 1) != 0, (bits & 2) != 0, (bits & kOfOther) != 0}; }
  uint32_t bits() const { return parts << 3 | (of_other ? kOfOther : 0u) | uint32_t{whole} << 1 | uint32_t{by_geometry}; }
  double rays() const { return by_geometry ? parts / kRayParts : parts; }

  static constexpr uint32_t kOfOther = 4;
};

// A hit as wanted at one end.
struct Wanted {
  uint32_t node, column, weight;
};

constexpr auto nodeOf = [](const Wanted& hit) { return hit.node; };  // inlined where it is called, which a function's address is not

// Hits at nodes [begin, end), of those that are sorted by node.
std::span<const Wanted> wantedAt(const std::vector<Wanted>& hits, uint32_t begin, uint32_t end) {
  const auto first = std::ranges::lower_bound(hits, begin, {}, nodeOf);
  return {first, std::ranges::lower_bound(first, hits.end(), end, {}, nodeOf)};
}

// The first hit behind those at the same node as the k-th.
size_t runEnd(std::span<const Wanted> hits, size_t k) {
  const uint32_t node = hits[k].node;
  while (k < hits.size() && hits[k].node == node) ++k;
  return k;
}

// end: of the rays that the hits are of, HitWeight::kOfOther or 0.
void putRuns(ByteWriter& out, std::span<const Wanted> hits, uint32_t first_node, uint32_t end) {
  size_t runs = 0;
  for (size_t k = 0; k < hits.size(); k = runEnd(hits, k)) ++runs;
  putVarint(out, runs);
  VarintAppender numbers(out);
  uint32_t last_node = first_node;
  for (size_t k = 0; k < hits.size();) {
    const size_t run_end = runEnd(hits, k);
    numbers.put(hits[k].node - std::exchange(last_node, hits[k].node));
    numbers.put(static_cast<uint32_t>(run_end - k));
    for (uint32_t last = 0; k < run_end; ++k) {
      numbers.put(hits[k].column - std::exchange(last, hits[k].column));
      numbers.put(hits[k].weight | end);
    }
  }
}

}  // namespace

double ExchangeRow::total_m2() const { return std::accumulate(area_m2.begin(), area_m2.end(), sky_m2 + absorbed_m2); }

void HitPool::add(uint32_t first_patch, const HitRows& rows) {
  using NodePatch = std::pair<uint32_t, size_t>;
  std::vector<NodePatch> patches;  // node, number in the range
  for (size_t p = 0; p < rows.patches(); ++p) patches.emplace_back(number_[first_patch + p], p);
  std::sort(patches.begin(), patches.end());
  // Sorted by node alone, stably, columns ascend as well.
  std::vector<Wanted> own, others, scratch;
  others.reserve(rows.column.size());
  for (const auto& [i, p] : patches)
    for (uint64_t k = rows.start[p]; k < rows.start[p + 1]; ++k) others.push_back({number_[rows.column[k]], i, HitWeight::of(rows, k).bits()});
  sortByKey(others, scratch, nodeOf);
  own.reserve(others.size());
  for (const Wanted& hit : others) own.push_back({hit.column, hit.node, hit.weight});
  sortByKey(own, scratch, nodeOf);
  release(scratch);
  for (const auto* hits : {&own, &others})
    for (size_t k = 0; k < hits->size();) {
      const size_t end = runEnd(*hits, k);
      std::atomic_ref(wanted_[(*hits)[k].node]).fetch_add(static_cast<uint32_t>(end - k), std::memory_order_relaxed);
      k = end;
    }
  for (size_t b = 0; b < buckets(); ++b) {
    const uint32_t begin = bucket_start_[b], end = bucket_start_[b + 1];
    const auto seen = std::ranges::subrange(std::ranges::lower_bound(patches, begin, {}, &NodePatch::first), std::ranges::lower_bound(patches, end, {}, &NodePatch::first));
    const std::span<const Wanted> own_hits = wantedAt(own, begin, end), other_hits = wantedAt(others, begin, end);
    if (seen.empty() && other_hits.empty()) continue;
    ByteWriter out;
    putVarint(out, seen.size());
    for (const auto& [node, p] : seen) {
      const auto whole = static_cast<double>(area_m2_[first_patch + p]);
      putVarint(out, node - begin);
      out.f64(static_cast<double>(rows.sky_fraction[p]) * whole);
      out.f64(rows.absorbed[p] / density_[node]);
      skyFields(out, rows.sky_means[p]);
      std::vector<LampIrradiance> lamps = rows.lamps[p];
      for (LampIrradiance& lamp : lamps)
        for (double& x : lamp.rgb) x *= whole;
      putLamps(out, lamps);
    }
    putRuns(out, own_hits, begin, 0);
    putRuns(out, other_hits, begin, HitWeight::kOfOther);
    Spill::Block block = spill_.put(out.data());
    const std::lock_guard lock(bucket_[b].mutex);
    bucket_[b].blocks.push_back(std::move(block));
  }
}

void HitPool::take(size_t bucket, PooledRows& out) {
  const uint32_t first = bucket_start_[bucket], n = bucket_start_[bucket + 1] - first;
  std::vector<Spill::Block> blocks = std::move(bucket_[bucket].blocks);
  out.density_ = density_;
  out.first_ = first;
  out.ends_.resize(n);
  out.start_.assign(n + 1, 0);
  for (uint32_t i = 0; i < n; ++i) out.start_[i + 1] = out.start_[i] + wanted_[first + i];
  if (out.room_ < out.start_.back()) {
    out.hits_.reset();
    out.hits_ = std::make_unique_for_overwrite<PooledRows::Hits[]>(out.room_ = out.start_.back());
  }
  std::vector<uint64_t> next(out.start_.begin(), out.start_.end() - 1);  // where a node's further hits go
  tbb::parallel_for(size_t{0}, blocks.size(), [&](size_t k) {
    const std::vector<std::byte> raw = spill_.get(std::exchange(blocks[k], {}));
    ByteReader in(raw);
    for (uint64_t left = takeVarint(in); left > 0; --left) {
      PooledRows::Ends& ends = out.ends_[takeVarint(in)];  // of one block alone
      in.f64(ends.sky_m2);
      in.f64(ends.absorbed_m2);
      skyFields(in, ends.sky_means);
      ends.lamps = takeLamps(in);
    }
    for (int end = 0; end < 2; ++end) {
      uint32_t node = 0;
      for (uint64_t runs = takeVarint(in); runs > 0; --runs) {
        node += static_cast<uint32_t>(takeVarint(in));
        const uint64_t hits = takeVarint(in);
        PooledRows::Hits* at = &out.hits_[std::atomic_ref(next[node]).fetch_add(hits, std::memory_order_relaxed)];
        uint32_t column = 0;
        for (const PooledRows::Hits* last = at + hits; at < last; ++at) {
          column += static_cast<uint32_t>(takeVarint(in));
          *at = {column, static_cast<uint32_t>(takeVarint(in))};
        }
      }
    }
  });
}

void PooledRows::row(uint32_t node, ExchangeRow& out) const {
  const uint32_t i = node - first_;
  thread_local std::vector<Hits> all, scratch;
  all.assign(&hits_[start_[i]], &hits_[start_[i + 1]]);
  sortByKey(all, scratch, [](const Hits& hits) { return hits.column; });  // of a pair, at most one from each end, in any order: sums of two are the same
  out.column.clear();
  out.area_m2.clear();
  const double own = density_[node];
  for (size_t k = 0; k < all.size();) {
    const uint32_t j = all[k].column;
    double told = 0, told_density = 0, counted = 0;  // rays, by geometry and counted; how dense those of the ends are where geometry tells
    bool whole = false;
    for (; k < all.size() && all[k].column == j; ++k) {
      const HitWeight weight = HitWeight::of(all[k].weight);
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
  pool.take(0, rows_);
}

}  // namespace ff::bake
