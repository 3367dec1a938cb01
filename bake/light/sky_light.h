// The sky as a patch sees it. Where that is little, as in a room with a window, rays of the row find it too seldom: a second
// lot is sent where the patches of the neighbourhood found it, weighted so that both together are unbiased (the power
// heuristic). Who is guided is told by the first quarter of the rays, which then counts no more; whereto, by them and by all rays
// of the neighbours: a ray that gets out passes an opening about as far away as what the rays beside it hit.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/light/surface_points.h"

namespace ff::bake {

// What a patch sees of the sky, on average: formats::Node says what for.
struct SkyMeans {
  Vec3 direction;
  std::array<float, 5> quadratic{};
};

// Sums of weighted directions; means() divides by the sum of the weights.
class SkySums {
 public:
  void add(Vec3 direction, double weight);
  void add(const SkyMeans& means, double weight);
  double weight() const { return weight_; }
  SkyMeans means() const;

 private:
  double weight_ = 0, sums_[8] = {};
};

// How far a patch sees, by direction: harmonic means over the cells of a coarse map.
class SightMap {
 public:
  SightMap() : count_(kCells * kCells), inverse_(kCells * kCells) {}
  void clear();
  void add(Vec3 direction, float distance_m);  // of a ray that hit
  float around(Vec3 direction) const;          // m; infinite where no ray near hit
 private:
  static constexpr uint32_t kCells = 32;       // a side of the octahedral map
  std::vector<uint32_t> count_;
  std::vector<float> inverse_;
};

// Rays of one patch's row that reach the sky.
struct SkyRays {
  struct Ray {
    Vec3 origin, direction;
    float cosine;            // between it and the normal where it starts
    float opening_m = 0;     // how far away it leaves the room: SightMap::around(); where somebody is guided by it
  };
  std::vector<Ray> look, main;  // of the first quarter of the row; of the rest
  SightMap sight;               // of the rays that end elsewhere
};
inline uint32_t lookingRays(uint32_t rays) { return rays / 4; }

// Where the sky is, seen from a place: a histogram over directions.
class SkyGuide {
 public:
  static constexpr uint32_t kBins = 64;  // a side of the octahedral map

  SkyGuide() : weight_(kBins * kBins) {}
  void clear();
  void add(Vec3 direction, float radius);  // and a little around: radians
  // To be called once all is added. Leaves out what is below the horizon of all normals around `up`.
  void close(Vec3 up);
  bool empty() const { return bins_.empty(); }
  // choice, u, v in [0, 1).
  Vec3 direction(double choice, float u, float v) const;
  double density(Vec3 direction) const;  // per steradian

 private:
  std::vector<float> weight_;
  std::vector<uint32_t> bins_;        // with a weight, ascending
  std::vector<double> cumulative_;    // of them
};

// The sky of all patches of a neighbourhood: number `first` and on, a row's rays each. Returns sums of which weight() is the
// fraction of the patch's cosine-weighted hemisphere.
std::vector<SkySums> skyOf(const Scene& scene, const PatchSet& set, const RayCaster& caster, const SobolTable& sobol, uint64_t seed,
                           uint32_t first, std::span<SkyRays> found, uint32_t rays);

}  // namespace ff::bake
