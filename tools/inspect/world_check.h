// Is a world whole, and is it physics? Every strip is read and decoded (checksums, extents, order, integer closure); then
// reciprocity of every pair of nodes that any row names, what rows tell of the sky, and the pyramid's sums.
//
// Reciprocity: with X_ij = A_i t_i n_ij / Q_i, t_i the row's own total, both rows are systematic samples of one pooled
// exchange area X. A count is within 1 of its expectation, and a total is stored with 12 bits. Hence
//   |X_ij - X_ji| <= A_i t_i / Q_i + A_j t_j / Q_j + 2^-11 max(X_ij, X_ji), and a little for rounding.
// Totals from kMaxTotal on were clamped: nothing is known of such a row's exchange.
//
// Sky: a row's count of it is within 1 of Q f / t, f the fraction of sky, but that rays of their own may have told f: their
// noise is that of a share among WorldInfo::rays, of which six standard deviations are granted.
//
// Lamps: a parent's light of a group, times its area, is the sum of its children's, within the 12 bits of weights; those
// that are exactly 1 may have been clamped.
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "formats/read/whole_world.h"

namespace ff::tools {

inline constexpr double kMaxTotal = 16;

// What one end of a pair knows of it.
struct PairEnd {
  double area_m2 = 0, total = 1;
  uint32_t quanta = 0, count = 0;  // count: 0 where the row does not name the other node
};

struct PairCheck {
  uint32_t level = 0;
  uint64_t i = 0, j = 0;
  double x_ij = 0, x_ji = 0, bound = 0;  // m2
  double ratio() const { return bound > 0 ? std::abs(x_ij - x_ji) / bound : 0; }
};
PairCheck checkPair(uint32_t level, uint64_t i, uint64_t j, const PairEnd& from_i, const PairEnd& from_j);

// A node by its name, as ffinspect takes it: "3,-1,0 12 5", of chunk, tile and index.
std::string nodeText(const formats::WholeWorld& world, uint32_t level, uint64_t node);

struct WorldCheck {
  std::vector<Error> corrupt;     // kInvalidFile or kIo, by level and tile; of strips, geometry, lamp groups
  std::vector<Error> unphysical;  // kPhysics, likewise; at most one per tile and kind of fault
  uint64_t strips = 0, entries = 0, pairs = 0, geometry_tiles = 0;
  std::vector<PairCheck> worst_pairs;  // one per level that has pairs
  // Largest relative difference of a parent from its children's sum; of lamps over all light of a group's parent.
  double worst_area = 0, worst_emission = 0, worst_lamps = 0;
  double worst_sky = 0;  // of what is granted: rows' counts of sky
};

// progress (may be null) is called from one thread at a time with a fraction 0..1. threads: 0 = all cores; the result does
// not depend on it. Memory: 4 bytes an entry, 40 a node and 16 a lamp group that lights it, of one level.
WorldCheck checkWorld(const formats::WholeWorld& world, int threads, const std::function<void(double)>& progress);

}  // namespace ff::tools
