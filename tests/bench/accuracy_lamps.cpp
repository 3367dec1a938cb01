// Small lamps under the ceiling of a large hall, which no patch's few samples would find.
#include <fmt/core.h>

#include <algorithm>
#include <cmath>

#include "tests/bench/accuracy.h"
#include "tools/chart/kept_bake.h"
#include "tools/chart/truth/area_light.h"

namespace ff::bench {
namespace {

// As ../shared/scenes/trials/small_lamp.glb: 16 x 6 x 16 m, square lamps 5 cm under the ceiling that shine down alone, at 1000
// W/(m2 sr). One stands nearly in the middle, twenty in a grid.
struct Hall {
  std::string name;
  float lamp_m = 0.2f, albedo = 0;
  int rows = 1, columns = 1;  // of lamps
  uint32_t budget_share = 4;  // of the patch budget: one over this
};

constexpr Vec3 kLow{-8, 0, -8}, kHigh{8, 6, 8};
constexpr float kLampHeight = 5.95f;

void addQuad(bake::Scene& s, Vec3 a, Vec3 b, Vec3 c, Vec3 d, uint32_t material) {
  const auto first = static_cast<uint32_t>(s.positions.size());
  for (const Vec3 p : {a, b, c, d}) s.positions.push_back(p);
  s.triangles.push_back({{first, first + 1, first + 2}, material});
  s.triangles.push_back({{first, first + 2, first + 3}, material});
}

bake::Scene sceneOf(const Hall& hall) {
  bake::Scene s;
  s.name = hall.name;
  s.materials.push_back({.name = "wall", .base_color = {hall.albedo, hall.albedo, hall.albedo}, .metallic = 0, .emission = {}});
  s.materials.push_back({.name = "lamp", .base_color = {}, .metallic = 0, .emission = {1000, 1000, 1000}});
  const auto at = [](int x, int y, int z) { return Vec3{x ? kHigh.x : kLow.x, y ? kHigh.y : kLow.y, z ? kHigh.z : kLow.z}; };
  addQuad(s, at(0, 0, 0), at(0, 0, 1), at(1, 0, 1), at(1, 0, 0), 0);
  addQuad(s, at(0, 1, 0), at(1, 1, 0), at(1, 1, 1), at(0, 1, 1), 0);
  addQuad(s, at(0, 0, 0), at(0, 1, 0), at(0, 1, 1), at(0, 0, 1), 0);
  addQuad(s, at(1, 0, 0), at(1, 0, 1), at(1, 1, 1), at(1, 1, 0), 0);
  addQuad(s, at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0), 0);
  addQuad(s, at(0, 0, 1), at(0, 1, 1), at(1, 1, 1), at(1, 0, 1), 0);
  const Vec3 size = kHigh - kLow;
  for (int i = 0; i < hall.rows; ++i)
    for (int j = 0; j < hall.columns; ++j) {
      const float x = kLow.x + size.x * (static_cast<float>(i) + 0.5f) / static_cast<float>(hall.rows) + 0.25f,
                  z = kLow.z + size.z * (static_cast<float>(j) + 0.5f) / static_cast<float>(hall.columns) + 0.25f, h = hall.lamp_m / 2;
      addQuad(s, {x - h, kLampHeight, z - h}, {x + h, kLampHeight, z - h}, {x + h, kLampHeight, z + h}, {x - h, kLampHeight, z + h}, 1);
    }
  return s;
}

// Irradiance of every patch that the lamps shine on, in black walls.
Result<void> measureBlackHall(const Hall& hall, const AccuracyOptions& o) {
  const bake::Scene scene = sceneOf(hall);
  const auto baked = chart::keptBake(scene, {.patch_budget = o.patch_budget / hall.budget_share}, (o.folder / (hall.name + ".ffm")).string());
  if (!baked) return baked.error();
  auto world = chart::MeasuredWorld::open(scene, baked->path);
  if (!world) return world.error();
  const auto lit = world->lit(lampsAlone(), 16, nullptr);
  if (!lit) return lit.error();
  const auto truth = chart::AreaLight(scene).irradianceOfPatches(world->world());
  if (!truth) return truth.error();
  double wrong = 0, squares = 0, got = 0, known = 0;
  size_t unlit = 0;
  std::vector<double> errors;
  for (size_t p = 0; p < truth->size(); ++p) {
    const auto t = static_cast<double>((*truth)[p].y), x = (*lit)->irradiance[3 * p + 1], area = static_cast<double>(world->areasM2()[p]);
    if (!(t > 0)) continue;
    wrong += area * (x - t) * (x - t);
    squares += area * t * t;
    got += area * x;
    known += area * t;
    unlit += x > 0 ? 0 : 1;
    errors.push_back(std::abs(x - t) / t);
  }
  std::sort(errors.begin(), errors.end());
  const std::string note = fmt::format(
      "irradiance of {} patches of floor and walls, full solve, against the closed form; {} lamps of {:.3g} cm; energy {:+.4f}; {} patches get nothing", errors.size(),
      hall.rows * hall.columns, 100 * static_cast<double>(hall.lamp_m), got / known - 1, unlit);
  printFigure("accuracy.small_lamp_rel_l2", hall.name, {std::sqrt(wrong / squares), 0}, 0.05, note);
  printFigure("accuracy.small_lamp_median", hall.name, {errors[errors.size() / 2], 0}, 0.02, note + "; of a patch, over its own truth");
  return {};
}

// With bounces, streamed, where two eyes see it.
Result<void> measureGreyHall(const Hall& hall, const AccuracyOptions& o) {
  const bake::Scene scene = sceneOf(hall);
  const auto baked = chart::keptBake(scene, {.patch_budget = o.patch_budget / hall.budget_share}, (o.folder / (hall.name + ".ffm")).string());
  if (!baked) return baked.error();
  auto world = chart::MeasuredWorld::open(scene, baked->path);
  if (!world) return world.error();
  return printSeen(*world, std::vector<Vec3>{{-3, 1.7f, 1}, {5, 1.7f, -6}}, lampsAlone(), "accuracy.seen_small_lamp", hall.name,
                   {.median = 0.02, .rel_l2 = 0.05}, seenSettings(o));
}

}  // namespace

Result<void> measureSmallLamps(const AccuracyOptions& o) {
  for (const Hall& hall : {Hall{.name = "small_lamp", .budget_share = 1}, Hall{.name = "small_lamp_tenth", .lamp_m = 0.02f},
                           Hall{.name = "small_lamp_twenty", .rows = 5, .columns = 4},
                           Hall{.name = "small_lamp_tenth_twenty", .lamp_m = 0.02f, .rows = 5, .columns = 4}})
    if (auto r = measureBlackHall(hall, o); !r) return r;
  return measureGreyHall({.name = "small_lamp_grey", .albedo = 0.5f}, o);
}

}  // namespace ff::bench
