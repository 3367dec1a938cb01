// How far the light that a row brings is off, as its own rays tell: those of the first half against those of the second. The light is made up, so
// that the error is known before any light is: from all patches of one orientation in a cube of 4 cells, or from none of them, by chance, in
// kLights ways; the sky shines on the mean of both. What a row brings of a sunlit wall in a dark street is so. Rays of a scrambled Sobol
// sequence are stratified together, and the halves miss on opposite sides: the estimate is not too low.
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
  // Radiosity of a patch in one of the lights, of a sky's irradiance.
  float radiosity(uint32_t patch, size_t light) const { return lit_[patch] >> light & 1 ? twice_albedo_[patch] : 0; }

 private:
  std::vector<float> twice_albedo_;
  std::vector<uint8_t> lit_;  // a bit a light
};

class RowError {
 public:
  explicit RowError(const MadeUpLight& light) : light_(light) {}
  void clear() {
    sums_ = {};
    sky_ = 0;
  }
  // A ray of a half, 0 or 1, that ends on a patch.
  void hit(int half, uint32_t patch) {
    for (size_t l = 0; l < MadeUpLight::kLights; ++l) sums_[static_cast<size_t>(half)][l] += light_.radiosity(patch, l);
  }
  void sky() { ++sky_; }
  // Mean square over all lights of the error of `rays` rays, relative to what they bring, or to kFloor of what an open sky would where that is more: in
  // a crevice that sees next to nothing next to nothing is off.
  double square(uint32_t rays) const;
  static constexpr double kFloor = 0.25;

 private:
  const MadeUpLight& light_;
  std::array<std::array<float, MadeUpLight::kLights>, 2> sums_{};
  uint32_t sky_ = 0;
};

}  // namespace ff::bake
