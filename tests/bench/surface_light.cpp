#include "tests/bench/surface_light.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace ff::bench {

SurfaceLight::SurfaceLight(const formats::WholeWorld& world, std::span<const double> truth) : world_(world), seen_(world.levels()[0].nodes) {
  patches_.reserve(seen_.size());
  for (const formats::TileInfo& info : world.tiles(0))
    for (const formats::Node& node : orExit(world.strip(world.ref(info.id))).nodes) {
      const auto at = truth.subspan(3 * patches_.size(), 3);
      patches_.push_back({node.centroid, node.albedo, {static_cast<float>(at[0]), static_cast<float>(at[1]), static_cast<float>(at[2])}});
    }
}

void SurfaceLight::look(Vec3 observer, const LocalMatrix& matrix, std::span<const Vec4> radiosity) {
  near_.clear();
  far_.clear();
  near_error_ = far_error_ = {};
  double sum = 0;
  uint32_t patches = 0;
  for (const formats::TileInfo& info : world_.tiles(0)) {
    if (info.bounds.distance(observer) > kFar_m) continue;
    // The nearest active ancestors of a tile's nodes lie in one tile.
    std::array<uint8_t, formats::kTileNodes> index;
    for (uint32_t i = 0; i < info.nodes; ++i) index[i] = static_cast<uint8_t>(i);
    formats::TileRef tile = world_.ref(info.id);
    uint32_t first_slot = runtime::kNoSlot;
    for (;;) {
      first_slot = matrix.slotOf(tile.id().level, tile.info().first_node);
      if (first_slot != runtime::kNoSlot) break;
      const auto up = tile.parentIndex();
      for (uint32_t i = 0; i < info.nodes; ++i) index[i] = up[index[i]];
      tile = tile.parent();
    }
    for (uint32_t i = 0; i < info.nodes; ++i) {
      const Patch& patch = patches_[info.first_node + i];
      const float away = length(patch.centroid - observer);
      if (away > kFar_m) continue;
      const Vec4 &b = radiosity[first_slot + index[i]], &rho = matrix.albedo[first_slot + index[i]];
      Vec3 light;  // irradiance of the node times the patch's own albedo
      for (int c = 0; c < 3; ++c) {
        const float albedo = c == 0 ? rho.x : c == 1 ? rho.y : rho.z, shown = c == 0 ? b.x : c == 1 ? b.y : b.z;
        light[c] = albedo > 0 ? shown / albedo * patch.albedo[c] : 0;
        sum += static_cast<double>(light[c]) / 3;
      }
      ++patches;
      const Vec3 off = light - patch.truth;
      (away <= kNear_m ? near_error_ : far_error_) += {static_cast<double>(dot(off, off)), static_cast<double>(dot(patch.truth, patch.truth))};
      Seen& seen = seen_[info.first_node + i];
      if (seen.look == look_) {
        float change = 0;
        for (int c = 0; c < 3; ++c) change = std::max(change, std::abs(light[c] - seen.light[c]));
        (away <= kNear_m ? near_ : far_).push_back(change);
      }
      seen = {light, look_ + 1};
    }
  }
  ++look_;
  const auto mean = static_cast<float>(sum / std::max(patches, 1u));
  for (auto* changes : {&near_, &far_})
    for (float& change : *changes) change = mean > 0 ? change / mean : 0;
}

}  // namespace ff::bench
