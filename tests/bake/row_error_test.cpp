// Rays are cast until rows are as good as was asked for: what they say of themselves, against rows of 16 times as many rays.
#include "bake/light/row_error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iostream>
#include <numeric>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "bake/light/form_factor.h"
#include "bake/matrix/pool.h"
#include "formats/read/reader.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/random_world.h"
#include "tests/support/town_scene.h"

namespace ff::bake {
namespace {

// What a pooled row brings of each made-up light and the sky, by patch.
using Brought = std::vector<std::array<double, MadeUpLight::kLights>>;
Brought broughtBy(const HitRows& rows, const PatchSet& set, const MadeUpLight& light) {
  std::vector<float> areas;
  for (const Patch& p : set.patches) areas.push_back(p.area_m2);
  const PooledPatches pooled(rows, areas);
  Brought brought(areas.size());
  ExchangeRow row;
  for (uint32_t i = 0; i < brought.size(); ++i) {
    pooled.row(i, row);
    for (size_t l = 0; l < MadeUpLight::kLights; ++l) {
      double sum = row.sky_m2;
      for (size_t k = 0; k < row.column.size(); ++k) sum += light.shines(row.column[k], l) ? row.area_m2[k] : 0;
      brought[i][l] = sum / row.total_m2();
    }
  }
  return brought;
}

// The relative error as RowError defines it, by patch, ascending.
std::vector<double> differences(const Brought& a, const Brought& truth) {
  std::vector<double> errors;
  for (size_t i = 0; i < a.size(); ++i) {
    double off = 0, all = 0;
    for (size_t l = 0; l < MadeUpLight::kLights; ++l) {
      off += (a[i][l] - truth[i][l]) * (a[i][l] - truth[i][l]) / MadeUpLight::kLights;
      all += truth[i][l] / MadeUpLight::kLights;
    }
    errors.push_back(std::sqrt(off) / std::max(all, RowError::kFloor));
  }
  std::sort(errors.begin(), errors.end());
  return errors;
}

TEST(RowError, IsWhatSixteenTimesAsManyRaysSay) {
  const formats::TemporaryFolder folder;
  const Scene scene = test::townScene(folder, 2000);
  const auto caster = RayCaster::create(scene);
  const auto set = makePatches(scene, {.cell_m = 1}, &*caster);
  ASSERT_TRUE(set);
  const MadeUpLight light(*set);
  WorkCount done;
  for (const float target : {0.012f, 0.006f}) {
    const HitRows rows = castRows(scene, *set, *caster, {16384, target}, 1, done);
    const auto n = static_cast<double>(rows.rays.size());
    const double mean = std::accumulate(rows.rays.begin(), rows.rays.end(), 0.0) / n;
    const double said = std::sqrt(std::accumulate(rows.square_error.begin(), rows.square_error.end(), 0.0) / n);
    const Brought truth = broughtBy(castRows(scene, *set, *caster, static_cast<uint32_t>(16 * mean), 77, done), *set, light);
    const std::vector<double> errors = differences(broughtBy(rows, *set, light), truth);
    const double off = std::sqrt(std::inner_product(errors.begin(), errors.end(), errors.begin(), 0.0) / n);
    std::cout << "asked for " << target << ": " << mean << " rays a patch, " << said << " said, " << off << " measured\n";
    EXPECT_LT(off, 1.1 * static_cast<double>(target));
    EXPECT_NEAR(said, off, 0.2 * off);
    EXPECT_NEAR(errors[errors.size() * 99 / 100], static_cast<double>(kNearlyAll) * off, 0.15 * static_cast<double>(kNearlyAll) * off);
    EXPECT_GT(mean, kLeastRays);
    EXPECT_GT(*std::max_element(rows.rays.begin(), rows.rays.end()), kLeastRays);  // more where it is needed,
    EXPECT_EQ(*std::min_element(rows.rays.begin(), rows.rays.end()), kLeastRays);  // fewer where it is not
  }
}

TEST(RowError, IsZeroWhereTheHalvesAgreeAndLargeWhereTheyDoNot) {
  const Scene scene = test::closedBox({.5f, .5f, .5f}, {});
  const auto set = makePatches(scene, {.cell_m = 0.25f});
  ASSERT_TRUE(set);
  const MadeUpLight light(*set);
  uint32_t some = 0;  // a patch that shines in some of the lights
  while (!light.shines(some, 0)) ++some;
  RowError agree(light), differ(light), one(light);
  agree.add(some, {1, 1}, {1, 1});
  EXPECT_EQ(agree.square(2), 0);
  differ.add(some, {2, 0}, {2, 0});
  double lit = 0;
  for (size_t l = 0; l < MadeUpLight::kLights; ++l) lit += light.shines(some, l) / static_cast<double>(MadeUpLight::kLights);
  EXPECT_NEAR(differ.square(2), RowError::kPooled * lit * 4 / std::pow(std::max(2 * lit, 2 * RowError::kFloor), 2), 1e-6);
  one.add(some, {1, 0}, {1, 0});  // and 999 that end on nothing
  EXPECT_LT(one.square(1000), 1e-4);
}

TEST(RowError, TheManifestHoldsWhatWasAskedForAndMeasured) {
  const formats::TemporaryFolder folder;
  const Scene scene = test::parallelSquares();
  const auto stats = bakeWorld(scene, {.cell_m = 0.125f, .rays = 4096, .target_error = 0.03f}, folder.file("w.ffm"));
  ASSERT_TRUE(stats) << stats.error().line();
  const auto world = formats::World::open(folder.file("w.ffm"));
  ASSERT_TRUE(world);
  EXPECT_EQ(world->info().target_error, 0.03f);
  EXPECT_EQ(world->info().rays, stats->mean_rays);
  EXPECT_GE(world->info().fewest_rays, kLeastRays);
  EXPECT_GT(world->info().row_error, 0.003f);
  EXPECT_LT(world->info().row_error, 0.033f);
  const auto fixed = bakeWorld(scene, {.cell_m = 0.125f, .rays = 64}, folder.file("w.ffm"));
  ASSERT_TRUE(fixed);
  EXPECT_EQ(fixed->mean_rays, 64u);
  EXPECT_GT(fixed->row_error, stats->row_error);
  EXPECT_FALSE(bakeWorld(scene, {.cell_m = 0.125f, .target_error = 1}, folder.file("w.ffm")));
}

}  // namespace
}  // namespace ff::bake
