#include "tests/bench/truth.h"

#include <algorithm>
#include <ctime>
#include <nlohmann/json.hpp>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "formats/read/whole_world.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace ff::bench {

void print(const std::string& metric, double value, const char* unit, double limit, const std::string& note,
           const std::string& backend) {
  nlohmann::json j{{"metric", metric}, {"unit", unit}, {"note", note}};
  j["value"] = std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
  j["limit"] = std::isfinite(limit) ? nlohmann::json(limit) : nlohmann::json(nullptr);
  if (!backend.empty()) j["backend"] = backend;
  std::cout << j.dump() << std::endl;
}

double threadMs() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

double quantile(std::vector<double>& values, double share) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<size_t>(share * static_cast<double>(values.size())))];
}

std::string bakeTown(const std::filesystem::path& folder, bool quick, uint64_t patches, uint32_t rays) {
  const std::string scene = (folder / "town.glb").string(), world = (folder / "town.ffm").string();
  const tools::Town town = orExit(tools::makeTown({.patches = quick ? 8000 : patches}));
  orExit(tools::writeGlb(tools::townModel(town, false), scene));
  (void)orExit(bake::bakeWorld(orExit(bake::importGltf(scene)), {.cell_m = 1, .rays = rays}, world));
  return world;
}

Truth solveTruth(const formats::WholeWorld& world, bool lamps) { return orExit(chart::solveWorldTruth(world, lamps)); }

}  // namespace ff::bench
