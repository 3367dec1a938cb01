// ffchart SCENE.glb -o FOLDER: speed against accuracy of a world, and the setting that is just enough.
#include <CLI/CLI.hpp>
#include <fmt/core.h>

#include <filesystem>
#include <string>

#include "tools/chart/sweep.h"
#include "tools/version.h"
#include "tools/view_camera.h"
#include "tools/view_scene.h"

namespace {

using namespace ff;

struct Options {
  chart::SweepOptions sweep;
  std::string camera, out;
  int places = 0;
  double target_error = 0.03, budget_ms = 1, budget_mib = 256;
};

// Observers: evenly over the path's time.
std::vector<chart::Place> placesOf(const view::CameraPath& path, int count) {
  std::vector<chart::Place> places;
  for (int i = 0; i < count; ++i) {
    const double t = path.start() + (path.end() - path.start()) * (i + 0.5) / count;
    places.push_back({path.at(t).eye, path.velocityAt(t), 0});
  }
  return places;
}

Result<void> run(Options& o) {
  const auto say = [](const std::string& line) { fmt::print(stderr, "{}\n", line); };
  view::CameraPath path;
  if (!o.camera.empty()) {
    auto read = view::readCamera(o.camera);
    if (!read) return read.error();
    path = std::move(*read);
  } else if (!o.sweep.world_path.empty()) {
    const auto world = formats::World::open(o.sweep.world_path);
    if (!world) return world.error();
    const auto scene = view::loadScene(*world);
    if (!scene) return scene.error();
    path = view::findPath(*scene);
  }
  o.sweep.path = placesOf(path, o.places > 0 ? o.places : (o.sweep.quick ? 6 : 12));
  const view::Sun sun = path.sun.value_or(view::Sun{normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}});
  const runtime::Sky sky = path.sky.value_or(view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}));
  o.sweep.lights.push_back({"sun and sky", sky, sun.to_sun, sun.irradiance, 0});
  o.sweep.lights.push_back({"lamps", {}, {0, 1, 0}, {}, 1});
  auto swept = chart::runSweep(o.sweep, say);
  if (!swept) return swept.error();
  return {};
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Measures a world at many settings, charts speed against accuracy, and names the setting that is just enough."};
  app.set_version_flag("--version", std::string("ffchart ") + FF_VERSION);
  Options o;
  app.add_option("scene", o.sweep.scene_path, "the scene, .glb or .gltf")->required();
  app.add_option("-o,--out", o.out, "folder for the page, its charts and the worlds baked on the way")->required();
  app.add_option("--world", o.sweep.world_path, "a world baked from it, taken as the default; else one is baked");
  app.add_option("--camera", o.camera, "camera path (JSON); without it one is found");
  app.add_option("--places", o.places, "observers along the path")->check(CLI::Range(1, 1000));
  app.add_flag("--quick", o.sweep.quick, "fewer settings and paths: under two minutes for 60,000 patches");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    const int code = app.exit(e);
    return code == 0 ? 0 : static_cast<int>(ErrorCode::kUsage);
  }
  o.sweep.folder = (std::filesystem::path(o.out) / "worlds").string();
  if (auto ran = run(o); !ran) {
    fmt::print(stderr, "ffchart: {}\n", ran.error().line());
    return static_cast<int>(ran.error().code);
  }
  return 0;
}
