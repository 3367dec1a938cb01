// ff_bench_cut: what the cut costs in accuracy. Streams a world around several observers, solves the local matrix, and
// compares reflected radiosity within half the local radius with the double-precision solve of the whole world: same
// rows, sun and sky. Beside it the same with everything outside as one constant, at its best value. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <nlohmann/json.hpp>

#include "bake/bake.h"
#include "bake/gltf_import.h"
#include "runtime/full_solve.h"
#include "runtime/node_values.h"
#include "runtime/updater.h"
#include "tests/bench/sun_light.h"
#include "tools/scene_glb.h"
#include "tools/scene_town.h"

namespace {

using namespace ff;
using namespace ff::runtime;
using Clock = std::chrono::steady_clock;

struct Options {
  std::string world;
  bool quick = false, lamps = false, verbose = false;
  int observers = 24;
  float growth = stream::StreamSettings{}.growth;
  float radius_m = stream::StreamSettings{}.radius_m;
  uint32_t max_patches = 4096;
};

template <class T>
T orExit(Result<T> result) {
  if (!result) {
    std::cerr << "ff_bench_cut: " << result.error().line() << "\n";
    std::exit(static_cast<int>(result.error().code));
  }
  return std::move(*result);
}
void orExit(const Result<void>& result) {
  if (result) return;
  std::cerr << "ff_bench_cut: " << result.error().line() << "\n";
  std::exit(static_cast<int>(result.error().code));
}
double msSince(Clock::time_point t) { return std::chrono::duration<double, std::milli>(Clock::now() - t).count(); }

void print(const char* metric, double value, const char* unit, double limit, const std::string& note) {
  nlohmann::json j{{"metric", metric}, {"value", value}, {"unit", unit}, {"note", note}};
  j["limit"] = std::isfinite(limit) ? nlohmann::json(limit) : nlohmann::json(nullptr);
  std::cout << j.dump() << std::endl;
}

std::string bakeTown(const std::filesystem::path& folder, bool quick) {
  const std::string scene = (folder / "town.glb").string(), world = (folder / "town.ffm").string();
  const tools::Town town = orExit(tools::makeTown({.patches = quick ? 8000u : 60000u}));
  orExit(tools::writeGlb(tools::townModel(town, false), scene));
  (void)orExit(bake::bakeWorld(orExit(bake::importGltf(scene)), {.cell_m = 1}, world));
  return world;
}

// Everything that does not depend on the observer.
struct Truth {
  std::vector<formats::Strip> patches;  // by level-0 tile
  std::vector<float> areas_m2;
  NodeValues sun;  // irradiance, all levels
  Sky sky{{1.1f, 1.4f, 1.9f}, {{0, 0.4f, 0}, {0, 0.5f, 0}, {0, 0.7f, 0}}};
  std::vector<double> radiosity;  // 3 per patch
  double rms = 0;                 // of radiosity, over patches and channels
  bool lamps = false;

