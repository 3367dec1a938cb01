// ff_bench_adaptive: what merged patches save, and what they cost: a scene baked with and without them, against the truth at the same points. Eyes stand
// on the ground, in the open if nothing else is asked for; of the surface that they see, pieces of one unmerged patch each are compared. What is compared is the light that a patch gives to a
// picture: all but the sun's own, which pictures draw point by point. Prints JSON lines.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "bake/import/gltf_import.h"
#include "tests/bench/truth.h"
#include "tools/chart/kept_bake.h"
#include "tools/chart/sweep/measured_world.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"
#include "tools/view/camera.h"

namespace {

using namespace ff;

constexpr float kEyeHeight = 1.7f;  // m, or so many cells where they are larger
constexpr float kAbove = 0.01f;       // cells, that a surface is looked at from
constexpr uint32_t kShadowRays = 64;

struct Options {
  std::string file;  // empty: a town
  float cell_m = 1;
  uint32_t rays = 512, eyes = 16, looks = 2048, pieces = 2000, paths = 512;
  double least_sky = 0.3, most_sky = 1;  // over an eye's ground, of the hemisphere
  std::vector<double> errors{0, 2, 5};   // per cent
  std::string keep;
};

// Points that lie on one unmerged patch each.
using Pieces = std::vector<chart::SeenSurface>;

// The patch that a point, which is lifted off the surface, lies over.
uint32_t patchUnder(const chart::MeasuredWorld& world, const chart::SeenPoint& p) {
  return world.tracer().patchSeen(p.point + p.normal * (kAbove * world.world().info().cell_m), p.normal * -1);
}

Pieces lookAround(const chart::MeasuredWorld& world, const Options& o) {
  std::vector<const formats::Node*> ground;
  for (const formats::Node& n : world.patches())
    if (const auto sky = static_cast<double>(n.sky_fraction); n.normal.y > 0.7f && sky >= o.least_sky && sky <= o.most_sky) ground.push_back(&n);
  std::map<uint32_t, std::vector<chart::SeenPoint>> of_patch;
  for (uint32_t k = 0; k < o.eyes && !ground.empty(); ++k) {
    const formats::Node& n = *ground[ground.size() * (2 * k + 1) / (2 * o.eyes)];
    const Vec3 eye = n.centroid + Vec3{0, kEyeHeight * std::max(1.0f, o.cell_m), 0};
    for (const chart::SeenPoint& p : world.tracer().lookFrom(eye, o.looks).points)
      if (p.patch != chart::PathTracer::kNoPatch && patchUnder(world, p) == p.patch) of_patch[p.patch].push_back(p);
  }
  Pieces pieces;
  size_t at = 0;
  for (auto& [patch, seen] : of_patch) {
    const size_t n = at++;
    if (of_patch.size() > o.pieces && n * o.pieces / of_patch.size() == (n + 1) * o.pieces / of_patch.size()) continue;
    pieces.push_back({std::move(seen), o.paths});
  }
  return pieces;
}

// Of each piece what the world's patches give it, but for the sun's own light.
std::vector<Vec3> given(chart::MeasuredWorld& world, const Pieces& pieces, const chart::Lighting& light) {
  const chart::LitWorld& lit = *bench::orExit(world.lit(light, kShadowRays, nullptr));
  std::vector<Vec3> all;
  for (const chart::SeenSurface& piece : pieces) {
    Vec3 sum;
    float points = 0;
    for (const chart::SeenPoint& p : piece.points) {
      const uint32_t patch = patchUnder(world, p);
      if (patch == chart::PathTracer::kNoPatch) continue;
      const Vec3 sun = lit.sun.mean[0][patch];
      for (int c = 0; c < 3; ++c) sum[c] += static_cast<float>(lit.irradiance[3 * size_t{patch} + static_cast<size_t>(c)]) - sun[c];
      points += 1;
    }
    all.push_back(points > 0 ? sum / points : sum);
  }
  return all;
}

struct Error {
  double rel_l2 = 0, median = 0, p99 = 0;
};
// noise: variance of `truth`, taken off the mean; empty: none. Of a piece: over what it gets, or over the mean where that is more.
Error errorOf(const std::vector<Vec3>& got, const std::vector<Vec3>& truth, const std::vector<double>& noise) {
  double wrong = 0, all = 0;
  for (size_t k = 0; k < got.size(); ++k) {
    const Vec3 d = got[k] - truth[k];
    wrong += static_cast<double>(dot(d, d)) - (noise.empty() ? 0 : noise[k]);
    all += static_cast<double>(dot(truth[k], truth[k]));
  }
  const double mean = std::sqrt(all / static_cast<double>(got.size()));
  std::vector<double> own;
  for (size_t k = 0; k < got.size(); ++k)
    own.push_back(static_cast<double>(length(got[k] - truth[k])) / std::max(mean, static_cast<double>(length(truth[k]))));
  std::sort(own.begin(), own.end());
  return {std::sqrt(std::max(0.0, wrong) / all), own[own.size() / 2], own[own.size() * 99 / 100]};
}

uint64_t bytesOf(const formats::WholeWorld& world, uint32_t kind) {
  uint64_t bytes = 0;
  for (const formats::ShardInfo& shard : world.shards())
    if (static_cast<uint32_t>(shard.kind) == kind) bytes += shard.bytes;
  return bytes;
}

void measure(const bake::Scene& scene, const std::string& name, const Options& o) {
  const std::array<chart::Lighting, 2> lights{{{"sky", view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}), {0, 1, 0}, {}, 0},
                                               {"sun and sky", view::skyOf({1.1f, 1.4f, 1.9f}, {0.4f, 0.5f, 0.7f}), normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}, 0}}};
  std::optional<Pieces> pieces;
  std::array<std::vector<Vec3>, 2> truth, unmerged;
  std::array<std::vector<double>, 2> noise;
  for (const double percent : o.errors) {
    const auto baked = bench::orExit(chart::keptBake(scene, {.cell_m = o.cell_m, .rays = o.rays, .merge_error = static_cast<float>(percent / 100)},
                                                     fmt::format("{}/{}_{}.ffm", o.keep, name, percent)));
    auto world = bench::orExit(chart::MeasuredWorld::open(scene, baked.path));
    const double area = world.world().info().area_m2;
    const auto say = [&](const std::string& metric, double value, const char* unit, const std::string& note = {}) {
      std::cout << nlohmann::json{{"metric", "adaptive." + metric}, {"value", value}, {"unit", unit}, {"limit", nullptr}, {"scene", name}, {"merged_within", percent / 100}, {"note", note}}.dump()
                << std::endl;
    };
    say("patches", static_cast<double>(world.patches().size()), "");
    say("row_bytes_per_m2", static_cast<double>(bytesOf(world.world(), 0) + bytesOf(world.world(), 2)) / area, "B/m2", fmt::format("rows of all levels and index; {:.0f} m2 of surface", area));
    say("geometry_bytes_per_m2", static_cast<double>(bytesOf(world.world(), 1)) / area, "B/m2");
    if (baked.made) say("bake_s", baked.seconds, "s");
    if (!pieces) pieces = lookAround(world, o);
    for (size_t l = 0; l < lights.size(); ++l) {
      if (truth[l].empty())
        for (const chart::PatchTruth& t : world.tracer().traceSeen(*pieces, lights[l], 1)) {
          truth[l].push_back(t.irradiance - t.sun);
          noise[l].push_back(static_cast<double>(dot(t.irradiance_error, t.irradiance_error)));
        }
      const std::vector<Vec3> got = given(world, *pieces, lights[l]);
      if (unmerged[l].empty()) unmerged[l] = got;
      const Error error = errorOf(got, truth[l], noise[l]), change = errorOf(got, unmerged[l], {});
      const std::string note = fmt::format("{}, {} pieces of surface seen from {} eyes; the median has the tracer's noise in it", lights[l].name, got.size(), o.eyes);
      const std::string suffix = l == 0 ? "sky" : "sun_sky";
      say("error_" + suffix, error.rel_l2, "relative", note);
      say("error_" + suffix + "_median", error.median, "relative", note);
      say("change_" + suffix, change.rel_l2, "relative", "against the first bake; " + note);
      say("change_" + suffix + "_p99", change.p99, "relative", "against the first bake; " + note);
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Measures what merged patches save and cost."};
  Options o;
  bool quick = false;
  app.add_flag("--quick", quick, "a smaller town");
  app.add_option("--file", o.file, "a scene; else a voxel town");
  app.add_option("--patch-size", o.cell_m, "m")->capture_default_str();
  app.add_option("--rays", o.rays, "a patch")->capture_default_str();
  app.add_option("--errors", o.errors, "that patches are merged within, %; 0: none are; the first is what the others are compared with")->delimiter(',')->capture_default_str();
  app.add_option("--eyes", o.eyes, "on open ground")->capture_default_str();
  app.add_option("--least-sky", o.least_sky, "over an eye's ground: 0 for rooms")->capture_default_str();
  app.add_option("--most-sky", o.most_sky, "likewise: 0.1 for rooms")->capture_default_str();
  app.add_option("--paths", o.paths, "of the tracer, a piece of surface")->capture_default_str();
  app.add_option("--keep", o.keep, "folder in which the bakes stay");
  CLI11_PARSE(app, argc, argv);
  const bool kept = !o.keep.empty();
  if (!kept) o.keep = std::filesystem::temp_directory_path() / ("ff_bench_adaptive_" + std::to_string(getpid()));
  std::filesystem::create_directories(o.keep);
  if (o.file.empty()) {
    o.file = o.keep + "/town.glb";
    bench::orExit(tools::writeGlb(tools::townModel(bench::orExit(tools::makeTown({.patches = quick ? 8000u : 60000u})), false), o.file));
  }
  const bake::Scene scene = bench::orExit(bake::importGltf(o.file));
  measure(scene, std::filesystem::path(o.file).stem(), o);
  if (!kept) std::filesystem::remove_all(o.keep);
  return 0;
}
