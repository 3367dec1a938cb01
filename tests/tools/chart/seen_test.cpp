// Scoring what is seen, against light that is known in closed form.
#include "tools/chart/sweep/seen.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/support/analytic_scenes.h"
#include "tests/tools/chart/chart_world.h"
#include "tools/chart/kept_bake.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/sweep/comparison.h"
#include "tools/chart/truth/area_light.h"
#include "tools/scene/analytic.h"

namespace ff::chart {
namespace {

using bake::test::addMaterial;
using bake::test::addQuad;
constexpr double kPi = std::numbers::pi;
constexpr Vec3 kBlack{};
const Lighting kLamps{.name = "lamps", .sky = {}, .sun = {}, .lamps = 1};
const Lighting kNoon{.name = "noon", .sky = {}, .to_sun = {0, 1, 0}, .sun = {10, 10, 10}};
const SeenSettings kFew{.rays = 4096, .pixels = 64, .paths = 200000, .threads = 1};

class SeenScene : public InABakedScene {
 protected:
  Knobs standard() const {
    Knobs k;
    k.bake = {world_->world().info().cell_m, world_->world().info().rays, world_->world().info().quanta};
    k.radius_m = 100 * k.bake.cell_m;
    return k;
  }
};

// A floor of one patch, a roof over its left half, the sun in the zenith, an eye high above: it sees the roof and, of the
// floor, the sunny half alone. The patch's mean is half the sun.
TEST_F(SeenScene, APatchHalfInTheShadeIsWrongWhereItsSunnyHalfIsSeen) {
  bake::Scene scene;
  const uint32_t black = addMaterial(scene, kBlack);
  addQuad(scene, {0, 0, 0}, {0, 0, 2}, {2, 0, 2}, {2, 0, 0}, black);
  addQuad(scene, {-1, 1, -1}, {-1, 1, 3}, {1, 1, 3}, {1, 1, -1}, black);
  ASSERT_NO_FATAL_FAILURE(open(std::move(scene), 8, 64));
  uint32_t floor = bake::kNone;
  for (uint32_t p = 0; p < world_->patches().size(); ++p)
    if (world_->patches()[p].centroid.y < 0.5f) {
      ASSERT_EQ(floor, bake::kNone) << "the floor is one patch";
      floor = p;
    }
  // By patch means nothing is wrong: half of the floor is lit.
  const auto lit = world_->lit(kNoon, 4096, nullptr);
  ASSERT_TRUE(lit);
  const std::vector<uint32_t> floors{floor};
  EXPECT_NEAR((*lit)->irradiance[3 * floor], 5, 0.05);
  EXPECT_NEAR(world_->tracer().trace(floors, kNoon, {.paths = 4096, .threads = 1})[0].irradiance.x, 5, 0.05);

  const std::vector<Vec3> eyes{{0, 10, 1}};
  const SeenPixels seen = lookAround(world_->tracer(), eyes, kFew);
  const auto truth = truthOfSeen(world_->tracer(), seen, kNoon, kFew);
  for (const PatchTruth& t : truth) EXPECT_NEAR(t.irradiance.x, 10, 1e-4f) << "all that is seen lies in the sun";
  const auto score = scoreSeen(*world_, seen, kNoon, standard(), kFew);
  ASSERT_TRUE(score) << score.error().line();
  size_t of_floor = 0;
  for (const uint32_t k : seen.pixels[0]) of_floor += seen.surfaces[k].points[0].patch == floor ? 1 : 0;
  ASSERT_GT(of_floor, 0u);
  const double share = static_cast<double>(of_floor) / static_cast<double>(seen.count());
  for (const Accuracy* a : {&score->streamed, &score->full_solve}) {
    EXPECT_NEAR(a->energy.value, -0.5 * share, 0.01);
    EXPECT_NEAR(a->rel_l2.value, 0.5 * std::sqrt(share), 0.01);
  }
  EXPECT_NEAR(score->tracer_noise, 0, 1e-5);
  EXPECT_EQ(score->not_drawn, 0);
}

// E = B = M / (1 - albedo) everywhere; lamps and patches as the solvers have them, black ones as well as grey ones.
TEST_F(SeenScene, AFurnaceHasOneIrradiance) {
  ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::furnaceBox(0.5f, 2)), 0.5f, 4096));
  const auto lit = world_->lit(kLamps, 16, nullptr);
  ASSERT_TRUE(lit);
  // Half of it comes by the lamps' weights, which 4096 rays of a patch find to half a percent; the rows are exact.
  for (const double e : (*lit)->irradiance) EXPECT_NEAR(e, 4, 0.04);
  const std::vector<Vec3> eyes{{0.5f, 0.5f, 0.5f}, {0.1f, 0.2f, 0.3f}};
  const SeenPixels seen = lookAround(world_->tracer(), eyes, kFew);
  EXPECT_EQ(seen.eyes.size(), 2u);
  EXPECT_EQ(seen.count(), 64u);
  EXPECT_EQ(seen.not_drawn, 0);
  const auto score = scoreSeen(*world_, seen, kLamps, standard(), kFew);
  ASSERT_TRUE(score) << score.error().line();
  // Bars of a mean over 64 pixels, four of them.
  EXPECT_NEAR(score->full_solve.energy.value, 0, 4 * score->tracer_noise / 8 + 0.005);
  EXPECT_LT(score->tracer_noise, 0.02);
  EXPECT_LT(score->streamed.full_solve_rel_l2.value, 1e-4);
  // The noise is taken off. What is left is how far its estimate is off: of 24 surfaces of 15 degrees of freedom, twice at most.
  EXPECT_LT(score->full_solve.rel_l2.value, 1.5 * score->tracer_noise + 0.005);
}

