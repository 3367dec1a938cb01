// A light situation: what shines on a scene. The path tracer and the run time are given the same one.
#pragma once
#include <algorithm>
#include <string>
#include <vector>

#include "runtime/updater.h"

namespace ff::chart {

struct Lighting {
  std::string name;      // "sun and sky"
  runtime::Sky sky;      // radiance, W/(m2 sr)
  Vec3 to_sun{0, 1, 0};  // unit
  Vec3 sun;              // irradiance of a surface that faces it, W/m2; black: no sun
  float lamps = 0;       // factor on what the scene's surfaces emit
  std::vector<uint16_t> groups{};  // the lamp groups that shine; empty: all of them

  bool hasSun() const { return sun.x > 0 || sun.y > 0 || sun.z > 0; }
  float lampsOf(uint16_t group) const {
    const bool on = groups.empty() || std::find(groups.begin(), groups.end(), group) != groups.end();
    return lamps > 0 && on ? lamps : 0;
  }
  // The same for the run time.
  runtime::Lamps switches(const formats::WorldInfo& world) const {
    runtime::Lamps set(world);
    for (uint32_t g = 0; g < set.groups(); ++g) {
      const float factor = lampsOf(static_cast<uint16_t>(g));
      set.set(g, {factor, factor, factor});
    }
    return set;
  }
};

}  // namespace ff::chart
