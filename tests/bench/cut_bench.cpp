// ff_bench_cut: what the cut costs in accuracy. Streams a world around several observers, solves the local matrix, and
// compares reflected radiosity with the double-precision solve of the whole world: same rows, sun and sky. At fixed distances around
// eyes in streets and rooms (cut_places.h), and within half the local radius, there beside everything outside as one constant, at its
// best value. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>

#include "formats/read/whole_world.h"
#include "tests/bench/cut_places.h"
#include "tests/bench/truth.h"

namespace {

using namespace ff;
using namespace ff::bench;
using namespace ff::runtime;

struct Options {
  std::string world;
  uint64_t patches = 60000;
  uint32_t rays = 4096;
  bool quick = false, lamps = false, verbose = false, fixed_only = false;
  int observers = 24, eyes = 32;
  float growth = stream::StreamSettings{}.growth;
  float radius_m = stream::StreamSettings{}.radius_m;
  uint32_t max_patches = stream::StreamSettings{}.max_level0_nodes;
};

struct Solved {
  Difference difference;
  uint32_t slots = 0, leaves = 0, level0 = 0;
  uint64_t matrix_bytes = 0, entries = 0;
  double build_ms = 0, iteration_ms = 0;
};

Solved solve(const formats::WholeWorld& world, const Truth& truth, const stream::Streamer& streamer, FarLight far_light,
             const Case& at) {
  Solved solved;
  solved.build_ms = 1e9;
  std::shared_ptr<const LocalMatrix> matrix;
  for (int repeat = 0; repeat < 3; ++repeat) {  // the fastest: others may be using the machine
    const auto began = Clock::now();
    matrix = std::make_shared<const LocalMatrix>(orExit(buildLocalMatrix(world, streamer.active(), far_light)));
    solved.build_ms = std::min(solved.build_ms, msSince(began));
  }
  std::vector<Vec4> source = sourceOf(truth, world, *matrix, streamer.active());
  if (far_light == FarLight::kConstant) source[matrix->ambient_slot] = meanOutside(truth, *matrix);
  const std::vector<Vec4> radiosity = convergedRadiosity(*matrix, source, &solved.iteration_ms);
  solved.difference = compare(truth, *matrix, radiosity, source, at);
  solved.slots = matrix->slots();
  for (uint32_t s = 0; s < matrix->slots(); ++s) solved.leaves += matrix->leaf[s];
  for (const SlotRange& range : matrix->tiles)
    if (range.id.level == 0) solved.level0 += range.nodes;
  solved.entries = matrix->used_entries;
  solved.matrix_bytes = matrix->used_entries * 4 + matrix->row_start.size() * 4 + matrix->row_scale.size() * 4;
  return solved;
}

void run(const Options& options) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_cut_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::WholeWorld world =
      orExit(formats::WholeWorld::open(options.world.empty() ? bakeTown(folder, options.quick, options.patches, options.rays) : options.world));
  const Truth truth = solveTruth(world, options.lamps);
  const CutSettings settings{options.radius_m, options.growth, options.max_patches};
  printFixedDistances(world, truth, settings, options.eyes);
  printCutChanges(world, truth, settings);
  if (options.fixed_only) {
    std::filesystem::remove_all(folder);
    return;
  }

