// Lamps: what a world's surfaces emit, by lamp group, each with a switch that dims and colours it. Their light reaches a node
// by formats::LampLight alone, whole and without a bounce; the rows carry what surfaces reflect. So everywhere
//   reflected R = albedo * (direct + sky + lamps) + albedo * F R,   radiosity B = R + emission,
// and no solver knows of emission.
#pragma once
#include <span>
#include <vector>

#include "formats/model.h"

namespace ff::runtime {

class Lamps {
 public:
  Lamps() = default;
  explicit Lamps(const formats::WorldInfo& world);  // all as baked

  uint32_t groups() const { return static_cast<uint32_t>(scale_.size()); }
  // Emits `scale` times what was baked, a channel at a time; 1, 1, 1 gives the same bits as before.
  void set(uint32_t group, Vec3 scale);
  void setAll(Vec3 scale);
  Vec3 scale(uint32_t group) const { return scale_[group]; }

  // What a node emits now, W/m2.
  Vec3 emission(const formats::Node& node) const {
    return node.lamp_group < scale_.size() ? node.emission * scale_[node.lamp_group] : node.emission;
  }
  // Irradiance of the nodes of a strip from all lamps, W/m2; lamps: the strip's.
  void irradiance(std::span<const formats::LampLight> lamps, std::span<Vec3> out) const;

 private:
  std::vector<Vec3> baked_, scale_, now_;  // by group: emission as baked, W/m2; factor; their product
};

}  // namespace ff::runtime
