#include "tools/scene/kinds.h"

namespace ff::tools {

std::vector<SceneMaterial> townMaterials() {
  std::vector<SceneMaterial> m(kKindCount - 1);
  const auto set = [&m](Kind kind, const char* name, Vec3 albedo, Vec3 radiance = {}) {
    m[kind - 1u] = {name, albedo, radiance};
  };
  set(kGrass, "grass", {0.16f, 0.36f, 0.08f});
  set(kDirt, "dirt", {0.28f, 0.18f, 0.10f});
  set(kRock, "rock", {0.36f, 0.35f, 0.34f});
  set(kSand, "sand", {0.62f, 0.52f, 0.34f});
  set(kWater, "water", {0.06f, 0.18f, 0.30f});
  set(kAsphalt, "asphalt", {0.11f, 0.11f, 0.12f});
  set(kPavement, "pavement", {0.45f, 0.44f, 0.42f});
  set(kTrunk, "trunk", {0.24f, 0.15f, 0.08f});
  set(kLeaves, "leaves", {0.10f, 0.30f, 0.06f});
  set(kAutumnLeaves, "autumn leaves", {0.55f, 0.24f, 0.05f});
  set(kBrick, "brick", {0.48f, 0.16f, 0.10f});
  set(kPlaster, "plaster", {0.78f, 0.76f, 0.71f});
  set(kOchre, "ochre", {0.72f, 0.50f, 0.20f});
  set(kBlueWall, "blue wall", {0.24f, 0.38f, 0.62f});
  set(kGreenWall, "green wall", {0.34f, 0.54f, 0.34f});
  set(kConcrete, "concrete", {0.50f, 0.50f, 0.50f});
  set(kRoofTile, "roof tile", {0.55f, 0.17f, 0.08f});
  set(kSlate, "slate", {0.17f, 0.19f, 0.23f});
  set(kWoodFloor, "wood floor", {0.46f, 0.28f, 0.14f});
  set(kTileFloor, "tile floor", {0.62f, 0.63f, 0.60f});
  set(kCarpet, "carpet", {0.50f, 0.08f, 0.10f});
  set(kCream, "cream", {0.80f, 0.75f, 0.62f});
  set(kRose, "rose", {0.76f, 0.42f, 0.42f});
  set(kTeal, "teal", {0.20f, 0.52f, 0.50f});
  set(kOak, "oak", {0.34f, 0.20f, 0.09f});
  set(kRedCloth, "red cloth", {0.65f, 0.07f, 0.06f});
  set(kBlueCloth, "blue cloth", {0.08f, 0.14f, 0.58f});
  set(kWarmLamp, "warm lamp", {0.70f, 0.66f, 0.58f}, {10.0f, 7.2f, 4.2f});
  set(kCoolLamp, "cool lamp", {0.68f, 0.70f, 0.72f}, {7.0f, 8.0f, 9.0f});
  set(kStreetLamp, "street lamp", {0.70f, 0.62f, 0.50f}, {16.0f, 10.5f, 5.0f});
  return m;
}

}  // namespace ff::tools
