#include <gtest/gtest.h>

#include <array>
#include <map>
#include <set>

#include "tests/tools/view/view_scenes.h"
#include "tools/view/walls.h"

namespace ff::view {
namespace {

// Patches that light any corner of a patch's triangles.
std::set<uint32_t> lightersOf(const ViewScene& scene, const Weld& weld, uint32_t patch) {
  std::set<uint32_t> found;
  for (size_t c = 0; c < scene.corners.size(); ++c) {
    if (scene.triangle_patch[c / 3] != patch) continue;
    const VertexPatches& v = weld.light_from[weld.corner_vertex[c]];
    for (size_t i = 0; i < v.patch.size(); ++i)
      if (v.weight[i] > 0) found.insert(v.patch[i]);
  }
  return found;
}

TEST(Weld, GivesEveryVertexWeightsThatSumToOne) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 5}, {4, 0, 0}, 5, 4);
  addSheet(scene, {0, 0, 0}, {0, 3, 0}, {0, 0, 5}, 3, 5);
  const Weld weld = weldScene(scene);
  ASSERT_EQ(weld.corner_vertex.size(), scene.corners.size());
  for (const VertexPatches& v : weld.light_from) {
    float sum = 0;
    for (const float w : v.weight) {
      EXPECT_GE(w, 0);
      sum += w;
    }
    EXPECT_NEAR(sum, 1, 1e-6);
  }
}

TEST(Weld, SharesTheVerticesOfASheetAndSplitsThemAtAnEdge) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 5}, {4, 0, 0}, 5, 4);  // floor, 6 x 5 places
  EXPECT_EQ(weldScene(scene).position.size(), 30u);
  addSheet(scene, {0, 0, 0}, {0, 3, 0}, {0, 0, 5}, 3, 5);  // wall along x = 0: 4 x 6 places, 6 of them shared in place only
  const Weld weld = weldScene(scene);
  EXPECT_EQ(weld.position.size(), 54u);
  for (const uint32_t lighter : lightersOf(scene, weld, 0)) EXPECT_LT(lighter, 20u);  // floor is lit by floor
  for (const uint32_t lighter : lightersOf(scene, weld, 20)) EXPECT_GE(lighter, 20u);
}

// Positions read from two tiles differ by their quantisation.
TEST(Weld, JoinsCornersThatDifferByQuantisation) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 5}, {4, 0, 0}, 5, 4);
  addSheet(scene, {4.0001f, 0.0001f, 0}, {0, 0, 5}, {4, 0, 0}, 5, 4);
  const Weld weld = weldScene(scene);
  EXPECT_EQ(weld.position.size(), 54u);  // 6 x 9
  bool across = false;
  for (uint32_t p = 15; p < 20; ++p)
    for (const uint32_t lighter : lightersOf(scene, weld, p)) across |= lighter >= 20;
  EXPECT_TRUE(across);
}

TEST(Weld, NeverTakesLightFromTheOtherSideOfAThinWall) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {4, 0, 0}, {0, 3, 0}, 4, 3);        // faces +z
  addSheet(scene, {0, 0, 0}, {0, 3, 0}, {4, 0, 0}, 3, 4);        // the same place, faces -z
  addSheet(scene, {0, 0, -0.2f}, {4, 0, 0}, {0, 3, 0}, 4, 3);    // faces +z, 0.2 cells behind: another room's wall
  const Weld weld = weldScene(scene);
  for (uint32_t p = 0; p < 36; ++p)
    for (const uint32_t lighter : lightersOf(scene, weld, p)) EXPECT_EQ(lighter / 12, p / 12) << "patch " << p;
}

// A floor of 4 x 4 patches with a sheet on its middle line, from one border to the other or only half way.
TEST(Weld, NeverTakesLightFromTheOtherSideOfAWallThatStandsOnTheFloor) {
  for (const bool whole : {true, false})
    for (const bool shifted : {false, true}) {  // the wall's corners are between the floor's
      ViewScene scene;
      addSheet(scene, {0, 0, 0}, {0, 0, 4}, {4, 0, 0}, 4, 4);
      const float from = shifted ? -0.5f : 0, to = whole ? 4.5f : 2.75f;
      addSheet(scene, {2, 0, from}, {0, 2, 0}, {0, 0, to - from}, 2, 4);
      const Weld weld = weldScene(scene);
      const auto row = [](uint32_t patch) { return patch % 4; };  // along the wall
      for (uint32_t p = 0; p < 16; ++p)
        for (const uint32_t lighter : lightersOf(scene, weld, p)) {
          if (lighter >= 16) continue;
          if (whole || (row(p) < 1 && row(lighter) < 1)) {
            EXPECT_EQ(lighter / 8, p / 8) << "patch " << p;
          }
        }
      bool across = false;  // behind the wall's end
      for (const uint32_t lighter : lightersOf(scene, weld, 7)) across |= lighter / 8 == 1 && lighter < 16;
      EXPECT_EQ(across, !whole);
    }
}

