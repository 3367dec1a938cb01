// What the town's voxels are made of. The order is the order of the materials in the file (kind - 1).
#pragma once
#include <cstdint>

#include "tools/scene/model.h"

namespace ff::tools {

enum Kind : uint8_t {
  kAir, kGrass, kDirt, kRock, kSand, kWater, kAsphalt, kPavement, kTrunk, kLeaves, kAutumnLeaves, kBrick, kPlaster,
  kOchre, kBlueWall, kGreenWall, kConcrete, kRoofTile, kSlate, kWoodFloor, kTileFloor, kCarpet, kCream, kRose, kTeal,
  kOak, kRedCloth, kBlueCloth, kWarmLamp, kCoolLamp, kStreetLamp, kKindCount
};

inline constexpr uint8_t kLampKinds[] = {kWarmLamp, kCoolLamp, kStreetLamp};

// One material a kind, from kGrass on.
std::vector<SceneMaterial> townMaterials();

}  // namespace ff::tools