  std::vector<double> pyramid, constant, bounced;
  Difference all_pyramid, all_constant;
  int dark = 0;
  double leaves = 0, bytes = 0, build_ms = 0, iteration_ms = 0, radius = 0;
  for (const Vec3 observer : observersOf(truth, options.observers, world.info().cell_m)) {
    const auto streamer = orExit(stream::Streamer::create(world, {.radius_m = options.radius_m,
                                                                  .growth = options.growth,
                                                                  .hysteresis = 1.0f,
                                                                  .max_level0_nodes = options.max_patches}));
    streamer->update(observer, {});
    orExit(streamer->settle());
    const Case at{observer, localRadius(truth, streamer->active(), observer)};
    const Solved p = solve(world, truth, *streamer, FarLight::kPyramid, at);
    const Solved c = solve(world, truth, *streamer, FarLight::kConstant, at);
    // A place without light has no relative error. The threshold is far below the dimmest room with a window.
    if (p.difference.meanTruth() < 1e-4 * truth.rms) {
      ++dark;
      continue;
    }
    pyramid.push_back(p.difference.relative());
    constant.push_back(c.difference.relative());
    bounced.push_back(p.difference.relativeBounced());
    all_pyramid += p.difference;
    all_constant += c.difference;
    leaves += p.leaves;
    bytes += static_cast<double>(p.matrix_bytes);
    build_ms += p.build_ms;
    iteration_ms += p.iteration_ms;
    radius += static_cast<double>(at.local_radius_m);
    if (options.verbose)
      std::cerr << "observer " << observer.x << " " << observer.y << " " << observer.z << ", " << p.level0
                << " patches active, all to " << at.local_radius_m << " m, " << p.difference.patches << " compared, "
                << p.leaves << " leaves of " << p.slots << " slots, " << p.entries << " entries, pyramid "
                << 100 * pyramid.back() << " % (of indirect " << 100 * bounced.back() << " %), constant "
                << 100 * constant.back() << " %, build " << p.build_ms << " ms, iteration " << p.iteration_ms
                << " ms\n";
  }
  std::filesystem::remove_all(folder);
  if (pyramid.empty()) {
    std::cerr << "ff_bench_cut: no observer sees light; bake a world that the sun reaches\n";
    std::exit(1);
  }
  const auto n = static_cast<double>(pyramid.size());
  for (double* sum : {&leaves, &bytes, &build_ms, &iteration_ms, &radius}) *sum /= n;

  const auto worst = [](const std::vector<double>& v) { return *std::max_element(v.begin(), v.end()); };
  const auto percent = [](double x) { return std::to_string(100 * x) + " %"; };
  const std::string name = std::to_string(world.levels()[0].nodes) + " patches, at most " +
                           std::to_string(options.max_patches) + " active, r_0 " + std::to_string(options.radius_m) +
                           " m, local radius " + std::to_string(radius) + " m, growth " +
                           std::to_string(options.growth) + (options.lamps ? ", sun, sky and lamps" : ", sun and sky");
  const auto note = [&](std::vector<double> each, const Difference& all) {
    return name + "; worst of " + std::to_string(each.size()) + " observers (" + std::to_string(dark) +
           " more stand in the dark), median " + percent(median(each)) + ", all patches together " +
           percent(all.relative()) + ", of indirect light alone " + percent(all.relativeBounced());
  };
  print("cut.error_inner_pyramid", worst(pyramid), "relative L2", 0.015, note(pyramid, all_pyramid));
  print("cut.error_inner_constant", worst(constant), "relative L2", 0.015, note(constant, all_constant));
  print("cut.active_nodes", leaves, "nodes", kMaxSlots, name + "; leaves of the cut, mean");
  print("cut.local_matrix_bytes", bytes, "B", std::nan(""),
        name + "; mean; built in " + std::to_string(build_ms) + " ms, one iteration " + std::to_string(iteration_ms) +
            " ms");
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"Accuracy of the cut: streamed against whole-world radiosity. One JSON object a line."};
  app.add_option("--world", options.world, "a baked world with drawing geometry; without it a town is baked");
  app.add_flag("--quick", options.quick, "a smaller town");
  app.add_option("--patches", options.patches, "of the town that is baked: 60000, 60k, 1M")
      ->transform(CLI::AsSizeValue(true))
      ->capture_default_str();
  app.add_option("--rays", options.rays, "a patch, of the town that is baked")->capture_default_str();
  app.add_flag("--fixed-only", options.fixed_only, "fixed distances and changes of the cut alone");
  app.add_option("--eyes", options.eyes, "for fixed distances, half in streets, half in rooms")->check(CLI::Range(2, 1000))->capture_default_str();
  app.add_flag("--lamps", options.lamps, "lamps are on, too");
  app.add_flag("--verbose", options.verbose, "a line per observer on standard error");
  app.add_option("--observers", options.observers)->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--growth", options.growth)->check(CLI::Range(1.0f, 8.0f))->capture_default_str();
  app.add_option("--radius", options.radius_m, "r_0, m")->capture_default_str();
  app.add_option("--max-patches", options.max_patches)->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  run(options);
  return 0;
}
