#include "tools/view/light.h"

#include <gtest/gtest.h>

#include "tests/support/hand_made.h"
#include "tests/tools/view/view_scenes.h"

namespace ff::view {
namespace {

using runtime::LocalMatrix;
using runtime::Vec4;

// Slots 0..2 are leaves, slot 3 is refined over 1 and 2.
LocalMatrix smallMatrix() {
  LocalMatrix m;
  m.tiles = {{{0, 0}, 0, 0, 3}, {{1, 0}, 3, 0, 1}};
  m.row_start = {0, 2, 3, 3, 3};
  m.entries = {runtime::packEntry(1, 4), runtime::packEntry(2, 2), runtime::packEntry(0, 8)};
  m.row_scale = {1.0f / 8, 1.0f / 16, 1, 1};
  m.refined = {{3, 1, 2}};  // slots 1 to 2
  m.refined_level_start = {0, 1};
  m.albedo.resize(4, {0.5f, 0.5f, 0.5f, 0});
  m.area_m2 = {1, 1, 3, 4};
  m.leaf = {1, 1, 1, 0};
  runtime::finishByHand(m);
  return m;
}

TEST(ViewLight, GathersWhatArrivesFromAllThatSurfacesReflect) {
  const LocalMatrix m = smallMatrix();
  const std::vector<Vec4> reflected{{16, 2, 0, 0}, {12, 4, 0, 0}, {8, 8, 8, 0}, {}};
  const auto light = gatherLight(m, reflected);
  EXPECT_FLOAT_EQ(light[0].x, 8);       // 12 * 4/8 + 8 * 2/8
  EXPECT_FLOAT_EQ(light[0].z, 2);
  EXPECT_FLOAT_EQ(light[1].x, 8);       // 16 * 8/16
  EXPECT_FLOAT_EQ(light[2].x, 0);
  EXPECT_FLOAT_EQ(light[3].x, 2);       // (1 * 8 + 3 * 0) / 4
}

TEST(ViewLight, ComparesOnlyActivePatchesNearTheEye) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 3}, {1, 0, 0}, 3, 1, {0.5f, 0.5f, 0.5f});
  const LocalMatrix m = smallMatrix();
  const std::vector<uint32_t> patch_slot{0, 1, 2};
  std::vector<shaders::vec4> light(4);
  light[0] = {2, 2, 2, 0};  // reflects 1
  light[1] = {4, 4, 4, 0};  // reflects 2
  light[2] = {6, 6, 6, 0};  // reflects 3
  const std::vector<double> source(9, 1.0);
  std::vector<double> full{2, 2, 2, 3, 3, 3, 5, 5, 5};  // bounced: 1, 2, 4; the third differs by 1
  const Vec3 eye{0.5f, 0, 0};
  const Comparison near = compare(scene, m, patch_slot, light, full, source, eye, 2.0f);
  EXPECT_EQ(near.patches_compared, 2u);
  EXPECT_NEAR(near.reflected_error, 0, 1e-9);
  const Comparison all = compare(scene, m, patch_slot, light, full, source, eye, 9.0f);
  EXPECT_EQ(all.patches_compared, 3u);
  EXPECT_NEAR(all.bounced_error, 1 / std::sqrt(1.0 + 4 + 16), 1e-9);
  EXPECT_NEAR(all.reflected_error, 1 / std::sqrt(4.0 + 9 + 25), 1e-9);
  EXPECT_NEAR(all.difference[2], 1 / ((2 + 3 + 5) / 3.0), 1e-6);
  EXPECT_NEAR(all.difference[0], 0, 1e-6);
}

// A sheet of 16 x 4 patches along x. slot: of the patches whose centre is at x.
struct Floor {
  ViewScene scene;
  std::vector<uint32_t> patch_slot;
  template <class SlotAt>
  explicit Floor(SlotAt slot) {
    addSheet(scene, {0, 0, 0}, {0, 0, 4}, {16, 0, 0}, 4, 16);
    for (const formats::Node& n : scene.patches) patch_slot.push_back(slot(n.centroid.x));
  }
  std::vector<shaders::vec4> light(const std::vector<shaders::vec4>& slots) const {
    return patchLight(scene, weldScene(scene).neighbours, patch_slot, slots);
  }
};