TEST_F(SeenScene, BlackWallsHaveAnIrradianceToo) {
  bake::Scene scene;
  const uint32_t black = addMaterial(scene, kBlack), lamp = addMaterial(scene, kBlack, {1, 1, 1});
  addQuad(scene, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, black);
  addQuad(scene, {0, 1, 0}, {1, 1, 0}, {1, 1, 1}, {0, 1, 1}, lamp);
  ASSERT_NO_FATAL_FAILURE(open(std::move(scene), 0.25f, 4096));
  const auto lit = world_->lit(kLamps, 16, nullptr);
  ASSERT_TRUE(lit);
  double power = 0;
  for (uint32_t p = 0; p < world_->patches().size(); ++p)
    if (world_->patches()[p].centroid.y < 0.5f) power += (*lit)->irradiance[3 * p] * static_cast<double>(world_->areasM2()[p]);
  // 65,536 rays of the floor: 0.2 +- 0.0016, pooled with as many of the lamp's.
  EXPECT_NEAR(power / kPi, 0.199824895698, 0.004);
  const auto truth = AreaLight(scene_).irradianceOfPatches(world_->world());
  ASSERT_TRUE(truth) << truth.error().line();
  power = 0;
  for (uint32_t p = 0; p < truth->size(); ++p) power += static_cast<double>((*truth)[p].x * world_->areasM2()[p]);
  EXPECT_NEAR(power / kPi, 0.199824895698, 2e-4) << "16 x 16 pieces of 0.02 m or less";
}

TEST_F(SeenScene, EyesInASolidSeeNothing) {
  bake::Scene scene;
  bake::test::addBlock(scene, {0, 0, 0}, {1, 1, 1}, addMaterial(scene, {0.5f, 0.5f, 0.5f}));
  ASSERT_NO_FATAL_FAILURE(open(std::move(scene), 0.5f, 64));
  const std::vector<Vec3> inside{{0.5f, 0.5f, 0.5f}}, both{{0.5f, 0.5f, 0.5f}, {0.5f, 2, 0.5f}};
  const SeenPixels none = lookAround(world_->tracer(), inside, kFew);
  EXPECT_TRUE(none.eyes.empty());
  const auto refused = scoreSeen(*world_, none, kNoon, standard(), kFew);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
  EXPECT_EQ(lookAround(world_->tracer(), both, kFew).eyes.size(), 1u);
}

// A floor part of which the world knows nothing of, because its material was left out of the bake alone.
TEST_F(SeenScene, SurfaceWithoutAPatchCountsAsUnlit) {
  bake::Scene scene;
  const uint32_t floor = addMaterial(scene, {0.5f, 0.5f, 0.5f}), other = addMaterial(scene, {0.5f, 0.5f, 0.5f});
  scene.materials[floor].name = "floor", scene.materials[other].name = "other";
  addQuad(scene, {0, 0, 0}, {0, 0, 2}, {2, 0, 2}, {2, 0, 0}, floor);
  addQuad(scene, {2, 0, 0}, {2, 0, 2}, {3, 0, 2}, {3, 0, 0}, other);
  scene_ = scene;
  scene_.name = "scene";
  const std::string path = folder_.file("world.ffm");
  ASSERT_TRUE(bake::bakeWorld(scene_, {.cell_m = 1, .rays = 64, .threads = 1, .cleanup = {.exclude = {"other"}}}, path));
  auto opened = MeasuredWorld::open(scene_, path);
  ASSERT_TRUE(opened) << opened.error().line();
  world_ = std::make_unique<MeasuredWorld>(std::move(*opened));
  const std::vector<Vec3> eyes{{1.5f, 1, 1}};
  const SeenPixels seen = lookAround(world_->tracer(), eyes, kFew);
  EXPECT_GT(seen.not_drawn, 0.1);
  const auto score = scoreSeen(*world_, seen, kNoon, standard(), kFew);
  ASSERT_TRUE(score) << score.error().line();
  // Everything lies in the sun; what is not drawn is missing. To within a pixel.
  EXPECT_NEAR(score->full_solve.energy.value, -seen.not_drawn, 1.0 / 64);
}

