// Tiles that leave fade out. One that is wanted no more stays in the cut for a while, in which what its nodes show goes over to what their parents show: its weight
// falls from 1 to 0, the slower the more there is to see of it. How the light of what stays or enters follows a new cut is the solver's: Solver::ease.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "shaders/shared.h"
#include "stream/observers.h"

namespace ff::runtime {

struct FadeSettings {
  uint32_t frames = 0;        // that light takes to follow a change of the cut; 0: it does so at once, and tiles leave at once
  uint32_t max_nodes = 6144;  // of tiles that fade out; past it those that show least leave at once
};

// One thread calls. Nothing takes memory after the start.
class CutFade {
 public:
  explicit CutFade(const FadeSettings& settings = {});

  // The tiles to put a matrix together of: `active` (as Streamer::active()) and those that fade out. Sorted likewise; as they are until the next call, or finish().
  std::span<const stream::StripPtr> cut(std::span<const stream::StripPtr> active);
  // Those of the last cut() that fade out, sorted; likewise.
  std::span<const FadingTile> fading() const { return fading_; }
  // The matrix is that of another cut. entered: as MatrixChange has it; empty where slots were given out anew.
  void follow(const LocalMatrix& matrix, std::span<const uint32_t> entered);
  // A frame passes. source: by slot, what is reflected of light that arrives without a bounce, W/m2.
  void advance(const LocalMatrix& matrix, std::span<const Vec4> source, const stream::Observers& observers);
  // Sources are others than they were, also of tiles that have not entered.
  void relit();
  // What fades is gone, by the next cut() and follow().
  void finish();

  // Makes what slots show of what they reflect, W/m2. What a parent shows counts as the same irradiance on its child's albedo.
  void blend(const LocalMatrix& matrix, std::span<Vec4> reflected) const;
  // The same for who does it elsewhere: the slots of tiles of which less than all that they show is their own.
  void fadingSlots(const LocalMatrix& matrix, std::vector<shaders::FadingSlots>& fading) const;
  uint32_t frames() const { return settings_.frames; }

 private:
  struct Tile {
    formats::TileId id;
    float weight = 1, step = 0;  // step: of a frame; 0 where it has not begun
    float left_at_m = 0;         // how far away the nearest observer was then
    Box bounds{};                // of it, since then
    static constexpr float kUnknown = -1;
    float light = kUnknown;      // the sum of some of its nodes' sources, W/m2
    bool leaving = false;
    bool rests() const { return weight == (leaving ? 0.0f : 1.0f); }
  };
  struct Leaving {  // a tile of the cut before that is not active
    uint32_t at;    // in cut_
    float weight;   // the largest of its own and its descendants'
    bool kept;
  };
  Tile* find(formats::TileId id);
  void followActive(std::span<const stream::StripPtr> active);
  void listLeaving();
  void keepTheMost();
  float mean(const LocalMatrix& matrix, std::span<const Vec4> source);

  FadeSettings settings_;
  std::vector<Tile> tiles_, tiles_before_;  // of the matrix
  bool one_has_gone_ = false;               // of tiles_, since the last cut()
  // What a frame asks of strips, most of which it has no other reason to look at: they lie far apart.
  struct Known {
    const stream::ResidentStrip* strip;
    formats::TileId id;
    uint32_t nodes = 0, parent = 0;  // parent: tile of the level above
    formats::TileId parentId() const { return {id.level + 1, parent}; }
  };
  std::vector<stream::StripPtr> cut_, next_cut_;
  std::vector<Known> active_, active_before_;    // all of active_ in cut_, which keeps them
  std::vector<Known> known_, next_known_;        // of cut_ and next_cut_
  std::vector<FadingTile> fading_;
  std::vector<Leaving> leaving_;
  std::vector<uint32_t> order_;  // of leaving_
};

}  // namespace ff::runtime
