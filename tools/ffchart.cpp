// ffchart SCENE.glb -o FOLDER: speed against accuracy of a world, and the setting that is just enough.
#include <CLI/CLI.hpp>
#include <fmt/core.h>

#include <cmath>
#include <filesystem>
#include <string>
#include <thread>

#include "formats/read/whole_world.h"
#include "formats/version.h"
#include "tools/chart/answer.h"
#include "tools/chart/eyes.h"
#include "tools/chart/page/json_report.h"
#include "tools/chart/page/page.h"
#include "tools/chart/page/setting_charts.h"
#include "tools/chart/paper/paper.h"
#include "tools/chart/stability/stability.h"
#include "tools/chart/sweep/block_size.h"
#include "tools/chart/sweep/error_sources.h"
#include "tools/chart/sweep/heat_picture.h"
#include "tools/chart/sweep/seen.h"
#include "tools/chart/sweep/sweep.h"
#include "tools/chart/sweep/temporal.h"
#include "tools/run_tool.h"
#include "tools/view/camera.h"

namespace {

using namespace ff;

struct Options {
  chart::SweepOptions sweep;
  std::string camera, eyes, out, command, paper_scene;
  double target_percent = 3, budget_ms = 1, budget_mib = 256;
  bool stability = false, paper = false, keep_settings = false, json = false;
};

void say(const std::string& line) { fmt::print(stderr, "{}\n", line); }

// What people asked for: on stdout, unless a program reads that.
void tell(const Options& o, const std::string& line) { fmt::print(o.json ? stderr : stdout, "{}\n", line); }

// Observers: evenly over the path's time.
std::vector<chart::Place> placesOf(const view::CameraPath& path, int count) {
  std::vector<chart::Place> places;
  for (int i = 0; i < count; ++i) {
    const double t = path.start() + (path.end() - path.start()) * (i + 0.5) / count;
    places.push_back({path.at(t).eye, path.velocityAt(t), 0});
  }
  return places;
}

// The page, and what it leaves for the JSON.
Result<chart::JsonPage> write(chart::Report report, const Options& o, const std::string& name) {
  report.facts.emplace_back("command", o.command);
  const auto written = chart::writePage(report, o.out, name);
  if (!written) return written.error();
  if (!written->left_out.empty()) say(written->left_out);
  const std::string file = (std::filesystem::path(o.out) / (name + ".html")).string();
  tell(o, file);
  return chart::JsonPage{name, file, std::move(report)};
}

std::string percent(const chart::Figure& f) {
  return std::isfinite(f.error) ? fmt::format("{:.2f} ± {:.2f} %", 100 * f.value, 100 * f.error) : fmt::format("{:.2f} %", 100 * f.value);
}

std::string observersOf(const chart::Sweep& sweep) {
  const size_t all = sweep.placesOfAll(), own = sweep.places.size() - all;
  return fmt::format("{} observers", all) + (own > 0 ? fmt::format(", for {} at {} of its own", sweep.places.back().in_light, own) : "");
}

chart::Report reportOf(const Options& o, chart::Sweep& sweep) {
  chart::Report r;
  const formats::WholeWorld& world = sweep.world->world();
  const formats::WorldInfo& info = world.info();
  r.title = "Speed against accuracy: " + info.scene;
  r.settings = sweep.settings;
  r.sources = sweep.sources;
  for (const chart::ErrorSources& split : r.sources) r.tables.push_back(chart::tableOf(split, r.tables.size() + 1));
  r.facts = {{"world", fmt::format("{}: {} patches of {:.3g} m, {} levels", std::filesystem::path(sweep.world_path).filename().string(),
                                   world.levels()[0].nodes, static_cast<double>(info.cell_m), world.levels().size())},
             {"truth", fmt::format("path tracing on the scene's triangles, {} paths a patch; its own noise, taken off: {}",
                                   o.sweep.quick ? 1024 : 4096,
                                   [&] {
                                     std::string noise;
                                     for (size_t l = 0; l < sweep.lights.size(); ++l)
                                       noise += fmt::format("{}{} {:.1f} %", l ? ", " : "", sweep.lights[l].name,
                                                            100 * sweep.tracer_noise[l]);
                                     return noise;
                                   }())},
             {"error", "relative L2 of reflected radiosity over the surface within half the local radius of the default, at " +
                           observersOf(sweep) + "; ± is the jackknife's over observers"},
             {"machine", fmt::format("{} threads, CPU solvers", std::thread::hardware_concurrency())},
             {"seed", std::to_string(o.sweep.seed)}};
  return r;
}

// The answer first, then what else was found.
Result<std::vector<chart::Answered>> answer(chart::Report& r, const Options& o) {
  chart::Answered cheapest{fmt::format("cheapest with error <= {:.3g} %", o.target_percent), o.target_percent / 100, {}, {},
                           chart::cheapestWithin(r, o.target_percent / 100), ""};
  chart::Answered best{fmt::format("best within {:.3g} ms and {:.4g} MiB", o.budget_ms, o.budget_mib), {}, o.budget_ms,
                       o.budget_mib, chart::bestWithin(r, o.budget_ms, o.budget_mib), ""};
  for (const chart::Answered* a : {&cheapest, &best}) tell(o, a->asked + ": " + a->answer.line);
  r.lead = fmt::format("Cheapest with an error of at most {:.3g} % in every light: {}. Best within {:.3g} ms and {:.4g} MiB: {}. The default:",
                       o.target_percent, cheapest.answer.line, o.budget_ms, o.budget_mib, best.answer.line);
  for (const chart::Accuracy& a : r.settings.front().accuracy)
    r.lead += fmt::format(" {} {} (median {:.2f} %);", a.light, percent(a.rel_l2), 100 * a.median.value);
  r.lead.back() = '.';
  if (!o.keep_settings && cheapest.answer.setting) {
    const std::string& world = r.settings[*cheapest.answer.setting].world;
    const bool beside = formats::storageFor(world)->checkWritable(formats::folderOf(world)).has_value();
    auto written = chart::writeRecommendation(beside ? world : (std::filesystem::path(o.out) / formats::fileNameOf(world)).string(), r, *cheapest.answer.setting);
    if (!written) return written.error();
    cheapest.written = *written;
    tell(o, beside ? "auto takes it up from beside " + world : "auto takes it up once " + *written + " is copied beside " + world);
  }
  return std::vector{cheapest, best};
}

// How light that changes is followed, where the last light is brightest.
Result<void> addLag(chart::Report& r, const Options& o, chart::Sweep& sweep) {
  chart::Lighting dark;
  dark.name = "dark";
  const bool two = sweep.lights.size() > 1;
  const chart::Lighting &before = two ? sweep.lights[0] : dark, &after = sweep.lights[two ? 1 : 0];
  const auto lit = sweep.world->lit(after, sweep.standard.shadow_rays, nullptr);
  if (!lit) return lit.error();
  size_t best = 0;
  double most = -1;
  for (size_t at = 0; at < sweep.placesOfAll(); ++at) {
    double light = 0;
    for (const uint32_t number : sweep.world->ofPlace(at)) {
      const Vec3 b = (*lit)->traced[number].reflected;
      light += static_cast<double>(b.x + b.y + b.z);
    }
    if (light > most) most = light, best = at;
  }
  say("light that changes");
  auto temporal = chart::measureTemporal(*sweep.world, sweep.places[best], before, after,
                                         {.standard = sweep.standard, .quick = o.sweep.quick});
  if (!temporal) return temporal.error();
  r.charts.insert(r.charts.end(), temporal->charts.begin(), temporal->charts.end());
  r.tables.push_back(std::move(temporal->table));
  say("blocks of the dense matrix");
  auto blocks = chart::blockSizeChart(o.sweep.quick ? 256 : 1024, o.sweep.quick ? 5 : 9);
  if (!blocks) return blocks.error();
  r.charts.push_back(std::move(*blocks));
  return {};
}

// What eyes see of the default, in every light.
Result<void> addSeen(chart::Report& r, const Options& o, chart::Sweep& sweep) {
  say("what is seen");
  const auto eyes = chart::eyesOf(o.eyes == "found" ? "" : o.eyes, sweep.world->world());
  if (!eyes) return eyes.error();
  const chart::SeenSettings settings{.paths = o.sweep.quick ? 2'000'000u : 12'000'000u, .seed = o.sweep.seed};
  const chart::SeenPixels pixels = chart::lookAround(sweep.world->tracer(), *eyes, settings);
  for (const chart::Lighting& light : sweep.lights) {
    auto score = chart::scoreSeen(*sweep.world, pixels, light, sweep.standard, settings);
    if (!score) return score.error();
    r.seen.push_back(std::move(*score));
  }
  r.tables.push_back(chart::tableOf(r.seen));
  return {};
}

Result<chart::JsonPage> chartWorld(Options& o) {
  view::CameraPath path;
  std::array<double, 3> origin{};
  if (!o.sweep.world_path.empty())
    if (const auto world = formats::World::open(o.sweep.world_path)) {
      origin = world->info().origin;
      if (world->info().preview) std::cerr << "ffchart: warning: " << o.sweep.world_path << " is a preview (ffbake --preview): what is charted is that of few large patches and few rays\n";
    }
  if (!o.camera.empty()) {
    auto read = view::readCamera(o.camera, origin);
    if (!read) return read.error();
    path = std::move(*read);
    o.sweep.path = placesOf(path, o.sweep.observers);
  }
  const view::Sun sun = path.sun.value_or(view::Sun{normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}});
  const runtime::Sky sky = path.sky.value_or(view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}));
  o.sweep.lights.push_back({"sun and sky", sky, sun.to_sun, sun.irradiance, 0});
  o.sweep.lights.push_back({"lamps", {}, {0, 1, 0}, {}, 1});
  auto sweep = chart::runSweep(o.sweep, say);
  if (!sweep) return sweep.error();
  chart::Report report = reportOf(o, *sweep);
  auto answered = answer(report, o);
  if (!answered) return answered.error();
  report.charts = chart::settingCharts(report);
  if (!o.eyes.empty())
    if (auto scored = addSeen(report, o, *sweep); !scored) return scored.error();
  if (auto followed = addLag(report, o, *sweep); !followed) return followed.error();
  say("pictures of the worst places");
  auto pictures = chart::worstPlaces(*sweep->world, sweep->places, sweep->lights, sweep->standard,
                                     {.paths = o.sweep.quick ? 1024u : 4096u, .seed = o.sweep.seed}, o.out,
                                     {.paths = o.sweep.quick ? 200000u : 1000000u, .seed = o.sweep.seed});
  if (!pictures) return pictures.error();
  report.pictures = std::move(*pictures);
  auto page = write(std::move(report), o, "accuracy");
  if (page) page->answers = std::move(*answered);
  return page;
}

