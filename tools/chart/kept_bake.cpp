#include "tools/chart/kept_bake.h"

#include <chrono>
#include <filesystem>
#include <fstream>

#include "formats/read/whole_world.h"


namespace ff::chart {

Result<KeptBake> keptBake(const bake::Scene& scene, const bake::BakeSettings& settings, const std::string& path) {
  using Clock = std::chrono::steady_clock;
  std::error_code ignored;  // a folder that cannot be made is one that cannot be written
  std::filesystem::create_directories(std::filesystem::path(path).parent_path(), ignored);
  KeptBake kept{path};
  const std::string timed = path + ".seconds";
  const bool from_a_file = scene.content_hash != decltype(scene.content_hash){};
  const auto clean = bake::cleanUp(scene, settings.cleanup);
  if (!clean) return clean.error();
  if (const auto there = formats::WholeWorld::open(path); there && from_a_file)
    if (there->info().bake_key == bake::bakeKey(clean->scene ? *clean->scene : scene, settings, settings.cell_m > 0 ? settings.cell_m : there->info().cell_m))
      if (std::ifstream in(timed); in >> kept.seconds) return kept;
  const auto start = Clock::now();
  const auto made = bake::bakeWorld(scene, settings, path);
  if (!made) return made.error();
  kept.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  kept.made = true;
  std::ofstream(timed) << kept.seconds;
  return kept;
}

}  // namespace ff::chart
