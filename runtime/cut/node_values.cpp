#include "runtime/cut/node_values.h"

#include "formats/read/whole_world.h"

namespace ff::runtime {

Result<std::vector<float>> patchAreas(const formats::WholeWorld& world) {
  std::vector<float> areas;
  areas.reserve(world.levels()[0].nodes);
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    for (const formats::Node& node : strip->nodes) areas.push_back(node.area_m2);
  }
  return areas;
}

NodeValues aggregateUp(const formats::WholeWorld& world, std::span<const float> patch_areas_m2,
                       std::span<const Vec3> per_patch) {
  FF_CHECK_EQ(patch_areas_m2.size(), size_t{world.levels()[0].nodes});
  FF_CHECK_EQ(per_patch.size(), patch_areas_m2.size());
  NodeValues values;
  values.mean.emplace_back(per_patch.begin(), per_patch.end());
  values.area_m2.emplace_back(patch_areas_m2.begin(), patch_areas_m2.end());
  for (uint32_t level = 1; level < world.levels().size(); ++level) {
    const std::vector<Vec3>& below = values.mean[level - 1];
    const std::vector<double>& below_area = values.area_m2[level - 1];
    std::vector<Vec3> mean;
    std::vector<double> area;
    for (uint32_t node = 0; node < world.levels()[level].nodes; ++node) {
      double total = 0, sum[3] = {0, 0, 0};
      for (const uint32_t child : world.children(level, node)) {
        total += below_area[child];
        for (int c = 0; c < 3; ++c) sum[c] += below_area[child] * static_cast<double>(below[child][c]);
      }
      Vec3 value;
      for (int c = 0; c < 3; ++c) value[c] = total > 0 ? static_cast<float>(sum[c] / total) : 0.0f;
      mean.push_back(value);
      area.push_back(total);
    }
    values.mean.push_back(std::move(mean));
    values.area_m2.push_back(std::move(area));
  }
  return values;
}

}  // namespace ff::runtime
