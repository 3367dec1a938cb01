// Reflected radiosity around observers on the surface.
#include <fmt/core.h>

#include "tests/bench/accuracy.h"
#include "tools/chart/sweep/sweep.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace ff::bench {
namespace {

struct Limits {
  double sun_sky, lamps, median;
};

Result<void> measureAround(const AccuracyOptions& o, const std::string& name, const std::string& scene, const std::string& world,
                           float cell_m, const Limits& limits) {
  chart::SweepOptions sweep;
  sweep.scene_path = scene;
  sweep.world_path = world;
  sweep.folder = (o.folder / name).string();
  sweep.cell_m = cell_m;
  sweep.quick = o.quick;
  sweep.only_default = true;
  sweep.observers = o.observers;
  sweep.lights = {sunAndSky(), lampsAlone()};
  const auto swept = chart::runSweep(sweep, say);
  if (!swept) return swept.error();
  const std::string where =
      fmt::format("{} patches, {} observers, reflected radiosity by area against path tracing", swept->world->patches().size(), swept->placesOfAll());
  for (size_t l = 0; l < swept->lights.size(); ++l) {
    const chart::Accuracy& a = swept->settings.front().accuracy[l];
    const bool sun = a.light == sunAndSky().name;
    if (!sun && a.light != lampsAlone().name) continue;
    const std::string note = fmt::format("{}; against the full solve {:.4f}, energy {:+.4f}, tracer's own noise {:.4f} (taken off)", where,
                                         a.full_solve_rel_l2.value, a.energy.value, swept->tracer_noise[l]);
    const std::string metric = sun ? "accuracy.sun_sky" : "accuracy.lamps";
    printFigure(metric + "_rel_l2", name, a.rel_l2, sun ? limits.sun_sky : limits.lamps, note);
    printFigure(metric + "_median", name, a.median, limits.median, note + "; of the patches, noise included");
  }
  return {};
}

}  // namespace

Result<void> measureTown(const AccuracyOptions& o) {
  const auto town = tools::makeTown({.patches = o.patch_budget});
  if (!town) return town.error();
  const std::string path = (o.folder / "town.glb").string();
  if (auto written = tools::writeGlb(tools::townModel(*town, false), path); !written) return written;
  return measureAround(o, "town", path, o.world, 1, {0.009, 0.025, 0.03});
}

Result<void> measureStaircase(const AccuracyOptions& o) {
  const std::filesystem::path scene = o.shared / "staircase/staircase.glb";
  return isThere(scene) ? measureAround(o, "staircase", scene.string(), "", 0, {0.06, 0.06, 0.03}) : Result<void>{};
}

}  // namespace ff::bench
