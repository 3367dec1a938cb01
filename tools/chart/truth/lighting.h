// A light situation: what shines on a scene. The path tracer and the run time are given the same one.
#pragma once
#include <string>

#include "runtime/updater.h"

namespace ff::chart {

struct Lighting {
  std::string name;      // "sun and sky"
  runtime::Sky sky;      // radiance, W/(m2 sr)
  Vec3 to_sun{0, 1, 0};  // unit
  Vec3 sun;              // irradiance of a surface that faces it, W/m2; black: no sun
  float lamps = 0;       // factor on what the scene's surfaces emit
  Box lit{{-1e30f, -1e30f, -1e30f}, {1e30f, 1e30f, 1e30f}};  // m; only lamps in here shine

  bool hasSun() const { return sun.x > 0 || sun.y > 0 || sun.z > 0; }
  float lampsAt(Vec3 p) const { return lamps > 0 && lit.distance(p) == 0 ? lamps : 0; }
};

}  // namespace ff::chart
