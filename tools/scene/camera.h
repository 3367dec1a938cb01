// A camera path through a town: along a street, through a door to a lamp, out again and up above the roofs.
#pragma once
#include <string>
#include <vector>

#include "formats/result.h"
#include "tools/scene/town.h"

namespace ff::tools {

struct CameraKey {
  double t = 0;  // s
  Vec3 eye, target;  // m
};

// Keys lie closely enough (a quarter of a voxel) to be joined by straight lines.
struct CameraPath {
  int fps = 30;
  std::vector<CameraKey> keys;
};

// Whether the cube of half-edge `clearance` voxels around a point holds air only. Above the grid there is air, beside it not.
bool openAir(const Town& town, Vec3 point_m, float clearance);

// Every eye is in open air with a clearance of 0.2 voxels. Errors: kUsage if the town has no way in.
Result<CameraPath> flyThrough(const Town& town, double seconds);

// {"fps": .., "keys": [{"t", "eye", "target"}], "sun": {"direction", "irradiance"}, "sky": {"l0", "zenith"}}: metres,
// seconds; direction points to the sun; irradiance in W/m2 on a surface that faces it; the sky's radiance in direction w is
// l0 + zenith * w.y, W/(m2 sr).
std::string cameraJson(const CameraPath& path);

}  // namespace ff::tools
