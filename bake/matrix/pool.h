// Reciprocity pooling: A_i F_ij = A_j F_ji, so rays from both ends estimate one exchange area
//   X_ij = (h_ij + h_ji) / (rays_i/A_i + rays_j/A_j),
// all hits over the pooled density of rays. Sky, absorption and lamps' light are known from one end only. A_i is the whole area that rays
// start from; area() of the level is the exposed part.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/light/form_factor.h"

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

// Exchange areas among the nodes of one level, by row.
class ExchangeLevel {
 public:
  virtual ~ExchangeLevel() = default;
  virtual uint32_t nodes() const = 0;
  virtual float area(uint32_t node) const = 0;  // m2
  // Fills `out`, reusing its memory. Thread-safe.
  virtual void row(uint32_t node, ExchangeRow& out) const = 0;
};

// Level 0: pools hit rows and their transpose on the fly. Memory: 12 bytes a hit entry.
class PooledPatches final : public ExchangeLevel {
 public:
  PooledPatches(HitRows rows, std::vector<float> areas_m2);
  uint32_t nodes() const override { return static_cast<uint32_t>(areas_.size()); }
  float area(uint32_t node) const override { return areas_[node] * exposed_[node]; }
  void row(uint32_t node, ExchangeRow& out) const override;

 private:
  HitRows rows_;
  std::vector<float> areas_, exposed_;  // whole; the exposed fraction of it
  std::vector<uint64_t> column_start_;  // the transpose: hits on node j, sources ascending
  std::vector<uint32_t> source_;
  std::vector<uint16_t> count_;
};

}  // namespace ff::bake
