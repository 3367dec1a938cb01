// Tiles fade in and out. What the nodes of one that enters show goes over from what their parents show to their own: its weight rises from 0 to 1 on the way from
// where it entered to where it is at hand. One that is wanted no more stays in the cut for a while and goes back on the way that leads away from it. So what changes slowly is what an
// observer passes slowly. How the light itself follows a new cut is the solver's (Solver::ease); how fast, by the observers' way too, is told here.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "shaders/shared.h"
#include "stream/observers.h"

namespace ff::runtime {

struct FadeSettings {
  uint32_t frames = 0;         // that light takes to follow a change of the cut, at least; 0: it does so at once, and tiles leave at once
  uint32_t max_nodes = 40960;  // of tiles that fade out; past it those that show least leave at once
};

// One thread calls. Nothing takes memory after the start.
class CutFade {
 public:
  // radii_m: within which tiles are wanted, by level (Streamer::radii()). max_slots: of the matrix.
  CutFade(const FadeSettings& settings, std::span<const float> radii_m, uint32_t max_slots = kMaxSlots);

  // A frame begins. So long before observers are near a tile it has to be in the cut, s, to show its own light by then.
  float begin(const stream::Observers& observers, float frame_seconds);
  // The tiles to put a matrix together of: `active` (as Streamer::active()) and those that fade out. Sorted likewise; as they are until the next call, or finish().
  std::span<const stream::StripPtr> cut(std::span<const stream::StripPtr> active);
  // Those of the last cut() that fade out, sorted; likewise.
  std::span<const FadingTile> fading() const { return fading_; }
  // The matrix is that of another cut. entered: the tiles that fade in, by number.
  void follow(const LocalMatrix& matrix, std::span<const uint32_t> entered, const stream::Observers& observers);
  // Over how many frames light follows it: by the way of the fastest observer, and as fast as may be where a tile has come late.
  uint32_t easeFrames() const { return came_late_ ? settings_.frames : ease_frames_; }
  // A frame passes.
  void advance(const LocalMatrix& matrix, const stream::Observers& observers);
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
    static constexpr float kUnknown = -1;
    float weight = 1;
    float began_at_m = kUnknown;  // how far away the nearest observer was when it began to fade
    Box bounds{};                 // of it, since then
    bool leaving = false;
    float hurry = 0;  // of the fastest pace, that it leaves at least at, whatever the way: to make room
    bool rests() const { return weight == (leaving ? 0.0f : 1.0f); }
  };
  struct Leaving {  // a tile of the cut before that is not active
    uint32_t at;    // in cut_
    uint32_t tile;  // in tiles_
    float weight;   // the largest of its own and its descendants'
    bool kept;
  };
  void followActive(std::span<const stream::StripPtr> active);
  void listLeaving();
  void keepTheMost();
  static void beginFade(Tile& tile, const stream::ResidentStrip& strip, const stream::Observers& observers);
  bool late(const Tile& tile) const;
  float due(const Tile& tile, float away_m) const;

  const FadeSettings settings_;
  const std::vector<float> radii_m_;
  const uint32_t max_slots_;
  uint32_t ease_frames_;           // by the observers' way
  bool came_late_ = false;         // a tile of the last follow()
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