TEST_F(SeenScene, ALightThatNothingIsSeenOfHasNoFiguresAndAReason) {
  ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::furnaceBox(0.5f, 2)), 0.5f, 64));
  const std::vector<Vec3> eyes{{0.5f, 0.5f, 0.5f}};
  const auto score = scoreSeen(*world_, lookAround(world_->tracer(), eyes, kFew), kNoon, standard(), kFew);
  ASSERT_TRUE(score) << score.error().line();
  EXPECT_FALSE(score->note.empty()) << "the sun does not get into a closed room";
  EXPECT_TRUE(std::isnan(score->streamed.rel_l2.value));
}

TEST_F(SeenScene, TheSameNumbersWhateverTheThreads) {
  ASSERT_NO_FATAL_FAILURE(open(sceneOf(tools::furnaceBox(0.5f, 2)), 0.5f, 64));
  const std::vector<Vec3> eyes{{0.3f, 0.5f, 0.4f}};
  const SeenPixels seen = lookAround(world_->tracer(), eyes, kFew);
  SeenSettings more = kFew;
  more.threads = 3;
  const auto one = truthOfSeen(world_->tracer(), seen, kLamps, kFew), three = truthOfSeen(world_->tracer(), seen, kLamps, more);
  ASSERT_EQ(one.size(), three.size());
  for (size_t k = 0; k < one.size(); ++k) EXPECT_EQ(one[k].irradiance, three[k].irradiance);
}

// In a box whose walls all emit, a point sees radiance in its whole hemisphere, whatever walls its horizon cuts.
TEST(AreaLight, IsCutAtTheHorizon) {
  const AreaLight light(bake::test::closedBox({}, {1, 2, 3}));
  for (const Vec3 normal : {Vec3{0, 1, 0}, normalized({1, 2, 3}), normalized({-3, 0.1f, 0.2f})}) {
    const Vec3 e = light.irradianceAt({0.3f, 0.6f, 0.8f}, normal);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(static_cast<double>(e[c]), kPi * (c + 1), 1e-5);
  }
}

// 2 cm at 6 m: L A cos cos / r^2, to (size / r)^2 = 1e-5.
TEST(AreaLight, OfATinyLampFarAwayFollowsTheInverseSquare) {
  bake::Scene scene;
  const uint32_t lamp = addMaterial(scene, {}, {1000, 1000, 1000});
  addQuad(scene, {-0.01f, 6, -0.01f}, {0.01f, 6, -0.01f}, {0.01f, 6, 0.01f}, {-0.01f, 6, 0.01f}, lamp);
  const AreaLight light(scene);
  const double r2 = 36 + 16, known = 1000 * 4e-4 * 36 / r2 / r2;
  EXPECT_NEAR(static_cast<double>(light.irradianceAt({4, 0, 0}, {0, 1, 0}).x), known, 2e-5 * known);
  EXPECT_EQ(light.irradianceAt({4, 7, 0}, {0, -1, 0}), Vec3{}) << "it shines down alone";
}

TEST(KeptBake, IsUsedAgainIfItIsTheSame) {
  formats::TemporaryFolder folder;
  bake::Scene scene = bake::test::parallelSquares();
  scene.name = "squares";
  const std::string path = folder.file("deeper/world.ffm");
  const bake::BakeSettings settings{.cell_m = 0.5f, .rays = 16};
  for (int i = 0; i < 2; ++i) {
    const auto anew = keptBake(scene, settings, path);
    ASSERT_TRUE(anew) << anew.error().line();
    EXPECT_TRUE(anew->made) << "a scene that was never a file has no name for its content";
  }
  scene.content_hash[0] = 1;
  EXPECT_TRUE(keptBake(scene, settings, path)->made);
  EXPECT_FALSE(keptBake(scene, settings, path)->made);
  bake::BakeSettings finer = settings;
  finer.rays = 32;
  EXPECT_TRUE(keptBake(scene, finer, path)->made);
}

}  // namespace
}  // namespace ff::chart