  Vec3 source(const formats::Node& node, Vec3 direct) const {
    return (lamps ? node.emission : Vec3{}) + node.albedo * (direct + skyIrradiance(sky, node));
  }
};

Truth solveTruth(const formats::World& world, bool lamps) {
  Truth t;
  t.lamps = lamps;
  const std::vector<Vec3> sun =
      orExit(bench::sunIrradiance(world, normalized({0.4f, 0.8f, 0.3f}), {13.0f, 11.8f, 9.6f}));
  t.areas_m2 = orExit(patchAreas(world));
  t.sun = aggregateUp(world, t.areas_m2, sun);
  std::vector<double> source;
  for (const formats::TileInfo& info : world.tiles(0)) {
    t.patches.push_back(orExit(world.strip(info.id)));
    for (uint32_t i = 0; i < info.nodes; ++i) {
      const Vec3 m = t.source(t.patches.back().nodes[i], sun[info.first_node + i]);
      for (int c = 0; c < 3; ++c) source.push_back(static_cast<double>(m[c]));
    }
  }
  t.radiosity = orExit(solveFullWorld(world, source)).radiosity;
  for (const double b : t.radiosity) t.rms += b * b;
  t.rms = std::sqrt(t.rms / static_cast<double>(t.radiosity.size()));
  return t;
}

// Sums over patches and channels of a comparison with the truth.
struct Difference {
  double reflected = 0, reflected_truth = 0;  // squares; emission aside
  double bounced = 0;                         // squares of the truth's indirect part alone
  uint32_t patches = 0;
  double meanTruth() const { return patches ? std::sqrt(reflected_truth / (3.0 * patches)) : 0; }
  double relative() const { return std::sqrt(reflected / reflected_truth); }
  Difference& operator+=(const Difference& b) {
    reflected += b.reflected;
    reflected_truth += b.reflected_truth;
    bounced += b.bounced;
    patches += b.patches;
    return *this;
  }
  double relativeBounced() const { return std::sqrt(reflected / bounced); }
};

struct Case {
  Vec3 observer;
  float local_radius_m = 0;  // to the nearest patch that is not active
};

float localRadius(const Truth& truth, std::span<const stream::StripPtr> active, Vec3 observer) {
  std::vector<bool> in(truth.patches.size(), false);
  for (const auto& strip : active)
    if (strip->id.level == 0) in[strip->id.tile] = true;
  float radius = 1e30f;
  for (const formats::Strip& strip : truth.patches)
    for (const formats::Node& node : strip.nodes)
      if (!in[strip.id.tile]) radius = std::min(radius, length(node.centroid - observer));
  return radius;
}

// radiosity: by slot; level-0 tiles come first in both kinds of matrix.
Difference compare(const Truth& truth, const LocalMatrix& matrix, std::span<const Vec4> radiosity,
                   std::span<const Vec4> source, const Case& at) {
  Difference d;
  for (const SlotRange& range : matrix.tiles) {
    if (range.id.level != 0) break;
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = truth.patches[range.id.tile].nodes[i];
      if (length(node.centroid - at.observer) > at.local_radius_m / 2) continue;
      ++d.patches;
      const Vec4 b = radiosity[range.first_slot + i], m = source[range.first_slot + i];
      const double x[3] = {b.x, b.y, b.z}, direct[3] = {m.x, m.y, m.z};
      for (int c = 0; c < 3; ++c) {
        const double full = truth.radiosity[3 * size_t{range.first_node + i} + static_cast<size_t>(c)];
        const double emitted = truth.lamps ? static_cast<double>(node.emission[c]) : 0;
        d.reflected += (x[c] - full) * (x[c] - full);
        d.reflected_truth += (full - emitted) * (full - emitted);
        d.bounced += (full - direct[c]) * (full - direct[c]);
      }
    }
  }
  return d;
}

// The best constant for the outside: the area-weighted mean radiosity of the patches that are not active.
Vec4 meanOutside(const Truth& truth, const LocalMatrix& matrix) {
  std::vector<bool> inside(truth.areas_m2.size(), false);
  for (const SlotRange& range : matrix.tiles)
    if (range.id.level == 0) std::fill_n(inside.begin() + range.first_node, range.nodes, true);
  double area = 0, sum[3] = {0, 0, 0};
  for (size_t i = 0; i < inside.size(); ++i) {
    if (inside[i]) continue;
    area += static_cast<double>(truth.areas_m2[i]);
    for (size_t c = 0; c < 3; ++c) sum[c] += static_cast<double>(truth.areas_m2[i]) * truth.radiosity[3 * i + c];
  }
  if (area == 0) return {};
  return {static_cast<float>(sum[0] / area), static_cast<float>(sum[1] / area), static_cast<float>(sum[2] / area), 0};
}

struct Solved {
  Difference difference;
  uint32_t slots = 0, leaves = 0, level0 = 0;
  uint64_t matrix_bytes = 0, entries = 0;
  double build_ms = 0, iteration_ms = 0;
};

