// What is seen from inside rooms: of the dining room, and of rooms without a window.
#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "bake/import/gltf_import.h"
#include "stream/streamer.h"
#include "tests/bench/accuracy.h"
#include "tools/chart/eyes.h"
#include "tools/chart/kept_bake.h"

namespace ff::bench {
namespace {

// Of the rays of all eyes, for a patch to count as seen: drawing geometry may lie a fraction of a millimetre off.
constexpr int kFewestRays = 16;

struct Leak {
  double mean = 0, worst = 0;  // share of open ground
};

// The middle sees all of a room that is a box; the corners see what lies along its edges.
Result<Leak> leakInside(const bake::Scene& scene, const std::string& path, const Box& room) {
  auto world = chart::MeasuredWorld::open(scene, path);
  if (!world) return world.error();
  const chart::Lighting uniform{"uniform sky", {{1, 1, 1}, {}}, {0, 1, 0}, {}, 0};
  const auto lit = world->lit(uniform, 16, nullptr);
  if (!lit) return lit.error();
  const auto share = [&](const chart::SeenPoint& p) {
    return p.patch == chart::PathTracer::kNoPatch ? 0.0 : (*lit)->irradiance[3 * size_t{p.patch} + 1] / std::numbers::pi;
  };
  const Vec3 middle = (room.lo + room.hi) / 2, half = (room.hi - room.lo) / 2;
  Leak leak;
  double area = 0;
  std::map<uint32_t, int> rays;
  for (int k = 0; k < 9; ++k) {
    const Vec3 way = k == 8 ? Vec3{} : Vec3{k & 1 ? 0.9f : -0.9f, k & 2 ? 0.9f : -0.9f, k & 4 ? 0.9f : -0.9f};
    const Vec3 eye = middle + way * half;
    for (const chart::SeenPoint& p : world->tracer().lookFrom(eye, 65536).points) {
      if (++rays[p.patch] == kFewestRays) leak.worst = std::max(leak.worst, share(p));
      if (k != 8) continue;
      // A ray's share of the area: r^2 / cos.
      const Vec3 to = p.point - eye;
      const auto r = static_cast<double>(length(to)), w = r * r * r / std::abs(static_cast<double>(dot(to, p.normal)));
      leak.mean += w * share(p);
      area += w;
    }
  }
  leak.mean /= area;
  return leak;
}

}  // namespace

chart::SeenSettings seenSettings(const AccuracyOptions& o) {
  return {.pixels = o.quick ? 128u : 512u, .paths = o.quick ? 1'000'000u : 32'000'000u};
}

Result<void> printSeen(chart::MeasuredWorld& world, std::span<const Vec3> eyes, const chart::Lighting& light, const std::string& metric,
                       const std::string& scene, const SeenLimits& limits, const chart::SeenSettings& settings) {
  const formats::WorldInfo& info = world.world().info();
  chart::Knobs standard;
  standard.bake = {info.cell_m, info.rays, info.quanta};
  standard.radius_m = stream::StreamSettings{}.radius_m * info.cell_m;
  const auto score = chart::scoreSeen(world, chart::lookAround(world.tracer(), eyes, settings), light, standard, settings);
  if (!score) return score.error();
  const chart::Accuracy &got = score->streamed, &full = score->full_solve;
  const std::string note = fmt::format(
      "irradiance of {} pixels of {} patches (the world has {}) from {} eyes against path tracing at the points seen; median over a pixel's own truth {:.4f}; the full solve: median {:.4f}, bias "
      "{:+.4f}, rel. L2 {:.4f}; streamed against it {:.4f}; tracer's own noise {:.4f} (taken off, but not of the median); {:.4f} of the points have no patch",
      score->pixels, score->patches, world.patches().size(), score->eyes, score->own_median, full.median.value, full.energy.value, full.rel_l2.value,
      got.full_solve_rel_l2.value, score->tracer_noise, score->not_drawn);
  printFigure(metric + "_median", scene, got.median, limits.median, note);
  printFigure(metric + "_bias", scene, got.energy, limits.bias, note);
  printFigure(metric + "_rel_l2", scene, got.rel_l2, limits.rel_l2, note);
  return {};
}

Result<void> measureDiningRoom(const AccuracyOptions& o) {
  const std::filesystem::path file = o.shared / "dining-room/dining-room.glb";
  if (!isThere(file)) return {};
  const auto scene = bake::importGltf(file.string());
  if (!scene) return scene.error();
  const auto baked = chart::keptBake(*scene, {.patch_budget = o.patch_budget}, (o.folder / fmt::format("dining-room_{}.ffm", o.patch_budget)).string());
  if (!baked) return baked.error();
  if (baked->made) say(fmt::format("baked dining-room in {:.1f} s", baked->seconds));
  auto world = chart::MeasuredWorld::open(*scene, baked->path);
  if (!world) return world.error();
  const auto eyes = chart::eyesOf((o.shared / "dining-room/dining.cam.json").string(), world->world());
  if (!eyes) return eyes.error();
  const chart::SeenSettings settings = seenSettings(o);
  if (auto r = printSeen(*world, *eyes, skyAlone(), "accuracy.seen_sky", "dining-room", {0.03, 0.02, 0.10}, settings); !r) return r;
  return printSeen(*world, *eyes, sunAndSky(), "accuracy.seen_sun_sky", "dining-room", {.median = 0.04}, settings);
}

Result<void> measureLeaks(const AccuracyOptions& o) {
  // Both stand around the same air.
  const Box room{{-1.9629f, 0, -1.9629f}, {2.0371f, 3, 2.0371f}};
  chart::Figure mean{0, 0}, worst{0, 0};
  std::string all;
  for (const char* name : {"room_sheet", "room_thick30"}) {
    const std::filesystem::path file = o.shared / fmt::format("trials/{}.glb", name);
    if (!isThere(file)) return {};
    const auto scene = bake::importGltf(file.string());
    if (!scene) return scene.error();
    for (const float cell : {0.25f, 1.0f}) {
      const auto baked = chart::keptBake(*scene, {.cell_m = cell}, (o.folder / fmt::format("{}_{}.ffm", name, static_cast<double>(cell))).string());
      if (!baked) return baked.error();
      const auto leak = leakInside(*scene, baked->path, room);
      if (!leak) return leak.error();
      mean.value = std::max(mean.value, leak->mean);
      worst.value = std::max(worst.value, leak->worst);
      all += fmt::format("{}{}, {} m: {:.5f}, worst patch {:.4f}", all.empty() ? "" : "; ", name, static_cast<double>(cell), leak->mean, leak->worst);
    }
  }
  const std::string note = "irradiance inside over that of open ground, uniform sky, patches seen from inside, mean by area; " + all;
  printFigure("accuracy.leak_inside", "rooms", mean, 0.0005, note);
  printFigure("accuracy.leak_inside_worst_patch", "rooms", worst, 0.01, note);
  return {};
}

}  // namespace ff::bench
