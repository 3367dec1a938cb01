// How far the light that a pooled row brings is off, as its own rays tell: those of the first half against those of the second. The light is made up, so
// that the error is known before any light is, whatever colour surfaces have: all patches of one orientation in a cube of 4 cells shine like the
// sky or not at all, by chance, in kLights ways. What a row brings of a sunlit wall in a dark street is so. Rays of a scrambled Sobol sequence are
// stratified together, and the halves miss on opposite sides: the estimate is not too low. What geometry tells of near patches is the same in both halves; of
// the rest, the rays of the other ends tell as much (matrix/pool.h): kPooled of the square is left.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "bake/surface/patches.h"

namespace ff::bake {

// So many times the root mean square over patches is what the light of 99 of 100 is off at most: 2.5 in towns, 1.9 to 2.3 in rooms, where few are off by more.
inline constexpr float kNearlyAll = 2.5f;

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
  // Rays of the first and of the second half that end on a patch, and how many they stand for.
  void add(uint32_t patch, std::array<uint32_t, 2> rays, std::array<double, 2> stand_for) {
    for (size_t half = 0; half < 2; ++half) {
      rays_[half] += rays[half];
      stand_for_[half] += stand_for[half];
      for (size_t l = 0; l < MadeUpLight::kLights; ++l) lit_[half][l] += light_.shines(patch, l) ? stand_for[half] : 0;
    }
  }
  void sky(uint32_t rays) { sky_ = rays; }
  // Mean square over all lights of the error of `rays` rays, relative to what they bring, or to kFloor of what an open sky would where that is more: in
  // a crevice that sees next to nothing next to nothing is off.
  double square(uint32_t rays) const;
  static constexpr double kFloor = 0.25;
  static constexpr double kPooled = 0.56;  // 0.49 to 0.65 in towns and rooms, 256 and 1024 rays

 private:
  const MadeUpLight& light_;
  std::array<std::array<double, MadeUpLight::kLights>, 2> lit_{};  // what ends on what shines, by half and light
  std::array<uint32_t, 2> rays_{};     // that end on patches, by half
  std::array<double, 2> stand_for_{};
  uint32_t sky_ = 0;
};

}  // namespace ff::bake
