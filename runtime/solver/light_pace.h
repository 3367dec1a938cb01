// How fast what solvers hold back of light may go (Solver::pace). No slot's light follows a new cut by more in a frame than a share of the mean of what lies near, by more
// beyond that, as the cube of the distance; and sooner where observers would be there before it has followed.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "runtime/cut/local_matrix.h"
#include "stream/observers.h"

namespace ff::runtime {

struct LightPace {
  stream::Observers observers{};
  std::span<const float> radii_m{};  // within which tiles are wanted, by level; somebody else's
  float frame_seconds = 0;
  float most_change = 0;  // of the mean, in a frame; 0: no limit

  // Of a tile's leaves.
  struct Tile {
    float loosened = 1;  // so many times the limit holds; and what is beyond once, of the slot's own light as well: so much is not seen of what is bright
    float due = 0;       // of what is held back, at least so much goes in this frame
  };
  Tile of(uint32_t level, const Box& bounds) const {
    const float finer_m = level > 0 ? radii_m[level - 1] : 0;  // a leaf of a coarser level lies beyond it, though its tile may not
    const float beyond = std::max(1.0f, std::max(observers.distance(bounds), finer_m) / nearM());
    const float due = level > 0 ? 0 : 1 / std::max(framesUntilAtHand(bounds), kFewestFrames);  // finer ones will be there before anybody is
    return {beyond * beyond * beyond, due};
  }
  float nearM() const { return kNear * radii_m[0]; }      // what lies nearer has the limit itself
  float atHandM() const { return kAtHand * radii_m[0]; }  // by then all has gone
  // An observer's, in a frame; nowhere 0.
  Vec3 wayM(const stream::Observer& observer) const {
    Vec3 way = observer.velocity * frame_seconds;
    for (int c = 0; c < 3; ++c)
      if (std::abs(way[c]) < kLeastWay_m) way[c] = kLeastWay_m;
    return way;
  }

  static constexpr float kFewestFrames = 36;  // what is due takes so many at least

 private:
  // By the observers' straight ways; infinity: never.
  float framesUntilAtHand(const Box& bounds) const {
    float soonest = std::numeric_limits<float>::infinity();
    for (const stream::Observer& observer : observers) {
      const Vec3 way_m = wayM(observer);
      float first = 0, last = std::numeric_limits<float>::infinity();
      for (int c = 0; c < 3; ++c) {
        const float to_lo = (bounds.lo[c] - atHandM() - observer.at[c]) / way_m[c], to_hi = (bounds.hi[c] + atHandM() - observer.at[c]) / way_m[c];
        first = std::max(first, std::min(to_lo, to_hi));
        last = std::min(last, std::max(to_lo, to_hi));
      }
      if (first <= last) soonest = std::min(soonest, first);
    }
    return soonest;
  }

  static constexpr float kNear = 2, kAtHand = 0.7f;  // of level 0's radius
  static constexpr float kLeastWay_m = 1e-9f;
};

}  // namespace ff::runtime
