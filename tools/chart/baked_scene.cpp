#include "tools/chart/baked_scene.h"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <utility>

#include "formats/read/whole_world.h"

namespace ff::chart {

Result<BakedScene> BakedScene::bake(const bake::Scene& scene, const bake::BakeSettings& settings) {
  std::error_code error;
  std::string name = (std::filesystem::temp_directory_path(error) / "ffchart_XXXXXX").string();
  if (error || !mkdtemp(name.data()))
    return Error{ErrorCode::kIo, name, "", "no temporary folder can be made", "set TMPDIR to a folder with room"};
  BakedScene baked;
  baked.folder_ = name;
  const std::string path = (std::filesystem::path(name) / "scene.ffm").string();
  auto stats = bake::bakeWorld(scene, settings, path);
  if (!stats) return stats.error();
  baked.stats_ = std::move(*stats);
  auto world = formats::WholeWorld::open(path);
  if (!world) return world.error();
  baked.world_ = std::make_unique<formats::WholeWorld>(std::move(*world));
  return baked;
}

BakedScene::BakedScene(BakedScene&& other) noexcept { *this = std::move(other); }

BakedScene& BakedScene::operator=(BakedScene&& other) noexcept {
  std::swap(folder_, other.folder_);
  std::swap(world_, other.world_);
  std::swap(stats_, other.stats_);
  return *this;
}

BakedScene::~BakedScene() {
  world_.reset();
  std::error_code ignored;
  if (!folder_.empty()) std::filesystem::remove_all(folder_, ignored);
}

}  // namespace ff::chart
