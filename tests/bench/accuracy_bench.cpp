// ff_bench_accuracy: the light of the default settings against the truth: a town and a staircase around observers on their
// surfaces, what is seen from inside a dining room, small lamps, rooms that must be dark. Prints JSON lines; the errors' bars and
// the tracer's own noise are in the notes. Scenes of ../shared/scenes are skipped aloud where they are absent.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/core.h>

#include <array>
#include <cmath>
#include <iostream>
#include <nlohmann/json.hpp>

#include "tests/bench/accuracy.h"
#include "tools/view/camera.h"

namespace ff::bench {

void printFigure(const std::string& metric, const std::string& scene, const chart::Figure& figure, double limit, const std::string& note) {
  const auto number = [](double v) { return std::isfinite(v) ? nlohmann::json(v) : nlohmann::json(nullptr); };
  std::cout << nlohmann::json{{"metric", metric}, {"unit", "relative"},           {"scene", scene},
                              {"note", note},     {"value", number(figure.value)}, {"error", number(figure.error)},
                              {"limit", number(limit)}}
                   .dump()
            << std::endl;
}

void say(const std::string& line) { std::cerr << line << "\n"; }

bool isThere(const std::filesystem::path& file) {
  if (std::filesystem::exists(file)) return true;
  say("ff_bench_accuracy: SKIPPED: " + file.string() + " is absent");
  return false;
}

chart::Lighting skyAlone() { return {"sky", view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}), {0, 1, 0}, {}, 0}; }

chart::Lighting sunAndSky() {
  return {"sun and sky", skyAlone().sky, normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}, 0};
}

chart::Lighting lampsAlone() { return {"lamps", {}, {0, 1, 0}, {}, 1}; }

}  // namespace ff::bench

namespace {

using namespace ff;

struct Measured {
  const char* scene;
  Result<void> (*measure)(const bench::AccuracyOptions&);
};
constexpr std::array<Measured, 5> kScenes{{{"town", bench::measureTown},
                                           {"staircase", bench::measureStaircase},
                                           {"dining-room", bench::measureDiningRoom},
                                           {"small_lamp", bench::measureSmallLamps},
                                           {"rooms", bench::measureLeaks}}};

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Measures the default settings against the truth."};
  bench::AccuracyOptions o;
  std::string keep;
  o.shared = FF_SHARED_SCENES;
  std::vector<std::string> scenes, names;
  for (const Measured& m : kScenes) names.emplace_back(m.scene);
  app.add_flag("--quick", o.quick, "smaller worlds, fewer observers, pixels and paths");
  app.add_option("--scenes", scenes, "some of town, staircase, dining-room, small_lamp, rooms; else all")
      ->delimiter(',')
      ->check(CLI::IsMember(names));
  app.add_option("--observers", o.observers, "spread over the surface")->check(CLI::Range(2, 1000))->capture_default_str();
  app.add_option("--world", o.world, "the town of 60,000 patches, baked already");
  app.add_option("--shared", o.shared, "the shared scenes")->capture_default_str();
  app.add_option("--keep", keep, "folder in which bakes of files stay, to be used again as long as their bake key is the same");
  CLI11_PARSE(app, argc, argv);
  if (o.quick) o.patch_budget = 8000, o.observers = 8;
  if (scenes.empty()) scenes = names;
  o.folder = keep.empty() ? std::filesystem::temp_directory_path() / ("ff_bench_accuracy_" + std::to_string(getpid())) : std::filesystem::path(keep);
  std::filesystem::create_directories(o.folder);
  Result<void> done;
  for (const Measured& m : kScenes)
    if (done && std::find(scenes.begin(), scenes.end(), m.scene) != scenes.end()) done = m.measure(o);
  if (keep.empty()) std::filesystem::remove_all(o.folder);
  if (done) return 0;
  bench::say("ff_bench_accuracy: " + done.error().line());
  return static_cast<int>(done.error().code);
}
