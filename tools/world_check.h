// Is a world whole, and is it physics? Every strip is read and decoded (checksums, extents, order, integer closure); then
// reciprocity of every pair of nodes that any row names, and the pyramid's sums.
//
// Reciprocity: with X_ij = A_i n_ij / Q_i, both rows are systematic samples of one pooled exchange area X, scaled to
// their own totals t_i and t_j, which are within 1 +- d (WorldInfo::row_total_deviation). A count is within 1 of its
// expectation, so X_ij is within A_i/Q_i of X/t_i. X/t_i and X/t_j differ by at most 2 d / (1 + d) of the larger. Hence
//   |X_ij - X_ji| <= (A_i/Q_i + A_j/Q_j) (1 + 2 d) + 2 d max(X_ij, X_ji), and a little for rounding.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "formats/reader.h"

namespace ff::tools {

struct PairCheck {
  uint32_t level = 0, i = 0, j = 0;
  double x_ij = 0, x_ji = 0, bound = 0;  // m2
  double ratio() const { return bound > 0 ? std::abs(x_ij - x_ji) / bound : 0; }
};
// Counts of both rows; 0 where a row does not name the other node.
PairCheck checkPair(uint32_t level, uint32_t i, uint32_t j, double area_i, uint32_t quanta_i, uint32_t n_ij,
                    double area_j, uint32_t quanta_j, uint32_t n_ji, double deviation);

struct WorldCheck {
  std::vector<Error> corrupt;     // kInvalidFile or kIo, by level and tile; of strips, geometry, spatial grid
  std::vector<Error> unphysical;  // kPhysics, likewise; at most one per tile and kind of fault
  uint64_t strips = 0, entries = 0, pairs = 0, geometry_tiles = 0;
  std::vector<PairCheck> worst_pairs;  // one per level that has pairs
  double worst_area = 0, worst_emission = 0;  // largest relative difference of a parent from its children's sum
};

// progress (may be null) is called from one thread at a time with a fraction 0..1. threads: 0 = all cores; the result does
// not depend on it. Memory: 4 bytes an entry and 16 a node of one level.
WorldCheck checkWorld(const formats::World& world, int threads, const std::function<void(double)>& progress);

}  // namespace ff::tools
