// Systematic sampling of a row: Q equally spaced points of its cumulative distribution, walked in column order, then sky,
// then absorbed. What lamps emit and the sky's light do not depend on it: both are stored beside the row, whole. Unbiased; every kept entry is a
// node that rays really met; counts sum to Q exactly, and each is within 1 of its expectation.
// (William G. Madow, Lillian H. Madow. On the theory of systematic sampling. 1944.)
#pragma once
#include <cstdint>
#include <vector>

#include "bake/matrix/pool.h"

namespace ff::bake {

struct SampledRow {
  std::vector<uint32_t> column;  // ascending
  std::vector<uint16_t> count;   // >= 1
  uint32_t sky = 0, absorbed = 0;
  double total = 1;              // the row's sum before it was scaled to 1, in units of the node's area
};

// offset in [0, 1): where the first point lies. 1 <= quanta <= kMaxQuanta. A row without any exchange is all absorbed.
void sampleRow(const ExchangeRow& row, float area_m2, uint32_t quanta, double offset, SampledRow& out);

}  // namespace ff::bake
