// The residual probe of a dense matrix G, always on. With x random on a sixteenth of the places, another one each time,
// and y = G x, it takes ||(I - F C) y - F x|| / ||F x|| on an eighth of the rows; sixteen times make a round, whose norms
// are taken together. It is among the nodes on places only: G is theirs alone.
#pragma once
#include <string>
#include <vector>

#include "runtime/dense/cut_places.h"
#include "runtime/dense/sparse_rows.h"

namespace ff::runtime {

// Rounding leaves a residual also in a matrix just built, the more the more light a room keeps (closed boxes of 256
// places, fp32: 1e-5 at albedo 0.98, 2e-4 at 0.999): to build anew what is no worse would not help.
// Only rounds before any node has left count as fresh: where swaps spoil a matrix within its first round, its limit is
// not raised.
inline constexpr double kOfFresh = 4;

// What a matrix of this name() can hold: 1e-4, fp16 2e-2, luminance 5e-2. The residual is relative to light that has
// bounced once; where a room multiplies light it multiplies errors as well, so that relative to E they come out at 0.03
// to 0.6 of it (closed boxes, albedo 0.9 to 0.999).
double defaultProbeLimit(const std::string& matrix_name);

// No call allocates after construction.
class BounceMonitor {
 public:
  BounceMonitor(uint32_t capacity, double limit);

  // The next x: of nodes that are on places now. It holds until the next call.
  void draw(const CutPlaces& places);
  std::span<const uint32_t> places() const { return drawn_; }
  std::span<const Vec4> x() const { return x_; }  // in the order of places()
  // y of the last draw, by place. None of the nodes that were on places then has left; the rows are those of then.
  void judge(const LocalMatrix& matrix, const CutPlaces& places, SparseRows& rows, std::span<const Vec4> y);

  double round() const { return round_; }  // the ratio of the last whole round; 0: there was none
  // Why the matrix should be built anew: empty, but for the judge() that ended a round above the limit, and above kOfFresh
  // times what the matrix had when it was built.
  const std::string& verdict() const { return verdict_; }
  void nodesLeft() { untouched_ = false; }
  void builtAnew();

 private:
  double limit_;
  std::vector<uint32_t> drawn_, sampled_;     // places; slots of the rows
  std::vector<Vec4> x_;                       // by drawn_
  std::vector<Vec4> work_, minus_, residual_; // per slot
  uint32_t frame_ = 0;
  double left_ = 0, norm_ = 0, round_ = 0;
  bool untouched_ = true;  // no node has left since the matrix was built
  double fresh_ = -1;      // the least of the rounds while it was untouched; -1: none yet
  uint64_t random_ = 1;
  std::string verdict_;
};

}  // namespace ff::runtime