Solved solve(const formats::World& world, const Truth& truth, const stream::Streamer& streamer, FarLight far_light,
             const Case& at) {
  Solved solved;
  solved.build_ms = 1e9;
  std::shared_ptr<const LocalMatrix> matrix;
  for (int repeat = 0; repeat < 3; ++repeat) {  // the fastest: others may be using the machine
    const auto began = Clock::now();
    matrix = std::make_shared<const LocalMatrix>(orExit(buildLocalMatrix(world, streamer.active(), far_light)));
    solved.build_ms = std::min(solved.build_ms, msSince(began));
  }
  std::vector<Vec4> source(matrix->slots()), radiosity(matrix->slots());
  size_t t = 0;
  for (const auto& strip : streamer.active()) {
    if (t == matrix->tiles.size() || matrix->tiles[t].id != strip->id) continue;
    const SlotRange& range = matrix->tiles[t++];
    const std::span<const Vec3> sun = truth.sun.tile(world, range.id);
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const Vec3 m = truth.source(strip->nodes[i], sun[i]);
      source[range.first_slot + i] = {m.x, m.y, m.z, 0};
    }
  }
  if (far_light == FarLight::kConstant) source[matrix->ambient_slot] = meanOutside(truth, *matrix);
  const auto solver = makeCpuGather();
  orExit(solver->update(*matrix, {.any = true, .renumbered = true}));
  orExit(solver->setRadiosity(source));
  orExit(solver->setSource(source));
  constexpr int kIterations = 200;  // albedo <= 0.9 and half of the light leaves for the sky: converged to fp32
  orExit(solver->iterate(kIterations));
  orExit(solver->radiosity(radiosity));
  solved.iteration_ms = solver->lastMs() / kIterations;
  solved.difference = compare(truth, *matrix, radiosity, source, at);
  solved.slots = matrix->slots();
  for (uint32_t s = 0; s < matrix->slots(); ++s) solved.leaves += matrix->leaf[s];
  for (const SlotRange& range : matrix->tiles)
    if (range.id.level == 0) solved.level0 += range.nodes;
  solved.entries = matrix->used_entries;
  solved.matrix_bytes = matrix->used_entries * 4 + matrix->row_start.size() * 4 + matrix->row_scale.size() * 4;
  return solved;
}

// Eyes half a cell off patches that are spread evenly over the world's order: streets, fields, roofs and rooms.
std::vector<Vec3> observersOf(const Truth& truth, int count, float cell_m) {
  std::vector<Vec3> observers;
  for (int k = 0; k < count; ++k) {
    const size_t patch = truth.areas_m2.size() * (2 * static_cast<size_t>(k) + 1) / (2 * static_cast<size_t>(count));
    for (const formats::Strip& strip : truth.patches)
      if (patch >= strip.first_node && patch < strip.first_node + strip.nodes.size()) {
        const formats::Node& node = strip.nodes[patch - strip.first_node];
        observers.push_back(node.centroid + node.normal * (0.5f * cell_m));
      }
  }
  return observers;
}

void run(const Options& options) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_cut_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const formats::World world =
      orExit(formats::World::open(options.world.empty() ? bakeTown(folder, options.quick) : options.world));
  const Truth truth = solveTruth(world, options.lamps);

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
  const auto median = [](std::vector<double> v) {
    std::sort(v.begin(), v.end());
    return v[v.size() / 2];
  };
  const auto percent = [](double x) { return std::to_string(100 * x) + " %"; };
  const std::string name = std::to_string(world.levels()[0].nodes) + " patches, at most " +
                           std::to_string(options.max_patches) + " active, r_0 " + std::to_string(options.radius_m) +
                           " m, local radius " + std::to_string(radius) + " m, growth " +
                           std::to_string(options.growth) + (options.lamps ? ", sun, sky and lamps" : ", sun and sky");
  const auto note = [&](const std::vector<double>& each, const Difference& all) {
    return name + "; worst of " + std::to_string(each.size()) + " observers (" + std::to_string(dark) +
           " more stand in the dark), median " + percent(median(each)) + ", all patches together " +
           percent(all.relative()) + ", of indirect light alone " + percent(all.relativeBounced());
  };
  print("cut.error_inner_pyramid", worst(pyramid), "relative L2", 0.015, note(pyramid, all_pyramid));
  print("cut.error_inner_constant", worst(constant), "relative L2", 0.015, note(constant, all_constant));
  print("cut.active_nodes", leaves, "nodes", 65536, name + "; leaves of the cut, mean");
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
  app.add_flag("--lamps", options.lamps, "let emission shine too");
  app.add_flag("--verbose", options.verbose, "a line per observer on standard error");
  app.add_option("--observers", options.observers)->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--growth", options.growth)->check(CLI::Range(1.0f, 8.0f))->capture_default_str();
  app.add_option("--radius", options.radius_m, "r_0, m")->capture_default_str();
  app.add_option("--max-patches", options.max_patches)->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  run(options);
  return 0;
}
