// The methods of the paper's figures side by side, on a small town.
#include <gtest/gtest.h>

#include <cmath>

#include "tools/chart/baked_scene.h"
#include "tools/chart/paper/methods.h"
#include "tools/chart/scene_of_model.h"
#include "tools/scene/analytic.h"
#include "tools/scene/town.h"

namespace ff::chart {
namespace {

const MethodCost& find(const MethodsThere& there, const std::string& name) {
  for (const MethodCost& m : there.methods)
    if (m.name == name) return m;
  throw std::runtime_error("no method " + name);
}

// The same patches and the same constant beyond: what differs between the dense methods is their own arithmetic.
TEST(Paper, DenseMethodsAgreeAndThePyramidBeatsTheConstant) {
  constexpr uint32_t kPatches = 768;
  const auto town = tools::makeTown({.patches = tools::kMinTownPatches});
  ASSERT_TRUE(town) << town.error().line();
  const auto baked = BakedScene::bake(sceneOf(tools::townModel(*town, false)), {.cell_m = 1, .rays = 256});
  ASSERT_TRUE(baked) << baked.error().line();
  const auto truth = solveWorldTruth(baked->world(), false);
  ASSERT_TRUE(truth) << truth.error().line();
  const auto there = nearestPatches(baked->world(), *truth, {0, 2, 0}, kPatches);
  ASSERT_TRUE(there) << there.error().line();
  EXPECT_LE(there->activePatches(), kPatches);
  EXPECT_GE(there->activePatches(), kPatches / 2);
  const auto measured =
      measureMethods(baked->world(), *truth, *there, {.patches = kPatches, .threads = 1, .rounds = 2});
  ASSERT_TRUE(measured) << measured.error().line();
  const MethodCost &exact = find(*measured, kExactFloatName), &half = find(*measured, kExactName),
                   &seed = find(*measured, kSeedName), &common = find(*measured, kCommonName),
                   &gather = find(*measured, kGatherName);
  EXPECT_GT(exact.picture, 0);
  EXPECT_NEAR(exact.linear, half.linear, 1e-3) << "fp16 is 2^-12 an entry";
  EXPECT_NEAR(exact.linear, seed.linear, 0.02);
  EXPECT_NEAR(exact.linear, common.linear, 0.02) << "outdoors three bounces are most of it";
  EXPECT_LT(gather.linear, exact.linear / 2);
  for (const MethodCost& m : measured->methods) {
    EXPECT_GT(m.relight_ms, 0) << m.name;
    EXPECT_GT(m.update_ms, 0) << m.name;
    EXPECT_EQ(m.patches, there->activePatches()) << m.name;
  }
  EXPECT_EQ(half.bytes * 2, exact.bytes);
  EXPECT_GT(measured->bytes_per_s, 0);
}

// The local matrix holds everything: nothing is beyond, and every exact method is the full solution.
TEST(Paper, AMatrixOfAllPatchesIsTheFullSolution) {
  const auto baked = BakedScene::bake(sceneOf(tools::twoRooms(0.5f, 0.7f, 10)), {.cell_m = 1, .rays = 256});
  ASSERT_TRUE(baked) << baked.error().line();
  const auto truth = solveWorldTruth(baked->world(), true);
  ASSERT_TRUE(truth) << truth.error().line();
  const uint32_t all = formats::wholeNumber(baked->world().levels()[0].nodes);
  const auto there = nearestPatches(baked->world(), *truth, {2, 1.5f, 2}, all);
  ASSERT_TRUE(there);
  ASSERT_EQ(there->activePatches(), all);
  const auto measured = measureMethods(baked->world(), *truth, *there, {.patches = all, .threads = 1, .rounds = 1});
  ASSERT_TRUE(measured) << measured.error().line();
  EXPECT_LT(find(*measured, kExactFloatName).linear, 5e-6);
  EXPECT_LT(find(*measured, kExactName).linear, 2e-3);
  EXPECT_LT(find(*measured, kGatherName).linear, 5e-6);
  EXPECT_GT(find(*measured, kCommonName).linear, 0.02) << "three bounces leave 0.7^4 of a closed room's light undone";
}

}  // namespace
}  // namespace ff::chart
