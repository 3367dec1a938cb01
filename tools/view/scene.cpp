#include "tools/view/scene.h"

#include <span>

#include "formats/read/whole_world.h"
#include "runtime/lamps.h"

namespace ff::view {

Result<ViewScene> loadScene(const formats::WholeWorld& world) {
  if (!world.hasGeometry())
    return Error{ErrorCode::kInvalidFile, world.path(), "", "the world has no drawing geometry", "bake it again with geometry"};
  ViewScene scene;
  scene.cell_m = world.info().cell_m;
  const runtime::Lamps lamps(world.info());
  scene.patches.reserve(world.levels()[0].nodes);
  for (const formats::TileInfo& tile : world.tiles(0)) {
    auto strip = world.strip(tile.id);
    if (!strip) return strip.error();
    scene.patches.insert(scene.patches.end(), strip->nodes.begin(), strip->nodes.end());
    scene.lamps.resize(scene.patches.size());
    lamps.irradiance(strip->lamps, std::span(scene.lamps).last(strip->nodes.size()));
    auto geometry = world.geometry(tile.id.tile);
    if (!geometry) return geometry.error();
    scene.corners.insert(scene.corners.end(), geometry->positions.begin(), geometry->positions.end());
    for (size_t t = 0; t < geometry->patch.size(); ++t) {
      if (t >= geometry->exposed()) scene.sealed.push_back(static_cast<uint32_t>(scene.triangle_patch.size()));
      scene.triangle_patch.push_back(formats::wholeNumber(tile.first_node + geometry->patch[t]));
    }
  }
  for (const Vec3 p : scene.corners) scene.bounds.add(p);
  return scene;
}

}  // namespace ff::view
