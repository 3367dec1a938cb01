// ff_bench_accuracy: the light of the default settings against the path tracer, on the town and on staircase (skipped aloud
// where ../shared/scenes is absent). Prints JSON lines; the errors' bars and the tracer's own noise are in the notes.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/core.h>

#include <filesystem>
#include <iostream>
#include <nlohmann/json.hpp>

#include "tools/chart/sweep/sweep.h"
#include "tools/scene_glb.h"
#include "tools/scene_town.h"
#include "tools/view_camera.h"

namespace {

using namespace ff;

struct Options {
  bool quick = false;
  int observers = 24;
  std::string world, scene = FF_SHARED_SCENES "/staircase/staircase.glb";
};

void print(const std::string& metric, const std::string& scene, const chart::Figure& f, double target, const std::string& note) {
  nlohmann::json j{{"metric", metric}, {"unit", "relative"}, {"scene", scene}, {"limit", target}, {"note", note}};
  j["value"] = std::isfinite(f.value) ? nlohmann::json(f.value) : nlohmann::json(nullptr);
  j["error"] = std::isfinite(f.error) ? nlohmann::json(f.error) : nlohmann::json(nullptr);
  std::cout << j.dump() << std::endl;
}

Result<void> measure(const Options& o, const std::string& name, const std::string& scene, const std::string& world, float cell_m,
                     const std::filesystem::path& folder) {
  chart::SweepOptions sweep;
  sweep.scene_path = scene;
  sweep.world_path = world;
  sweep.folder = (folder / name).string();
  sweep.cell_m = cell_m;
  sweep.quick = o.quick;
  sweep.only_default = true;
  sweep.observers = o.quick ? 8 : o.observers;
  sweep.lights.push_back({"sun and sky", view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}), normalized({0.512f, 0.768f, 0.384f}),
                          {13.0f, 11.8f, 9.6f}, 0});
  sweep.lights.push_back({"lamps", {}, {0, 1, 0}, {}, 1});
  const auto swept = chart::runSweep(sweep, [](const std::string& line) { std::cerr << line << "\n"; });
  if (!swept) return swept.error();
  const std::string where =
      fmt::format("{} patches, {} observers, reflected radiosity by area against path tracing", swept->world->patches().size(), swept->placesOfAll());
  for (size_t l = 0; l < swept->lights.size(); ++l) {
    const chart::Accuracy& a = swept->settings.front().accuracy[l];
    const std::string note = fmt::format("{}; against the full solve {:.4f}, energy {:+.4f}, tracer's own noise {:.4f} (taken off)", where,
                                         a.full_solve_rel_l2.value, a.energy.value, swept->tracer_noise[l]);
    if (a.light == "sun and sky") {
      print("accuracy.sun_sky_rel_l2", name, a.rel_l2, 0.06, note);
      print("accuracy.sun_sky_median", name, a.median, 0.03, note + "; of the patches, noise included");
    } else if (a.light == "lamps") {
      print("accuracy.lamps_rel_l2", name, a.rel_l2, 0.06, note);
      print("accuracy.lamps_median", name, a.median, 0.03, note + "; of the patches, noise included");
    }
  }
  return {};
}

Result<void> run(const Options& o) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_accuracy_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const auto town = tools::makeTown({.patches = o.quick ? 8000u : 60000u});
  if (!town) return town.error();
  const std::string path = (folder / "town.glb").string();
  if (auto written = tools::writeGlb(tools::townModel(*town, false), path); !written) return written;
  auto done = measure(o, "town", path, o.world, 1, folder);
  if (done) {
    if (std::filesystem::exists(o.scene))
      done = measure(o, "staircase", o.scene, "", 0, folder);
    else
      std::cerr << "ff_bench_accuracy: SKIPPED staircase: " << o.scene << " is absent\n";
  }
  std::filesystem::remove_all(folder);
  return done;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Measures the default settings against path tracing."};
  Options o;
  app.add_flag("--quick", o.quick, "a town of 8,000 patches, fewer observers and paths");
  app.add_option("--observers", o.observers, "spread over the surface")->check(CLI::Range(2, 1000))->capture_default_str();
  app.add_option("--world", o.world, "the town of 60,000 patches, baked already");
  app.add_option("--scene", o.scene, "the second scene");
  CLI11_PARSE(app, argc, argv);
  if (auto done = run(o); !done) {
    std::cerr << "ff_bench_accuracy: " << done.error().line() << "\n";
    return static_cast<int>(done.error().code);
  }
  return 0;
}
