// Systematic sampling of a row: Q equally spaced points of its cumulative distribution, walked in column order (lamps
// first: what a row gets of all lamps together is then within 1/Q), then sky, then absorbed. Unbiased; every kept entry is a
// node that rays really met; counts sum to Q exactly, and each is within 1 of its expectation.
// (William G. Madow, Lillian H. Madow. On the theory of systematic sampling. 1944.)
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/pool.h"

namespace ff::bake {

struct SampledRow {
  std::vector<uint32_t> column;  // ascending
  std::vector<uint16_t> count;   // >= 1
  uint32_t sky = 0, absorbed = 0;
  double total = 1;              // the row's sum before it was scaled to 1, in units of the node's area
};

// The Q, from `quanta` to a quarter more, that makes the lamps' share of the row nearest to a whole number of counts: a lamp
// of 8.4 counts in 512 would be sampled as 8 or 9, and all its light would be off by as much; of 549 it has 9. At most 65535.
uint32_t quantaFor(const ExchangeRow& row, uint32_t quanta, std::span<const uint8_t> shines);

// offset in [0, 1): where the first point lies. 1 <= quanta <= 65535. A row without any exchange is all absorbed.
// shines: by node of the level, whether it is a lamp; empty: none is.
void sampleRow(const ExchangeRow& row, float area_m2, uint32_t quanta, double offset, SampledRow& out,
               std::span<const uint8_t> shines = {});

}  // namespace ff::bake
