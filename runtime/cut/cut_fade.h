// Tiles fade in and out. What the nodes of one that enters show goes over from what their parents show to their own: its weight rises from 0 to 1 on the way from
// where it entered to where it is at hand. One that is wanted no more stays in the cut for a while and goes back on the way that leads away from it. A metre of both ways counts as the
// fourth power of the distance, so that what changes slowly is what an observer passes slowly, and what is seen large. How the light itself follows a new cut is the solver's
// (Solver::ease); how fast, by the observers' way too, is told here.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/solver/light_pace.h"
#include "shaders/shared.h"
#include "stream/observers.h"

namespace ff::runtime {

struct FadeSettings {
  static constexpr uint32_t kFrames = 14;  // a good value
  uint32_t frames = 0;         // that light takes to follow a change of the cut, at least; 0: it does so at once, and tiles leave at once
  uint32_t max_nodes = 65536;  // of tiles that fade out; past it those that show least leave at once
  float most_change = 0.01f;  // of the mean of what lies near: by so much a surface's light follows in a frame at most, if nobody will be there before; 0: no limit
};

// One thread calls. Nothing takes memory after the start.
class CutFade {
 public:
  // radii_m: within which tiles are wanted, by level (Streamer::radii()).
  CutFade(const FadeSettings& settings, std::span<const float> radii_m);

  // A frame begins. So long before observers are near a tile it has to be in the cut, s, to show its own light by then.
  float begin(const stream::Observers& observers, float frame_seconds);
  // By tile of the matrix, how much of what it shows is its own; empty: nothing is to fade out (CutWish::own).
  std::span<const float> own() const { return lets_go_ ? std::span<const float>() : own_; }
  // Whether a tile that fades out has come to its end.
  bool oneHasGone() const { return one_has_gone_; }
  // The next cut is asked for by these.
  void asked() { lets_go_ = one_has_gone_ = false; }
  // The matrix is that of another cut. fading: what of it fades out, sorted, and maybe more. entered: the tiles that fade in, by number.
  void follow(const LocalMatrix& matrix, std::span<const FadingTile> fading, std::span<const uint32_t> entered, const stream::Observers& observers);
  // Over how many frames light follows it: by the way of the fastest observer, and as fast as may be where a tile has come late.
  uint32_t easeFrames() const { return came_late_ ? settings_.frames : ease_frames_; }
  // And how fast, at most, in the frame that has begun with these. While somebody turns ten times as fast: else light would come later to what he looks at, and as much would change.
  LightPace pace(const stream::Observers& observers, float frame_seconds) const { return {observers, radii_m_, frame_seconds, settings_.most_change * (turns_ ? 10.0f : 1.0f)}; }
  // A frame passes.
  void advance(const stream::Observers& observers);
  // Nothing fades in any more, and what fades out is gone by the next cut.
  void finish();

  // Makes what slots show of what they reflect, W/m2. What a parent shows counts as the same irradiance on its child's albedo.
  void blend(const LocalMatrix& matrix, std::span<Vec4> reflected) const;
  // The same for who does it elsewhere: the slots of tiles of which less than all that they show is their own.
  void fadingSlots(const LocalMatrix& matrix, std::vector<shaders::FadingSlots>& fading) const;
  uint32_t frames() const { return settings_.frames; }

 private:
  struct Fade {  // of a tile that shows more of its own, or less, from frame to frame
    uint32_t tile;   // number in the matrix
    uint32_t level;
    bool leaving;
    float hurry;       // FadingTile::hurry
    float began_at_m;  // how far away the nearest observer was
    Box bounds;
  };
  bool late(const Fade& fade) const { return fade.began_at_m < kLate * radii_m_[fade.level]; }
  float due(const Fade& fade, float away_m) const;

  static constexpr float kLate = 0.9f;  // of a level's radius: what enters nearer than that has not come by an observer's way
  const FadeSettings settings_;
  const std::vector<float> radii_m_;
  std::array<Vec3, stream::kMaxObservers> headings_{};  // observers' velocities, over a while
  bool turns_ = false;
  uint32_t ease_frames_;    // by the observers' way
  bool came_late_ = false;  // a tile of the last follow()
  bool one_has_gone_ = false, lets_go_ = false;  // for the next cut that is asked for
  // By tile of the matrix, and of that before.
  std::vector<float> own_, own_before_;
  std::vector<formats::TileId> ids_, ids_before_;
  std::vector<Fade> fades_, fades_before_;  // ascending
};

}  // namespace ff::runtime