TEST(ViewLight, FallsSteadilyFromClusterToCluster) {
  const Floor floor([](float x) { return static_cast<uint32_t>(x / 4); });  // four clusters of 4 x 4 patches
  const auto light = floor.light({{5, 5, 5, 0}, {5, 5, 5, 0}, {4, 4, 4, 0}, {4, 4, 4, 0}});
  for (uint32_t p = 0; p + 4 < 64; ++p) {  // the next one along x
    EXPECT_GT(light[p].x, light[p + 4].x - 1e-5f);
    EXPECT_LT(light[p].x - light[p + 4].x, 1.0f / 3) << "at x = " << floor.scene.patches[p].centroid.x;
  }
  for (uint32_t z = 0; z < 4; ++z) {
    EXPECT_FLOAT_EQ(light[z].x, 5);
    EXPECT_FLOAT_EQ(light[60 + z].x, 4);
  }
}

TEST(ViewLight, KeepsTheContrastOfClustersThatDifferMuch) {
  const Floor floor([](float x) { return static_cast<uint32_t>(x / 4); });
  const auto light = floor.light({{1, 1, 1, 0}, {1, 1, 1, 0}, {1000, 1000, 1000, 0}, {1000, 1000, 1000, 0}});
  for (uint32_t p = 0; p < 32; ++p) EXPECT_LT(light[p].x, 2);
  for (uint32_t p = 32; p < 64; ++p) EXPECT_GT(light[p].x, 990);
}

// One cluster lies on both sides of the wall, and the next, beyond it, is brighter.
TEST(ViewLight, DoesNotPassAWallWithinACluster) {
  for (const bool wall : {false, true}) {
    Floor floor([](float x) { return x < 4 ? 0u : x < 12 ? 1u : 2u; });
    if (wall) addSheet(floor.scene, {11, 0, -1}, {0, 2, 0}, {0, 0, 6}, 2, 6);
    floor.patch_slot.resize(floor.scene.patches.size(), 3);
    const auto light = floor.light({{1, 1, 1, 0}, {1, 1, 1, 0}, {2, 2, 2, 0}, {1, 1, 1, 0}});
    EXPECT_EQ(light[40].x > 1, !wall);  // at x = 10.5
    EXPECT_GT(light[44].x, 1);          // beyond the wall
  }
}

TEST(ViewLight, OfPatchesOfTheFinestLevelIsTheirOwn) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 4}, {16, 0, 0}, 4, 16);
  std::vector<uint32_t> patch_slot;  // 32 patches, then two clusters
  std::vector<shaders::vec4> slots;
  for (uint32_t p = 0; p < 64; ++p) patch_slot.push_back(p < 32 ? p : p < 48 ? 32 : 33);
  for (uint32_t s = 0; s < 34; ++s) slots.push_back({static_cast<float>(1 + s % 3), 1, 1, 0});
  const auto light = patchLight(scene, weldScene(scene).neighbours, patch_slot, slots);
  for (uint32_t p = 0; p < 32; ++p) EXPECT_EQ(light[p].x, slots[p].x);
}

TEST(ViewLight, SourceIsReflectedSunLampsAndSky) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 1}, {1, 0, 0}, 1, 1, {0.5f, 0.25f, 1}, {1, 2, 3});
  scene.patches[0].sky_fraction = 0.5f;
  scene.patches[0].sky_direction = {0, 0.5f, 0};
  scene.patches[0].sky_quadratic = {0, 0, 0, 0.25f, 0};
  scene.lamps[0] = {1, 0, 2};
  const runtime::Sky sky{{1, 1, 1}, {{0, 2, 0}, {0, 2, 0}, {0, 2, 0}}, {{0, 0, 0, 4, 0}, {0, 0, 0, 4, 0}, {0, 0, 0, 4, 0}}};
  const std::vector<float> exposure{0.5f};
  const auto m = patchSource(scene, exposure, {{0, 1, 0}, {4, 4, 4}}, sky);
  const double sky_irradiance = 3.14159265 * 0.5 * (1 + 2 * 0.5 + 4 * 0.25);
  EXPECT_NEAR(m[0], 0.5 * (2 + 1 + sky_irradiance), 1e-5);
  EXPECT_NEAR(m[1], 0.25 * (2 + sky_irradiance), 1e-5);
  EXPECT_NEAR(m[2], 1.0 * (2 + 2 + sky_irradiance), 1e-5);
}

}  // namespace
}  // namespace ff::view
