#include "runtime/lamps.h"

#include <algorithm>

namespace ff::runtime {

Lamps::Lamps(const formats::WorldInfo& world) {
  for (const formats::LampGroup& group : world.lamp_groups) baked_.push_back(group.emission);
  scale_.assign(baked_.size(), {1, 1, 1});
  now_ = baked_;
}

void Lamps::set(uint32_t group, Vec3 scale) {
  scale_[group] = scale;
  now_[group] = baked_[group] * scale;
}

void Lamps::setAll(Vec3 scale) {
  for (uint32_t g = 0; g < groups(); ++g) set(g, scale);
}

void Lamps::irradiance(std::span<const formats::LampLight> lamps, std::span<Vec3> out) const {
  std::fill(out.begin(), out.end(), Vec3{});
  for (const formats::LampLight& lamp : lamps)
    if (lamp.group < now_.size()) out[lamp.row] += now_[lamp.group] * lamp.weight;
}

}  // namespace ff::runtime
