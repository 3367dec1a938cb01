#include "bake/surface/patches.h"

#include <gtest/gtest.h>

#include <set>

#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

double areaOf(const PatchSet& set) {
  double area = 0;
  for (const Patch& p : set.patches) area += static_cast<double>(p.area_m2);
  return area;
}

TEST(Patches, TheFacesOfAVoxelLieInTheVoxelsOwnCell) {
  // Unit cube (2..3, 4..5, -1..0), faces outwards: the grid planes it lies in also bound six other cells.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addBlock(s, {2, 4, -1}, {3, 5, 0}, m);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  ASSERT_EQ(set->patches.size(), 6u);
  std::set<uint32_t> orientations;
  for (const Patch& patch : set->patches) {
    EXPECT_EQ(patch.cell, (Cell{2, 4, -1}));
    EXPECT_FLOAT_EQ(patch.area_m2, 1.0f);
    orientations.insert(patch.orientation);
  }
  EXPECT_EQ(orientations.size(), 6u);
}

TEST(Patches, TwoFloorsInOneCellAreTwoPatches) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  for (float y : {0.2f, 0.7f}) addQuad(s, {0, y, 0}, {0, y, 1}, {1, y, 1}, {1, y, 0}, m);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  EXPECT_EQ(set->patches.size(), 2u);
}

TEST(Patches, FloorsOnBothSidesOfAThinWallAreTwoPatches) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0.5f, 0}, {0, 0.5f, 1}, {0.45f, 0.5f, 1}, {0.45f, 0.5f, 0}, m);
  addQuad(s, {0.55f, 0.5f, 0}, {0.55f, 0.5f, 1}, {1, 0.5f, 1}, {1, 0.5f, 0}, m);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  EXPECT_EQ(set->patches.size(), 2u);
}

// A rug on the near half of a floor of 1 m, so much above it.
PatchSet floorUnderRug(float gap_m) {
  Scene s;
  const uint32_t floor = addMaterial(s, {.2f, .2f, .2f}), rug = addMaterial(s, {.8f, .8f, .8f});
  addQuad(s, {0, .5f, 0}, {0, .5f, 1}, {1, .5f, 1}, {1, .5f, 0}, floor);
  addQuad(s, {0, .5f + gap_m, 0}, {0, .5f + gap_m, 1}, {.5f, .5f + gap_m, 1}, {.5f, .5f + gap_m, 0}, rug);
  const auto caster = RayCaster::create(s);
  return *makePatches(s, {.cell_m = 1}, &*caster);
}

TEST(Patches, MorePiecesThanAreAllowedAreRefusedInOneLine) {
  // A floor in four cells, which is two triangles, is ten pieces or less; what stands on it cuts it into more than can be told beforehand.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 2}, {2, 0, 2}, {2, 0, 0}, m);
  EXPECT_TRUE(makePatches(s, {.cell_m = 1, .max_pieces = 10}));
  for (float x = 0.1f; x < 1.8f; x += 0.2f) addBlock(s, {x, 0, 0.5f}, {x + 0.05f, 0.3f, 1.5f}, m);
  const auto caster = RayCaster::create(s);
  ASSERT_TRUE(caster);
  ASSERT_TRUE(makePatches(s, {.cell_m = 1}, &*caster));
  const auto refused = makePatches(s, {.cell_m = 1, .max_pieces = 100}, &*caster);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUsage);
  EXPECT_NE(refused.error().line().find("cut each other into more than 100 pieces"), std::string::npos) << refused.error().line();
}

TEST(Patches, WhatLiesUnderARugTakesNoPart) {
  const PatchSet set = floorUnderRug(1.5e-6f);  // rays start 3e-6 m off
  ASSERT_EQ(set.patches.size(), 1u);
  EXPECT_NEAR(set.patches[0].area_m2, 1, 1e-3);
  EXPECT_NEAR(set.patches[0].albedo.x, .5, 1e-3);
  EXPECT_NEAR(set.sealed_m2, .5, 1e-3);
}

