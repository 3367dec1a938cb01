// What solvers on the CPU hold back of light after a change of the cut (Solver::ease). It stands beside the slots' sources, and goes evenly, but for what would be too much in a
// frame (Solver::pace).
#pragma once
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/solver/light_pace.h"
#include "runtime/solver/sound_light.h"

namespace ff::runtime {

// By slot; leaves alone have any. One caller, but for what names other leaves, from many threads. Nothing takes memory after the start.
class HeldLight {
 public:
  HeldLight() {
    held_.reserve(kMaxSlots);
    lit_.reserve(kMaxSlots);
    tiles_.reserve(kMaxSlots / 16);
  }

  void touch(uint32_t most_slots) {
    touchMemory(held_, most_slots);
    touchMemory(lit_, most_slots);
  }
  void ease(uint32_t frames) {
    ease_frames_ = frames;
    if (frames == 0) letGo();
  }
  void pace(const LightPace& pace) { pace_ = pace; }
  // The rows have changed. known: light is that of a step with the rows before them; else nothing is held back.
  void rowsChanged(uint32_t slots, bool known) {
    held_.resize(slots);
    lit_.resize(slots);
    if (!known) letGo();
    due_ = known && ease_frames_ > 0;
    has_sources_ = false;
  }
  void enter(uint32_t slot) { held_[slot] = {}; }
  // Sources are given. Whether what is due has to be taken before: it goes by the first sources after a change.
  bool goesBefore() { return std::exchange(has_sources_, true) && due_; }
  // Whether the solver has to take() of all leaves now, and say so.
  bool due() const { return due_; }
  void take(uint32_t slot, const Vec4& light) { held_[slot].take({light.x, light.y, light.z}, ease_frames_); }
  void taken() {
    due_ = false;
    holds_ = true;
  }

  bool holds() const { return holds_; }
  // A frame passes. light: what slots reflect; source: of all slots; forTiles(work): calls work(tile) for every tile of the matrix, from any threads.
  template <class ForTiles>
  void release(const LocalMatrix& matrix, std::span<const Vec4> light, std::span<const Vec4> source, ForTiles&& forTiles) {
    tiles_.resize(matrix.tiles.size());
    most_change_ = std::numeric_limits<float>::infinity();
    if (pace_.most_change > 0 && !matrix.places.empty()) {
      forTiles([&](uint32_t tile) { look(matrix, tile, light); });
      setLimits();
    }
    std::atomic<bool> left = false;
    forTiles([&](uint32_t tile) {
      if (release(matrix, tile, light, source)) left = true;
    });
    holds_ = left;
  }
  // Sources with what is held back still.
  const std::vector<Vec4>& lit() const { return lit_; }
  void letGo() {
    if (holds_) std::ranges::fill(held_, Slot{});
    due_ = holds_ = false;
  }

 private:
  struct Slot {
    Vec3 light;  // W/m2
    uint32_t frames = 0;

    // It is so much now. What has grown takes its full time again; the rest goes on.
    void take(Vec3 now, uint32_t most_frames) {
      if (!(size(now) <= size(light) * shaders::kHeldGrown)) frames = most_frames;
      light = isSound(now.x) & isSound(now.y) & isSound(now.z) ? now : Vec3{};
    }
    // A frame passes. It takes no longer than most_frames, but where more than `most` would go, and more than what is due.
    bool release(uint32_t most_frames, float most, float due) {
      frames = std::min(frames, most_frames);
      const float stays = frames > 1 ? static_cast<float>(frames - 1) / static_cast<float>(frames) : 0, now = size(light);
      most = std::max(most, due * now);
      if ((1 - stays) * now > most) {
        light *= 1 - most / now;
        frames = std::max(frames - 1, 1u);
        return true;
      }
      light *= stays;
      if (frames > 0) --frames;
      return frames > 0;
    }
    static float size(Vec3 v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }
  };
  struct PacedTile {
    LightPace::Tile pace;
    float light, area_m2;  // of its leaves; W
  };

  void look(const LocalMatrix& matrix, uint32_t tile, std::span<const Vec4> light) {
    const SlotRange& range = matrix.tiles[tile];
    PacedTile& paced = tiles_[tile];
    paced = {pace_.of(range.id.level, matrix.places[tile].bounds), 0, 0};
    for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
      if (!matrix.leaf[s]) continue;
      paced.light += matrix.area_m2[s] * (light[s].x + light[s].y + light[s].z) / 3;
      paced.area_m2 += matrix.area_m2[s];
    }
  }
  // The mean is over surfaces, of which near ones count most.
  void setLimits() {
    double light = 0, area_m2 = 0;
    for (const PacedTile& tile : tiles_) {
      const double weight = 1 / (static_cast<double>(tile.pace.loosened) * static_cast<double>(tile.pace.loosened));
      light += weight * static_cast<double>(tile.light);
      area_m2 += weight * static_cast<double>(tile.area_m2);
    }
    if (light > 0) most_change_ = pace_.most_change * static_cast<float>(light / area_m2);
  }
  // Whether anything is left.
  bool release(const LocalMatrix& matrix, uint32_t tile, std::span<const Vec4> light, std::span<const Vec4> source) {
    const SlotRange& range = matrix.tiles[tile];
    const LightPace::Tile& pace = tiles_[tile].pace;
    const float most = most_change_ * pace.loosened, of_own = pace_.most_change * (pace.loosened - 1);
    bool left = false;
    for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) {
      if (!matrix.leaf[s]) continue;
      left |= held_[s].release(ease_frames_, most + of_own * Slot::size({light[s].x, light[s].y, light[s].z}), pace.due);
      const Vec3& held = held_[s].light;
      lit_[s] = source[s] + Vec4{held.x, held.y, held.z, 0};
    }
    return left;
  }

  std::vector<Slot> held_;
  std::vector<PacedTile> tiles_;  // of the matrix, for this frame
  LightPace pace_;
  float most_change_ = std::numeric_limits<float>::infinity();  // W/m2
  std::vector<Vec4> lit_;
  uint32_t ease_frames_ = 0;
  bool due_ = false;          // the rows have changed since the last step
  bool has_sources_ = false;  // and sources were given since
  bool holds_ = false;        // held_ is not all zero
};

}  // namespace ff::runtime
