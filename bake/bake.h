// The whole bake, top to bottom: scene -> patches -> rays -> pooled rows -> pyramid -> strips -> shards -> manifest.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "bake/bake_code.h"
#include "bake/cleanup/scene_cleanup.h"
#include "bake/finding.h"
#include "bake/plan/ray_units.h"
#include "bake/progress_report.h"
#include "bake/scene.h"
#include "bake/surface/merging.h"
#include "formats/model.h"

namespace ff::bake {

// The share of light that a node sees in other nodes and reflects may not exceed this in any channel, or a closed white room
// would never lose any light: albedo is lowered where albedo * (1 - (sky + absorbed) / Q) is larger.
inline constexpr float kMaxReflected = 0.999f;

// A cluster lights as the mean of many receivers, so its row needs fewer samples than a patch's: Q times this (at least 1).
inline constexpr double kClusterQuanta = 0.5;

// Of a bake before it is begun: within a factor of two or so.
struct BakeEstimate {
  double cell_m = 0, pieces = 0, patches = 0, seconds = 0;
  double memory_bytes = 0;        // that it would take if it had all that it can make use of; what it has less goes to files beside the world
  double least_memory_bytes = 0;  // that it takes in any case
  double disk_bytes = 0;          // of the world
};

struct BakeSettings {
  float cell_m = 0;               // patch size; 0: chosen from patch_budget
  uint64_t patch_budget = 60000;  // used when cell_m is 0
  uint32_t rays = 4096;           // per patch, 1..65535; with a target_error the most; more go towards lamps and where little sky is seen
  float target_error = 0;         // of the light that rays bring 99 of 100 patches, at most, relative (light/row_error.h); 0: all patches cast `rays`
  uint32_t quanta = 512;          // Q of a patch's row, at least, 1..16383: row_samples.h; clusters have kClusterQuanta of it
  uint64_t seed = 1;
  int threads = 0;                // 0: all cores. Never changes a byte of the result.
  float metals = 1;               // PatchSettings::metals
  float merge_error = 0;          // PatchSettings::merge_error
  CleanupSettings cleanup{};
  uint64_t memory_bytes = 0;      // most that the process holds, within a tenth: what does not fit goes to files beside the world, and less than the little
                                  // that any bake takes is refused; 0: what the machine has free
  std::function<void(const BakeEstimate&)> announce{};  // called once the scene is cleaned up, before the work
  BakeCache* cache = nullptr;      // what was done before is taken from it, what is done is kept there; null: neither
  Ranks* ranks = nullptr;          // other processes that help, with a cache that all of them see; null: none
  const std::atomic<bool>* stop = nullptr;  // once it is true, the bake ends within a second, with an error of cause kStopped
  bool geometry = true;           // write drawing geometry
  bool preview = false;           // the world is marked as one: WorldInfo::preview
  std::string vdb_path{};          // where to write the world's cells as OpenVDB grids (world_grids.h); empty: nowhere
};

struct LevelStats {
  uint32_t nodes = 0, tiles = 0;
  uint64_t entries = 0, stored_bytes = 0;
};

struct BakeStats {
  float cell_m = 0;
  uint64_t unmerged_patches = 0;                         // PatchSet::unmerged
  std::array<uint64_t, kMaxMergedLog> merged_patches{};  // PatchSet::merged
  uint64_t triangles = 0, without_area = 0, rays = 0;  // without_area: triangles left out
  uint64_t cast_rays = 0;        // of these; the others were in the cache
  uint32_t mean_rays = 0, fewest_rays = 0;  // of a patch
  float row_error = 0;           // WorldInfo's
  double area_m2 = 0;            // exposed: not inside another solid
  double sky_fraction = 0, absorbed_fraction = 0;  // of the exposed area's rays
  double buried_fraction = 0;    // of the whole area; sealed surface as well
  std::vector<LevelStats> levels;
  std::vector<Finding> findings;      // what is odd about the scene, none about a clean one; last, what is not modelled of it
  std::vector<std::string> warnings;  // of files: the cache, the world; a line each
  uint64_t clamped_nodes = 0;  // nodes whose albedo was lowered: see kMaxReflected
  CachedRays cached;           // what the cache had; nothing without one
  uint64_t spilled_bytes = 0;  // written to files for want of memory
  double ray_seconds = 0, seconds = 0;  // casting alone; the whole bake after import
};

// WorldInfo::bake_key of a bake: scene (cleaned up), settings (cell_m instead of the settings' own) and code. Equal keys, equal bytes.
std::array<uint8_t, 16> bakeKey(const Scene& scene, const BakeSettings& settings, float cell_m);

// Bakes a scene into the world at `path` (a .ffm manifest and its shards). Errors: kUsage (settings), kInvalidFile (a scene
// without surface), kIo (files; memory or threads ran out; stopped). Never throws. Nothing is left behind on an error.
Result<BakeStats> bakeWorld(const Scene& whole, const BakeSettings& settings, const std::string& path,
                            const Progress& progress = {});  // phases: "patches", "rays", "pyramid", "strips", "geometry"

// On another rank than 0 of settings.ranks: casts rays for the bake of rank 0, which is of the same scene with the same settings, until there are no more.
// Errors as of bakeWorld().
Result<void> helpBake(const Scene& whole, const BakeSettings& settings);

// What a bake would find in settings.cache, which must not be null.
struct BakeStatus {
  float cell_m = 0;
  uint64_t patches = 0;
  CachedRays cached;
  std::vector<Vec3> changed;  // RayUnits::status()
};
// Makes the patches, and casts nothing. Errors as of bakeWorld().
Result<BakeStatus> bakeStatus(const Scene& whole, const BakeSettings& settings, const Progress& progress = {});

}  // namespace ff::bake