// So that what an eye sees of it, at the rug's rim, is not a gap.
TEST(Patches, WhatLiesUnderARugIsKeptForDrawingWithTheFloorsPatch) {
  const PatchSet set = floorUnderRug(1.5e-6f);
  float area = 0;
  for (const SealedTriangle& t : set.sealed) {
    EXPECT_EQ(t.patch, set.patchAt(t.source, true, {.75f, .5f, .5f}));
    const Vec3 doubled = cross(t.b - t.a, t.c - t.a);
    EXPECT_GT(doubled.y, 0);
    area += length(doubled) / 2;
  }
  EXPECT_NEAR(area, .5f, 1e-3f);
}

TEST(Patches, OfTwoSurfacesInOnePlaneTheFirstStandsForBoth) {
  const PatchSet set = floorUnderRug(0);
  ASSERT_EQ(set.patches.size(), 1u);
  EXPECT_NEAR(set.patches[0].area_m2, 1, 1e-3);
  EXPECT_NEAR(set.patches[0].albedo.x, .2, 1e-3);
  for (const uint32_t t : {2u, 3u}) EXPECT_EQ(set.patchAt(t, true, {.25f, .5f, .5f}), 0u);
  EXPECT_NEAR(set.sealed_m2, .5, 1e-3);
  EXPECT_TRUE(set.sealed.empty());
}

TEST(Patches, ALampAndItsFittingAreNeverOnePatch) {
  // A lamp in the middle of a plate, edge to edge with it; and a crumb of a lamp, which does not join a dark patch either.
  Scene s;
  const uint32_t plate = addMaterial(s, {.5f, .5f, .5f}), lamp = addMaterial(s, {.5f, .5f, .5f}, {9, 9, 9});
  addQuad(s, {0, .5f, 0}, {0, .5f, 1}, {.4f, .5f, 1}, {.4f, .5f, 0}, plate);
  addQuad(s, {.4f, .5f, 0}, {.4f, .5f, 1}, {.8f, .5f, 1}, {.8f, .5f, 0}, lamp);
  addQuad(s, {.9f, .7f, 0}, {.9f, .7f, .1f}, {1, .7f, .1f}, {1, .7f, 0}, lamp);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  ASSERT_EQ(set->patches.size(), 2u);
  const Patch &dark = set->patches[0], &shining = set->patches[1];
  EXPECT_FALSE(dark.emits());
  EXPECT_EQ(dark.emission, Vec3{});
  EXPECT_NEAR(dark.area_m2, 0.4f, 1e-6f);
  EXPECT_TRUE(shining.emits());
  EXPECT_NEAR(shining.area_m2, 0.41f, 1e-6f);
  EXPECT_NEAR(shining.emission.x, 9 * 3.14159265f, 1e-4f);
}

TEST(Patches, ATJunctionConnects) {
  // One long quad beside two short ones; no corner of the middle is shared.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0.5f, 0}, {0, 0.5f, 0.5f}, {1, 0.5f, 0.5f}, {1, 0.5f, 0}, m);
  addQuad(s, {0.3f, 0.5f, 0.5f}, {0.3f, 0.5f, 1}, {0.7f, 0.5f, 1}, {0.7f, 0.5f, 0.5f}, m);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  EXPECT_EQ(set->patches.size(), 1u);
}

TEST(Patches, CrumbsJoinTheNearestPatchOfTheirCell) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0.2f, 0}, {0, 0.2f, 1}, {1, 0.2f, 1}, {1, 0.2f, 0}, m);
  addQuad(s, {0, 0.8f, 0}, {0, 0.8f, 0.5f}, {0.5f, 0.8f, 0.5f}, {0.5f, 0.8f, 0}, m);
  addQuad(s, {0.6f, 0.78f, 0.6f}, {0.6f, 0.78f, 0.7f}, {0.7f, 0.78f, 0.7f}, {0.7f, 0.78f, 0.6f}, m);  // 1 % of a cell face
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  ASSERT_EQ(set->patches.size(), 2u);
  EXPECT_NEAR(areaOf(*set), 1.26, 1e-6);
  EXPECT_EQ(set->patchAt(4, true, {0.65f, 0.78f, 0.65f}), set->patchAt(2, true, {0.2f, 0.8f, 0.2f}));
}

