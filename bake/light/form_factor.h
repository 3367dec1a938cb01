// Form factors by ray casting: row i of the hit matrix counts where `rays` cosine-distributed rays from patch i end.
//   F_ij = 1/A_i int_Ai int_Aj cos(i) cos(j) / (pi r^2) V dAj dAi  is estimated by  h_ij / rays.
// Michael F. Cohen, John R. Wallace. Radiosity and Realistic Image Synthesis. 1993, chapter 4.
// A patch's rays depend on its name and the seed alone. What rays towards a patch stand for is what the two would exchange if nothing stood between them
// (unoccluded.h) times the share that gets there (ray_fan.h), where a ray or more is expected there: fewer are left to chance.
//
// Levels are built of solids that run into each other. An origin is *buried* when its ray and four more around its normal
// all end on back faces: it lies inside another solid and takes no part. A patch's exposed area is A_i (1 - buried / rays).
// So does one that sees sealed surface (sealed.h): no light gets in or out there, so it lies inside.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "bake/light/hit_rows.h"
#include "bake/rays/ray_caster.h"
#include "bake/rays/sobol.h"
#include "bake/surface/patches.h"
#include "bake/work_count.h"

namespace ff::bake {

// A patch is narrow where most of its rays (kMaxRays) end within four cells, as in an alley or a thick wall, and very narrow
// where they end within one.
inline constexpr std::array<float, 2> kNarrowCells = {4, 1};
inline constexpr double kMaxRays = 0.6;

// How many rays a patch casts: `rays`; or, where an error is asked for, as many as its neighbourhood needs for that: kLeastRays to `rays`.
inline constexpr uint32_t kLeastRays = 256;
struct RayBudget {
  RayBudget(uint32_t fixed, float error = 0) : rays(fixed), target_error(error) {}
  uint32_t fewest() const { return target_error > 0 ? std::min(rays, kLeastRays) : rays; }
  uint32_t rays;        // 1 to 65535
  float target_error;   // root mean square over patches, of a row's light: row_error.h; 0: no error is asked for
};

// Origins stratified over the patch and directions stratified over the cosine-weighted hemisphere: those of castRows().
void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               const RayCaster& caster, std::span<Ray> rays);

// Patches that are cast by one task, as ranges of the set's: first ones ascending, then the number of patches. Which ones are in a range
// depends on those of their cube of 2^kCastLog cells alone.
inline constexpr int kCastLog = 4;
std::vector<uint32_t> castRanges(const PatchSet& set);

// A range's patches by groups, whose rays guide each other's and are all that each other's depend on: first ones ascending, then `end`.
std::vector<uint32_t> castGroups(const PatchSet& set, uint32_t first, uint32_t end);

// Rays of a group's rows that end on patches that emit: all that the light of lamps takes from rows, which do not depend on lamps.
struct LampRays {
  std::vector<uint64_t> entry;  // of the rows: those whose patches emit, ascending
  std::vector<uint16_t> ray;    // numbers in the row of the rays that end there: as many as the entry counts, ascending; entry by entry
};

// What a group has cast. rows.lamps is the light of lamps.
struct GroupRows {
  HitRows rows;  // columns are patches of the whole set
  LampRays to_lamps;
};

// Casts the rows of groups of patches; rays towards lamps and, where it is seldom seen, the sky come on top: lamp_light.h and sky_light.h.
class RowCaster {
 public:
  // All outlive it. lamps: those of the scene.
  RowCaster(const Scene& scene, const PatchSet& set, const RayCaster& caster, const LampTree& lamps, RayBudget budget, uint64_t seed);
  ~RowCaster();
  // One of castGroups(). Thread-safe: each thread has memory of its own, by rays. Where rays go is added to trails, that of rays towards lamps to
  // lamp_trail; both may be null. done: counts patches.
  GroupRows cast(uint32_t first, uint32_t end, RayTrail* trail, RayTrail* lamp_trail, WorkCount& done) const;
  // The light of lamps of a group's patches, those that `again` names, once more: lamps have changed, what the rows' rays passed and met has not, but that
  // patches which they met may no longer emit. Thread-safe.
  void castLamps(uint32_t first, std::span<const uint32_t> again, RayTrail* lamp_trail, GroupRows& group) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// The rows of a range's groups as those of the range, which keeps the heaviest of their leaks.
HitRows rowsOfRange(std::vector<HitRows> groups, float cell_m);

// Takes the rows of the range that begins with patch `first`, as soon as they are cast: from many threads, ranges in any order.
using TakeRows = std::function<void(uint32_t first, HitRows rows)>;
// All that `cast` hands over, in order, as the rows of one range.
HitRows gathered(const std::function<void(const TakeRows&)>& cast);

// Casts all rows on all of TBB's threads.
void castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, WorkCount& done, const TakeRows& take);
// The same, all of them at once.
HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, WorkCount& done);

}  // namespace ff::bake
