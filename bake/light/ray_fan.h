// The rays of a patch by where they go: how many of those towards another patch get there. Of rays that nothing would keep from it the expected share
// is known (unoccluded.h), so what is left to chance is how much of it is hidden.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/light/unoccluded.h"
#include "bake/rays/cosine_rays.h"
#include "bake/rays/triangle_hit.h"

namespace ff::bake {

// Whether it may be chance that so many rays of a patch are found: if not, what is expected is wrong.
bool isLikely(uint32_t found, double expected);

class RayFan {
 public:
  // normal: the patch's. met: by ray, the patch that it ends on; kNone: none.
  void assign(const PatchShape& from, Vec3 normal, std::span<const Ray> rays, std::span<const uint32_t> met);

  // Rays of the first and of the second half.
  struct Share {
    std::array<uint32_t, 2> there{}, towards{};
    double expected = 0;  // of both halves, towards the patch; of the rays that were looked at
    bool all() const { return there == towards; }
    // Whether about as many are found as are expected.
    bool isLikely() const { return ff::bake::isLikely(towards[0] + towards[1], expected); }
  };
  // Of rays towards a patch, as often as they would meet its facets, those that meet it. expected: how many there should be; of many some are looked at, and
  // all where these find something in the way.
  Share towards(uint32_t patch, const PatchShape& shape, double expected);

 private:
  static constexpr int kSide = 16;  // bins of a hemisphere, seen from above
  static int binAt(double x);
  struct Bins {
    int x0, x1, y0, y1;
  };
  // Of the first so many of each half.
  Share count(uint32_t patch, const PatchShape& shape, const Bins& bins, size_t of_half);
  // Sets near_ to the rays in those bins that come through the sphere around a shape.
  void findNear(const PatchShape& shape, const Bins& bins, size_t of_half);
  // Sets times_ to how many facets of a shape each of tried_ comes through.
  void tryFacets(const PatchShape& shape);

  Frame frame_;
  Point centre_;
  double radius_m_ = 0;
  size_t half_ = 0;  // rays of the first
  // Rays by bin.
  std::array<uint32_t, kSide * kSide + 1> start_{};
  std::array<std::vector<float>, 3> origin_, direction_;  // by axis; origins from centre_, m
  std::vector<uint32_t> place_;  // in their half
  std::vector<uint8_t> second_;  // half
  std::vector<uint32_t> met_;
  std::vector<uint16_t> bin_;    // of rays in their own order
  // Of the patch that is looked at: rays by their place in those by bin.
  std::vector<uint32_t> near_, tried_;
  std::array<std::vector<double>, 3> tried_origin_, tried_direction_;  // by axis, m
  std::vector<double> times_;
};

}  // namespace ff::bake