TEST(Patches, NextToNothingIsNoPatchOfItsOwn) {
  // A rim of 0.05 % of a cell's face around a floor, and one in the cell above the floor's.
  for (const float y : {0.5f, 1.001f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addQuad(s, {0, 0.5f, 0}, {0, 0.5f, 1}, {1, 0.5f, 1}, {1, 0.5f, 0}, m);
    addQuad(s, {0.5f, y, 0.2f}, {0.5f, y + 0.0005f, 0.2f}, {0.5f, y + 0.0005f, 1}, {0.5f, y, 1}, m);
    const auto set = makePatches(s, {.cell_m = 1});
    ASSERT_TRUE(set);
    ASSERT_EQ(set->patches.size(), 1u) << y;
    EXPECT_NEAR(set->patches[0].area_m2, 1.0004, 1e-6);
  }
}

TEST(Patches, WhatIsAllHoleHasNone) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), leaf = addMaterial(s, {.5f, .5f, .5f});
  s.materials[leaf].cutout = true;
  s.materials[leaf].alpha = 0;
  addQuad(s, {0, 0.2f, 0}, {0, 0.2f, 1}, {1, 0.2f, 1}, {1, 0.2f, 0}, m);
  addQuad(s, {0, 0.8f, 0}, {0, 0.8f, 1}, {1, 0.8f, 1}, {1, 0.8f, 0}, leaf);
  const auto caster = RayCaster::create(s);
  const auto set = makePatches(s, {.cell_m = 1}, &*caster);
  ASSERT_TRUE(caster && set);
  ASSERT_EQ(set->patches.size(), 1u);
  EXPECT_NEAR(set->patches[0].area_m2, 1, 1e-6);
}

TEST(Patches, ADoubleSidedSurfaceHasAPatchASide) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  s.materials[m].double_sided = true;
  addQuad(s, {0, 0.5f, 0}, {0, 0.5f, 1}, {1, 0.5f, 1}, {1, 0.5f, 0}, m);
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  ASSERT_EQ(set->patches.size(), 2u);
  const uint32_t up = set->patchAt(0, true, {0.2f, 0.5f, 0.8f}), down = set->patchAt(0, false, {0.2f, 0.5f, 0.8f});
  EXPECT_GT(set->patches[up].normal.y, 0.99f);
  EXPECT_LT(set->patches[down].normal.y, -0.99f);
}

TEST(Patches, TheBackOfASingleSidedSurfaceHasNone) {
  const Scene s = parallelSquares();
  const auto set = makePatches(s, {.cell_m = 1});
  ASSERT_TRUE(set);
  EXPECT_EQ(set->patchAt(0, false, {0.5f, 0, 0.7f}), kNone);
}

int astray(const PatchSet& set) {  // triangles' middles that patchAt() does not find again
  int n = 0;
  for (uint32_t p = 0; p < set.patches.size(); ++p)
    for (uint32_t k = 0; k < set.patches[p].triangles; ++k) {
      const PatchTriangle& t = set.triangles[set.patches[p].first_triangle + k];
      n += set.patchAt(t.source, true, (t.a + t.b + t.c) / 3.0f) != p;
    }
  return n;
}

