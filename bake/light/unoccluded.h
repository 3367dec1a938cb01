// What two patches exchange where nothing stands between them:
//   X_ij = int_Ai int_Aj cos(i) cos(j) / (pi r^2) dAj dAi,  m2; over A_i it is the form factor F_ij.
// From points of the smaller patch towards the larger one: near by in closed form, along the border of what lies above the horizon (Johann Heinrich Lambert,
// Photometria, 1760; Daniel R. Baum, Holly E. Rushmeier, James M. Winget. Improving radiosity solutions through the use of analytically determined
// form-factors. SIGGRAPH 1989), farther off from points to points. Within 1 % (tests).
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "bake/point.h"
#include "bake/surface/patches.h"

namespace ff::bake {

// A patch as a set of convex polygons. Those that overlap count each; those that see each other do not hide each other.
struct PatchShape {
  static constexpr size_t kMostCorners = 8;
  struct Facet {
    std::array<Point, kMostCorners> corner;  // m; counter-clockwise seen from the front
    size_t corners = 0;
    Point normal;  // unit
    double area_m2 = 0;

    std::span<const Point> outline() const { return std::span(corner).first(corners); }
  };
  // A point that stands for an area.
  struct Sample {
    Point at;  // m
    double area_m2;
    uint32_t facet;
  };
  std::vector<Facet> facets;  // none of no area
  std::vector<Sample> middles, thirds;  // one and three a triangle, facet by facet
  Point centre;
  double radius_m = 0;  // of a sphere around `centre` that holds all facets
  double area_m2 = 0;

  void assign(const PatchSet& set, uint32_t patch);  // reuses memory
  bool overlaps() const { return facets.size() > 1; }  // maybe
};

// The shapes of patches that were asked for lately: neighbours see the same ones.
class PatchShapes {
 public:
  explicit PatchShapes(const PatchSet& set) : set_(set), kept_(kKept) {}  // outlives it
  // Until the next one is asked for.
  const PatchShape& of(uint32_t patch) {
    Kept& kept = kept_[patch % kKept];
    if (kept.patch != patch) kept.shape.assign(set_, kept.patch = patch);
    return kept.shape;
  }

 private:
  static constexpr size_t kKept = 1024;
  struct Kept {
    uint32_t patch = kNone;
    PatchShape shape;
  };
  const PatchSet& set_;
  std::vector<Kept> kept_;  // by the low bits of the patch's number
};

// None where that takes more work than it is worth, of patches of many facets, nor where a few points do not tell: where two cross or lie close upon each other.
std::optional<double> unoccludedExchange(const PatchShape& a, const PatchShape& b);

// The same as if both were points at their centres that face each other, or one of them all that the other sees: to tell in advance what is worth the work.
double farExchange(const Patch& a, const Patch& b);

}  // namespace ff::bake
