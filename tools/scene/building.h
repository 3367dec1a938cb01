// Buildings of the town, voxel by voxel. A storey is three voxels of air and a slab; outer walls are one voxel thick.
#pragma once
#include <cstdint>
#include <vector>

#include "tools/scene/random.h"
#include "tools/scene/town.h"

namespace ff::tools {

inline constexpr int kStoreyHeight = 4;

enum class Roof { kFlat, kGable };

struct BuildingPlan {
  Int3 corner;           // outer corner of the ground floor's air: y is the level of the feet
  int width = 8;         // along x, outer walls included; at least 5
  int depth = 8;         // along z
  int floors = 1;
  uint8_t wall = 0;      // Kind of the outer walls
  Roof roof = Roof::kFlat;
  bool cellar = false;
  bool open_cellar = false;  // stairs lead down; else it is sealed and only its lamp lights it
  int door_side = 2;         // index in kFaceNormals: 0 -x, 1 +x, 4 -z, 5 +z; anything else: no door
};

// Builds it into `voxels`; the entrance is added where there is a door. The same state of `random` builds the same house.
void build(Voxels& voxels, Random& random, const BuildingPlan& plan, std::vector<Entrance>& entrances);

}  // namespace ff::tools