Result<void> run(Options& o) {
  if (o.sweep.scene_path.empty() && !o.stability && !o.paper)
    return Error{ErrorCode::kUsage, "", "scene", "there is none", "name a .glb or .gltf, or ask for --stability or --paper"};
  std::vector<chart::JsonPage> pages;
  const auto add = [&](Result<chart::JsonPage> page) -> Result<void> {
    if (!page) return page.error();
    pages.push_back(std::move(*page));
    return {};
  };
  if (!o.sweep.scene_path.empty())
    if (auto done = add(chartWorld(o)); !done) return done;
  if (o.stability) {
    auto report = chart::measureStability({.quick = o.sweep.quick, .seed = o.sweep.seed}, say);
    if (!report) return report.error();
    if (auto done = add(write(std::move(*report), o, "stability")); !done) return done;
  }
  if (o.paper) {
    auto report = chart::measurePaper({.scene_path = o.paper_scene, .quick = o.sweep.quick, .seed = o.sweep.seed}, say);
    if (!report) return report.error();
    if (auto done = add(write(std::move(*report), o, "paper")); !done) return done;
  }
  if (o.json) fmt::print("{}\n", chart::jsonDocument(FF_VERSION, o.command, pages));
  return {};
}

int run(int argc, char** argv) {
  CLI::App app{"Measures a world at many settings, charts speed against accuracy, and names the setting that is just enough."};
  app.set_version_flag("--version", std::string("ffchart ") + FF_VERSION);
  Options o;
  bool observers_given = false;
  app.add_option("scene", o.sweep.scene_path, "the scene, .glb or .gltf");
  app.add_option("-o,--out", o.out, "folder for the page, its charts and the worlds baked on the way")->required();
  app.add_option("--world", o.sweep.world_path, "a world baked from the scene, or its address behind a web server, taken as the default; else one is baked");
  app.add_option("--patch-size", o.sweep.cell_m, "of the default bake, m; else from --patch-budget")->check(CLI::PositiveNumber);
  app.add_option("--patch-budget", o.sweep.patch_budget, "patches of the default bake")->capture_default_str();
  app.add_option("--leave-out", o.sweep.leave_out, "material whose triangles take no part, as in ffbake (repeatable)");
  app.add_option("--camera", o.camera, "camera path (JSON) with sun and sky; without it observers are spread over the surface");
  app.add_option("--eyes", o.eyes, "score what is seen as well, from eyes along a camera path inside the rooms (JSON), or 'found'");
  auto* observers = app.add_option("--observers", o.sweep.observers, "how many")->check(CLI::Range(2, 1000))->capture_default_str();
  app.add_option("--target-error", o.target_percent, "name the cheapest setting with at most this error, %")->capture_default_str();
  app.add_option("--budget-ms", o.budget_ms, "name the most accurate setting that relights in this time ...")->capture_default_str();
  app.add_option("--budget-mib", o.budget_mib, "... and this memory")->capture_default_str();
  app.add_flag("--keep-settings", o.keep_settings, "do not write the answer beside the world (into the folder of -o where nothing can be written beside it, as behind a web server)");
  app.add_flag("--quick", o.sweep.quick, "fewer settings and paths: under two minutes for 60,000 patches");
  app.add_flag("--stability", o.stability, "another page: where methods break (needs no scene)");
  app.add_flag("--paper", o.paper, "another page: the seed paper's figures 3 and 4, ours beside theirs (needs no scene)");
  app.add_option("--paper-scene", o.paper_scene, "a scene of about 63,000 unit faces for --paper; a town is made besides");
  app.add_flag("--json", o.json, "print all that was measured as one JSON document; what is said to people goes to stderr");
  app.add_option("--seed", o.sweep.seed, "of bakes and path tracing")->capture_default_str();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    const int code = app.exit(e);
    return code == 0 ? 0 : static_cast<int>(ErrorCode::kUsage);
  }
  observers_given = observers->count() > 0;
  if (o.sweep.quick && !observers_given) o.sweep.observers = 6;
  o.command = "ffchart";
  for (int i = 1; i < argc; ++i) o.command += std::string(" ") + argv[i];
  o.sweep.folder = (std::filesystem::path(o.out) / "worlds").string();
  const auto ran = run(o);
  if (const std::string warning = formats::storageFor(o.sweep.world_path)->warning(); !warning.empty()) say("ffchart: warning: " + warning);
  if (!ran) {
    fmt::print(stderr, "ffchart: {}\n", ran.error().line());
    return static_cast<int>(ran.error().code);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffchart", argc, argv, run); }
