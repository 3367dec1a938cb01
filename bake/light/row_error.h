// How far the light that a row brings is off, as its own rays tell: those of the first half against those of the second. The light is made up, so
// that the error is known before any light is, whatever colour surfaces have: all patches of one orientation in a cube of 4 cells shine like the
// sky or not at all, by chance, in kLights ways. What a row brings of a sunlit wall in a dark street is so. Rays of a scrambled Sobol sequence are
// stratified together, and the halves miss on opposite sides: the estimate is not too low.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "bake/surface/patches.h"

namespace ff::bake {

// What patches shine with, in all made-up lights.
class MadeUpLight {
 public:
  static constexpr size_t kLights = 8;
  explicit MadeUpLight(const PatchSet& set);
  bool shines(uint32_t patch, size_t light) const { return lit_[patch] >> light & 1; }

 private:
  PagedVector<uint8_t> lit_;  // a bit a light
};

class RowError {
 public:
  explicit RowError(const MadeUpLight& light) : light_(light) {}
  void clear() {
    lit_ = {};
    sky_ = 0;
  }
  // A ray of a half, 0 or 1, that ends on a patch.
  void hit(int half, uint32_t patch) {
    for (size_t l = 0; l < MadeUpLight::kLights; ++l) lit_[static_cast<size_t>(half)][l] += light_.shines(patch, l);
  }
  void sky() { ++sky_; }
  // Mean square over all lights of the error of `rays` rays, relative to what they bring, or to kFloor of what an open sky would where that is more: in
  // a crevice that sees next to nothing next to nothing is off.
  double square(uint32_t rays) const;
  static constexpr double kFloor = 0.25;

 private:
  const MadeUpLight& light_;
  std::array<std::array<uint32_t, MadeUpLight::kLights>, 2> lit_{};  // rays that end on what shines, by half and light
  uint32_t sky_ = 0;
};

}  // namespace ff::bake
