// A voxel town of any size: streets, houses with rooms on several floors, cellars, towers, courtyards, arcades, parks,
// tunnels and hills, with lamps in the rooms and along the streets. Everything follows from the seed.
#pragma once
#include <cstdint>
#include <vector>

#include "formats/result.h"
#include "tools/scene/voxels.h"

namespace ff::tools {

struct TownOptions {
  uint64_t patches = 60'000;  // exposed unit faces wanted: reached within 5 %
  uint64_t seed = 1;
  float cell_m = 1;           // edge of a voxel
};

inline constexpr uint64_t kMinTownPatches = 2'000;
inline constexpr uint64_t kMaxTownPatches = 20'000'000;

// A way from the open into a building, and a lamp of its ground floor. Voxel coordinates of the feet (the lamp: itself).
struct Entrance {
  Int3 outside, inside, lamp;
};

struct Town {
  Voxels voxels;
  Int3 origin;         // coordinates of the lowest corner of voxel (0,0,0), in voxels: ground is y = 0, the middle x = z = 0
  int ground = 0;      // voxel layer of the air just above the streets
  float cell_m = 1;
  uint64_t faces = 0;  // exposed unit faces
  uint64_t lamps = 0;  // lamp voxels
  std::vector<Entrance> entrances;
  Int3 street_from, street_to;  // ends of a street through the town, air
};

// Errors: kUsage for a size outside kMinTownPatches .. kMaxTownPatches.
Result<Town> makeTown(const TownOptions& options);

SceneModel townModel(const Town& town, bool merge);

}  // namespace ff::tools
