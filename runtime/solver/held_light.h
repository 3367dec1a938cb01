// What solvers on the CPU hold back of light after a change of the cut (Solver::ease). It stands beside the slots' sources, and goes evenly.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/solver/sound_light.h"

namespace ff::runtime {

// By slot; leaves alone have any. One caller, but for what names other leaves, from many threads. Nothing takes memory after the start.
class HeldLight {
 public:
  HeldLight() {
    held_.reserve(kMaxSlots);
    lit_.reserve(kMaxSlots);
  }

  void touch(uint32_t most_slots) {
    touchMemory(held_, most_slots);
    touchMemory(lit_, most_slots);
  }
  void ease(uint32_t frames) {
    ease_frames_ = frames;
    if (frames == 0) letGo();
  }
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
  // A frame passes; whether anything is left. lit(): sources with what is held back still.
  bool release(std::span<const uint32_t> leaves, std::span<const Vec4> source) {
    bool left = false;
    for (const uint32_t s : leaves) {
      left |= held_[s].release(ease_frames_);
      const Vec3& light = held_[s].light;
      lit_[s] = source[s] + Vec4{light.x, light.y, light.z, 0};
    }
    return left;
  }
  void released(bool left) { holds_ = left; }
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
    // A frame passes. It takes no longer than most_frames.
    bool release(uint32_t most_frames) {
      frames = std::min(frames, most_frames);
      const float stays = frames > 1 ? static_cast<float>(frames - 1) / static_cast<float>(frames) : 0;
      light *= stays;
      if (frames > 0) --frames;
      return frames > 0;
    }
    static float size(Vec3 v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }
  };
  std::vector<Slot> held_;
  std::vector<Vec4> lit_;
  uint32_t ease_frames_ = 0;
  bool due_ = false;          // the rows have changed since the last step
  bool has_sources_ = false;  // and sources were given since
  bool holds_ = false;        // held_ is not all zero
};

}  // namespace ff::runtime
