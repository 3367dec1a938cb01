// Where light ends on the backs of single-sided surfaces: of the rays that are cast anyway, so that it costs none.
#pragma once
#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "bake/finding.h"
#include "bake/scene.h"

namespace ff::bake {

// Rays that end within one cube of 2^kLeakLog cells.
struct Leak {
  Vec3 at;       // one of the points that they meet, m
  float m2 = 0;  // of the patches that cast them, each by the share of its rays
};
inline constexpr int kLeakLog = 3;
inline constexpr size_t kMaxLeaks = 4;  // that are kept of a group of patches, or of a range (form_factor.h)

class LeakSums {
 public:
  explicit LeakSums(float cell_m) : cube_m_(cell_m * (1 << kLeakLog)) {}
  void add(const Leak& leak);
  // The heaviest first, at most so many.
  std::vector<Leak> heaviest(size_t most) const;
  void clear() { cubes_.clear(); }

 private:
  const float cube_m_;
  std::map<std::array<int32_t, 3>, HeaviestPlace> cubes_;
};

// The leaks of a scene as places: shares of whole_m2. Linear in the scene.
std::vector<FoundPlace> placesOf(const Scene& scene, std::span<const Leak> leaks, double whole_m2);

}  // namespace ff::bake
