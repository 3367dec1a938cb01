// How fast what solvers hold back of light may go (Solver::pace). No slot's light follows a new cut by more in a frame than a share of the mean of what lies near, by more
// beyond that, as the cube of the distance; and sooner where observers would be there before it has followed.
#pragma once
#include <algorithm>
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
    float loosened = 1;  // so many times the limit holds
    float due = 0;       // of what is held back, at least so much goes in this frame
  };
  Tile of(uint32_t level, const Box& bounds) const {
    const float finer_m = level > 0 ? radii_m[level - 1] : 0;  // a leaf of a coarser level lies beyond it, though its tile may not
    const float away_m = std::max(observers.distance(bounds), finer_m), beyond = std::max(1.0f, away_m / nearM());
    Tile tile{beyond * beyond * beyond, 0};
    if (level > 0) return tile;  // finer ones will be there before anybody is
    const float left_m = away_m - atHandM();
    tile.due = left_m > 0 ? std::clamp((away_m - observers.distance(bounds, frame_seconds)) / left_m, 0.0f, 1.0f) : 1;
    return tile;
  }

  float nearM() const { return kNear * radii_m[0]; }      // what lies nearer has the limit itself
  float atHandM() const { return kAtHand * radii_m[0]; }  // by then all has gone

 private:
  static constexpr float kNear = 2, kAtHand = 0.7f;  // of level 0's radius
};

}  // namespace ff::runtime