TEST(Patches, WhatOfAWallIsBehindABoardOnItTakesNoPart) {
  for (const float height : {0.02f, 0.25f, 0.5f, 0.7f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addQuad(s, {0, 0, 0}, {0, 1, 0}, {0, 1, 1}, {0, 0, 1}, m);
    addBlock(s, {0, 0, 0}, {0.05f, height, 1}, m);
    const auto caster = RayCaster::create(s);
    const auto set = makePatches(s, {.cell_m = 1}, &*caster), blind = makePatches(s, {.cell_m = 1});
    ASSERT_TRUE(caster && set && blind);
    const uint32_t above = set->patchAt(0, true, {0, 0.93f, 0.5f});
    ASSERT_LT(above, set->patches.size()) << height;
    EXPECT_EQ(set->patchAt(1, true, {0, height / 2, 0.9f}), kSealed) << height;
    EXPECT_NEAR(set->patches[above].area_m2, 1 - height, 1e-5) << height;
    EXPECT_EQ(blind->patchAt(0, true, {0, 0.93f, 0.5f}), blind->patchAt(1, true, {0, height / 2, 0.9f}));
    EXPECT_EQ(astray(*set), 0);
  }
}

TEST(Patches, WhatLightDoesNotGetOutOfHasNoPatchAndAHoleGivesItOne) {
  for (const float hole : {0.0f, 0.08f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    s.materials[m].double_sided = true;
    addBlock(s, {0.3f, 0.3f, 0.3f}, {0.5f, 0.5f, 0.5f}, m);
    s.triangles.erase(s.triangles.begin(), s.triangles.begin() + 2);  // the lid, and one that leaves a slit
    addQuad(s, {0.3f, 0.5f, 0.3f}, {0.3f, 0.5f, 0.5f - hole}, {0.5f, 0.5f, 0.5f - hole}, {0.5f, 0.5f, 0.3f}, m);
    const auto caster = RayCaster::create(s);
    const auto set = makePatches(s, {.cell_m = 1}, &*caster);
    ASSERT_TRUE(caster && set);
    const uint32_t inside = set->patchAt(10, false, {0.35f, 0.5f, 0.4f}), outside = set->patchAt(10, true, {0.35f, 0.5f, 0.4f});
    EXPECT_LT(outside, set->patches.size());
    if (hole == 0) {
      EXPECT_EQ(inside, kSealed);
      EXPECT_NEAR(set->sealed_m2, 6 * 0.2 * 0.2, 1e-5);
      EXPECT_TRUE(set->sealed.empty()) << "no triangle goes on where light gets to";
    } else {
      ASSERT_LT(inside, set->patches.size());
      EXPECT_EQ(set->sealed_m2, 0);
    }
  }
}

TEST(Patches, CuttingKeepsTheAreaOfArbitraryTrianglesAndFindsEveryPointAgain) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  uint32_t state = 12345;
  const auto random = [&] {
    state = state * 1664525u + 1013904223u;
    return static_cast<float>(state >> 8) * 0x1p-24f * 20 - 10;
  };
  double area = 0;
  for (int i = 0; i < 200; ++i) {
    const Vec3 a{random(), random(), random()}, b{random(), random(), random()}, c{random(), random(), random()};
    addTriangle(s, a, b, c, m);
    area += 0.5 * static_cast<double>(length(cross(b - a, c - a)));
  }
  const auto set = makePatches(s, {.cell_m = 0.7f});
  ASSERT_TRUE(set);
  EXPECT_NEAR(areaOf(*set) / area, 1, 1e-5);
  EXPECT_EQ(astray(*set), 0);
}

TEST(Patches, TheHilbertCurveVisitsEveryCubeOfCellsInOneGo) {
  std::vector<uint64_t> keys;
  for (int x = -4; x < 4; ++x)
    for (int y = -4; y < 4; ++y)
      for (int z = -4; z < 4; ++z) keys.push_back(hilbertKey({x, y, z}));
  std::sort(keys.begin(), keys.end());
  EXPECT_EQ(std::unique(keys.begin(), keys.end()), keys.end());
  // 8 aligned cubes of 4x4x4 cells: 64 keys each share their prefix.
  for (int x : {-4, 0})
    for (int y : {-4, 0})
      for (int z : {-4, 0}) {
        const uint64_t prefix = hilbertAncestor(hilbertKey({x, y, z}), 2);
        EXPECT_EQ(std::count_if(keys.begin(), keys.end(), [&](uint64_t k) { return hilbertAncestor(k, 2) == prefix; }), 64);
      }
}

TEST(Patches, ATinyPatchSizeIsRefusedInOneLine) {
  const auto set = makePatches(parallelSquares(), {.cell_m = 1e-8f});
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().code, ErrorCode::kUsage);
  EXPECT_NE(set.error().line().find("--patch-size"), std::string::npos);
}

}  // namespace
}  // namespace ff::bake::test
