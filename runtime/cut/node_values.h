// Values of patches carried up the pyramid: what a cluster stands for is the area-weighted mean of its patches.
#pragma once
#include <span>
#include <vector>

#include "formats/read/whole_world.h"


namespace ff::runtime {

struct NodeValues {
  std::vector<std::vector<Vec3>> mean;       // [level][node]
  std::vector<std::vector<double>> area_m2;  // [level][node]: of the patches beneath

  // Means of the nodes of one tile, in order.
  std::span<const Vec3> tile(const formats::WholeWorld& world, formats::TileId id) const {
    const formats::TileInfo& info = world.tiles(id.level)[id.tile];
    return std::span(mean[id.level]).subspan(info.first_node, info.nodes);
  }
};

// Areas of all patches, m2; reads every level-0 strip. Errors: unreadable strips.
Result<std::vector<float>> patchAreas(const formats::WholeWorld& world);

// per_patch: one per level-0 node, any linear quantity per area (irradiance, radiosity).
NodeValues aggregateUp(const formats::WholeWorld& world, std::span<const float> patch_areas_m2,
                       std::span<const Vec3> per_patch);

}  // namespace ff::runtime
