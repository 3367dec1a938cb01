#include "tools/chart/eyes.h"

#include "formats/read/whole_world.h"
#include "tools/view/camera.h"

namespace ff::chart {
namespace {

Result<view::CameraPath> pathOf(const std::string& camera, const formats::WholeWorld& world) {
  if (!camera.empty()) return view::readCamera(camera);
  const auto scene = view::loadScene(world);
  if (!scene) return scene.error();
  return view::findPath(*scene);
}

}  // namespace

Result<std::vector<Vec3>> eyesOf(const std::string& camera, const formats::WholeWorld& world, int count) {
  const auto path = pathOf(camera, world);
  if (!path) return path.error();
  std::vector<Vec3> eyes;
  for (int i = 0; i < count; ++i)
    eyes.push_back(path->at(path->start() + (path->end() - path->start()) * i / std::max(1, count - 1)).eye);
  return eyes;
}

}  // namespace ff::chart
