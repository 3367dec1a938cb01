// Reciprocity pooling: A_i F_ij = A_j F_ji, so rays from both ends estimate one exchange area
//   X_ij = (h_ij + h_ji) / (rays_i/A_i + rays_j/A_j),
// all hits over the pooled density of rays, or what geometry says they stand for (HitRows::estimate). Where all rays towards the other patch get
// there, none at the other end means that by chance none was cast: X_ij is of the ends alone where geometry tells. Sky, absorption and lamps' light are
// known from one end only. A_i is the whole area that rays start from.
//
// What rays from one end hit is wanted at the other: hits are sorted by the node that they are wanted at in two passes, through buckets of
// nodes that follow each other, of which one at a time is in memory.
#pragma once
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "bake/light/hit_rows.h"
#include "bake/spill.h"

namespace ff::bake {

// A row of exchange areas in m2; columns ascending.
struct ExchangeRow {
  std::vector<uint32_t> column;
  std::vector<double> area_m2;
  double sky_m2 = 0, absorbed_m2 = 0;
  std::vector<LampIrradiance> lamps;  // times the area, W; as baked
  SkyMeans sky_means;
  double total_m2() const;            // of the columns, sky and absorbed: the node's area, but for noise
};

// The rows of a bucket.
class PooledRows {
 public:
  uint32_t first() const { return first_; }
  uint32_t end() const { return first_ + static_cast<uint32_t>(ends_.size()); }
  // Fills `out`, reusing its memory. Thread-safe.
  void row(uint32_t node, ExchangeRow& out) const;

 private:
  friend class HitPool;
  struct Hits {
    uint32_t column;
    uint32_t weight;  // HitWeight's bits
  };
  // What a node knows from its own end.
  struct Ends {
    double sky_m2 = 0, absorbed_m2 = 0;
    SkyMeans sky_means;
    std::vector<LampIrradiance> lamps;
  };
  std::span<const double> density_;
  uint32_t first_ = 0;
  std::unique_ptr<Hits[]> hits_;
  uint64_t room_ = 0;            // for so many hits
  std::vector<uint64_t> start_;  // of node first_ + i in hits_, then how many there are
  std::vector<Ends> ends_;
};

class HitPool {
 public:
  // Of a bucket that is taken, about: a hit, which counts at either end; a node, without its lamps.
  static constexpr uint64_t kBytesAHit = 8, kBytesANode = 112;

  // number: the node of each patch. area_m2: of each patch, whole. density: rays by area of each node, 1/m2. bucket_start: first nodes of the buckets,
  // then the number of nodes. All outlive it and the rows that it hands out.
  HitPool(std::span<const uint32_t> number, std::span<const float> area_m2, std::span<const double> density, std::vector<uint32_t> bucket_start, Spill& spill)
      : number_(number), area_m2_(area_m2), density_(density), bucket_start_(std::move(bucket_start)), bucket_(bucket_start_.size() - 1), wanted_(number.size()), spill_(spill) {}
  // Rows of patches [first, first + rows.patches()), each once, in any order. Thread-safe.
  void add(uint32_t first_patch, const HitRows& rows);
  size_t buckets() const { return bucket_start_.size() - 1; }
  // Once all is added, and once for each bucket; on all of TBB's threads. Memory: the above. Fills `out`, reusing its memory, as what is new comes from the
  // system page by page.
  void take(size_t bucket, PooledRows& out);

 private:
  struct Bucket {
    std::mutex mutex;
    std::vector<Spill::Block> blocks;
  };
  const std::span<const uint32_t> number_;
  const std::span<const float> area_m2_;
  const std::span<const double> density_;
  const std::vector<uint32_t> bucket_start_;
  std::vector<Bucket> bucket_;
  PagedVector<uint32_t> wanted_;  // hits at each node, of both ends
  Spill& spill_;
};

// All patches in one bucket, in their own order.
class PooledPatches {
 public:
  // areas_m2: whole. Memory: 8 bytes a hit, from either end.
  PooledPatches(const HitRows& rows, std::span<const float> areas_m2);
  uint32_t nodes() const { return rows_.end(); }
  // As PooledRows::row().
  void row(uint32_t patch, ExchangeRow& out) const { rows_.row(patch, out); }

 private:
  std::vector<double> density_;
  PooledRows rows_;
};

}  // namespace ff::bake