// Two triangles of a floor before a wall, one behind it, and a sliver of the latter's patch on the wall's foot, whose area welding has taken.
TEST(Weld, ASliverWithoutAreaJoinsNothingAcrossAWall) {
  const std::vector<Vec3> corners{{0, 0, 0}, {-1, 0, 0}, {0, 0, 1}, {0, 0, 0}, {0, 0, -1}, {-1, 0, 0}, {0, 0, 0}, {1, 0, 0},
                                  {0, 0, -1}, {0, 0, 0}, {0, 0, 1}, {0, 0, 1}, {0.0005f, 0, -2}, {0.0005f, 0, 2}, {0.0005f, 2, 0}};
  const std::vector<uint32_t> patches{0, 0, 1, 1, 2};
  const Walls walls(corners, patches, 1, 1e-3f);
  const std::vector<std::vector<uint32_t>> groups = walls.split(std::array<uint32_t, 4>{0, 3, 6, 9});
  EXPECT_EQ(groups, (std::vector<std::vector<uint32_t>>{{0, 3}, {6, 9}}));
}

// A roof ends in a rim that faces as the wall below does and joined the roof's patch, too small for one of its own.
TEST(Weld, TakesNoLightFromAPatchByACrumbOfItThatPointsAnotherWay) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 1, 0}, {1, 0, 0}, 1, 1);
  const uint32_t roof = addSheet(scene, {0, 1.05f, 0}, {0, 0, 1}, {1, 0, 0}, 1, 1);
  for (const Vec3 corner : {Vec3{0, 1, 0}, {0, 1.05f, 0}, {1, 1.05f, 0}, {0, 1, 0}, {1, 1.05f, 0}, {1, 1, 0}}) scene.corners.push_back(corner);
  scene.triangle_patch.insert(scene.triangle_patch.end(), 2, roof);
  const Weld weld = weldScene(scene);
  EXPECT_EQ(lightersOf(scene, weld, 0), std::set<uint32_t>{0});
}

// A floor in two halves that sealed strips join, under a wall between them.
TEST(Weld, TakesNoLightAlongSealedSurface) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 4}, {2, 0, 0}, 4, 2);
  addSheet(scene, {2.5f, 0, 0}, {0, 0, 4}, {2, 0, 0}, 4, 2);
  for (const uint32_t patch : {4u, 8u}) {  // the first ones beside the gap
    const float x = patch == 4 ? 2.0f : 2.25f;
    for (const Vec3 corner : {Vec3{x, 0, 0}, {x, 0, 1}, {x + 0.25f, 0, 1}}) scene.corners.push_back(corner);
    scene.sealed.push_back(static_cast<uint32_t>(scene.triangles()));
    scene.triangle_patch.push_back(patch);
  }
  const Weld weld = weldScene(scene);
  for (uint32_t p = 0; p < 16; ++p)
    for (const uint32_t lighter : lightersOf(scene, weld, p)) EXPECT_EQ(lighter / 8, p / 8) << "patch " << p;
  for (const uint32_t t : scene.sealed)
    for (uint32_t c = 3 * t; c < 3 * t + 3; ++c) {
      const VertexPatches& light = weld.light_from[weld.corner_vertex[c]];
      EXPECT_EQ(light.patch[0], scene.triangle_patch[t]);
      EXPECT_EQ(light.weight[0], 1);
    }
}

TEST(Weld, DoesNotReachFurtherThanATentOfOneAndAHalfCells) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 9}, {9, 0, 0}, 9, 9);
  const Weld weld = weldScene(scene);
  for (size_t v = 0; v < weld.position.size(); ++v)
    for (size_t i = 0; i < 8; ++i)
      if (weld.light_from[v].weight[i] > 0) {
        EXPECT_LT(length(scene.patches[weld.light_from[v].patch[i]].centroid - weld.position[v]), 1.5f);
      }
  // An inner corner has its four patches at equal weight.
  const auto lighters = lightersOf(scene, weld, 40);
  EXPECT_EQ(lighters.size(), 9u);
}

TEST(Weld, SmoothsFinerAndCoarserPatchesAsThoseOfOneCell) {
  const auto weld = [](float cell_m) {
    ViewScene scene;
    scene.cell_m = cell_m;
    addSheet(scene, {0, 0, 0}, {0, 0, 5}, {4, 0, 0}, 5, 4);
    return weldScene(scene);
  };
  const Weld twin = weld(1);
  for (const float cell_m : {0.25f, 0.5f, 2.0f, 8.0f}) {
    const Weld same = weld(cell_m);
    ASSERT_EQ(same.light_from.size(), twin.light_from.size());
    for (size_t v = 0; v < twin.light_from.size(); ++v) {
      EXPECT_EQ(same.light_from[v].patch, twin.light_from[v].patch) << cell_m;
      EXPECT_EQ(same.light_from[v].weight, twin.light_from[v].weight) << cell_m;
    }
  }
}

}  // namespace
}  // namespace ff::view
