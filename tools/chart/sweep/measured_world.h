// A baked world and the truth about it: what every setting of its run time is compared with.
#pragma once
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "bake/bake.h"
#include "formats/read/whole_world.h"
#include "runtime/cut/node_values.h"
#include "tools/chart/sweep/knobs.h"
#include "tools/chart/truth/path_tracer.h"

namespace ff::chart {

// Where the light is looked at: the patches within reach of an observer, and within a box if there is one.
struct Place {
  Vec3 observer, velocity;  // m, m/s
  float reach_m = 0;
  std::string in_light{};  // looked at in the light of that name alone; empty: in all that have no places of their own
  Box within{{-1e30f, -1e30f, -1e30f}, {1e30f, 1e30f, 1e30f}};  // m
};

// Whether a light is looked at from a place.
bool isSeen(std::span<const Place> places, size_t at, const Lighting& light);

// One light situation of one world.
struct LitWorld {
  Lighting light;
  runtime::NodeValues sun;         // direct irradiance, W/m2, all levels
  runtime::Lamps lamps;            // their switches
  std::vector<Vec3> direct;        // irradiance of patches without a bounce, W/m2: sun, sky and lamps
  std::vector<double> source;      // M, 3 per patch
  std::vector<double> full;        // what is reflected, by the double-precision solve of all level-0 rows, 3 per patch
  std::vector<double> irradiance;  // of the same solve, 3 per patch
  std::vector<PatchTruth> traced;  // one per patch of `looked_at`
};

class MeasuredWorld {
 public:
  // Takes a world as it is. scene outlives it. Errors: unreadable world, or one of another scene.
  static Result<MeasuredWorld> open(const bake::Scene& scene, const std::string& path);

  const formats::WholeWorld& world() const { return *world_; }
  const std::vector<formats::Node>& patches() const { return nodes_; }
  const std::vector<float>& areasM2() const { return areas_m2_; }  // by patch
  const PathTracer& tracer() const { return *tracer_; }
  uint64_t rowBytes() const;  // of all levels on disk

  // Which patches are looked at: up to `most` of those within reach of each place; where patches are so large that
  // there is none in its box, the one nearest to the observer. What was traced is forgotten.
  void lookAt(std::span<const Place> places, uint32_t most);
  const std::vector<uint32_t>& lookedAt() const { return looked_at_; }
  // Numbers in lookedAt() of the patches of a place.
  const std::vector<uint32_t>& ofPlace(size_t place) const { return of_place_[place]; }
  // The same as level-0 node numbers.
  std::vector<uint32_t> patchesOf(size_t place) const {
    std::vector<uint32_t> patches;
    for (const uint32_t number : of_place_[place]) patches.push_back(looked_at_[number]);
    return patches;
  }
  size_t placesLookedAt() const { return of_place_.size(); }

  // Direct light alone: `full`, `irradiance` and `traced` stay empty. Nothing is kept.
  Result<LitWorld> direct(const Lighting& light, uint32_t shadow_rays) const;
  // Direct light, full solve and, if asked, path tracing. Kept by light and shadow rays.
  Result<const LitWorld*> lit(const Lighting& light, uint32_t shadow_rays, const TraceSettings* trace);

 private:
  std::unique_ptr<formats::WholeWorld> world_;
  std::unique_ptr<PathTracer> tracer_;
  std::vector<formats::Node> nodes_;
  std::vector<float> areas_m2_;
  std::vector<uint32_t> looked_at_;
  std::vector<std::vector<uint32_t>> of_place_;
  std::map<std::pair<std::string, uint32_t>, std::unique_ptr<LitWorld>> lit_;
};

}  // namespace ff::chart
