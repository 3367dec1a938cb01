// What a patch gets of each lamp group: rays towards emitters beside those of the patch's row, weighted so that both together
// are unbiased whatever either finds (the power heuristic). A lamp of any size is found from any distance, and a large one
// close by as well.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "bake/light/lamp_tree.h"
#include "bake/light/surface_points.h"
#include "bake/rays/ray_caster.h"

namespace ff::bake {

// Irradiance from a lamp group as baked, mean over the patch's whole area, W/m2.
struct LampIrradiance {
  uint16_t group = 0;
  std::array<double, 3> rgb{};
};

// The entry of a group in a list by group; a new one where there is none.
LampIrradiance& entryOf(std::vector<LampIrradiance>& lamps, uint16_t group);

// One patch at a time; keep one a thread. The order of calls is aim(), hit() for each ray of the row that ends on a patch that emits, in the row's order,
// finish().
class LampLight {
 public:
  // most_rays: of any patch's row. All outlive it.
  LampLight(const Scene& scene, const PatchSet& set, const RayCaster& caster, const LampTree& tree, uint32_t most_rays, uint64_t seed);

  // Looks around with a few rays: which lamps the patch sees, and how many rays it needs. The rays are then forgotten, so that
  // the estimate does not depend on what they found.
  // rays: of the patch's row. It casts up to as many towards lamps, fewer where they are seen whole.
  void aim(uint32_t patch, uint32_t rays);
  // A cosine-distributed ray of the row that ends on a patch. cosine: between ray and normal where it starts.
  void hit(uint32_t emitter, const Hit& hit, const Ray& ray, float cosine);
  // Casts the rays; by group, ascending.
  std::vector<LampIrradiance> finish();

 private:
  struct Sample {
    LampTree::Point to;
    size_t aim = 0;        // of aims_
    double arriving = 0;   // cosine at the patch; 0: dark
    double density = 0;    // per steradian of the whole mixture of aims
  };
  // Of all aims, by their chances; choice: 0 to 1.
  LampTree::Choice choose(double choice, size_t& aim) const;
  Sample sample(const SurfacePoint& from, size_t aim, const LampTree::Choice& choice) const;
  // Sets samples_: of points_, one each, stratified by `offset`, 0 to 1; dark where something is in the way.
  void castTowards(double offset);
  void add(uint32_t leaf, double weight);

  const Scene& scene_;
  const PatchSet& set_;
  const RayCaster& caster_;
  const LampTree& tree_;
  const uint64_t seed_;
  const SobolTable sobol_;
  uint32_t row_rays_ = 0, max_rays_ = 0;
  uint32_t patch_ = 0, count_ = 0;        // count: rays towards lamps
  std::vector<LampTree::Aim> aims_;
  std::vector<double> chance_, cumulative_;  // by aim
  PagedVector<uint32_t> aim_of_node_;        // by node of the tree; valid where aims_[aim].node == node
  std::vector<SurfacePoint> points_;
  std::vector<Sample> samples_;
  std::vector<SightLine> ways_;    // to those that are not dark
  std::vector<size_t> way_to_;   // sample, by way
  std::vector<LampIrradiance> light_;
};

}  // namespace ff::bake
