#include "tools/view/camera.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "tests/tools/view/view_scenes.h"

namespace ff::view {
namespace {

class Camera : public testing::Test {
 protected:
  std::string file(const std::string& text) {
    const auto folder = std::filesystem::path(testing::TempDir()) / testing::UnitTest::GetInstance()->current_test_info()->name();
    std::filesystem::create_directories(folder);
    const std::string path = (folder / "camera.json").string();
    std::ofstream(path) << text;
    return path;
  }
};

TEST_F(Camera, FollowsStraightLinesBetweenKeys) {
  const auto c = readCamera(file(R"({"fps": 25, "keys": [{"t": 0, "eye": [0,1,0], "target": [1,1,0]},
    {"t": 2, "eye": [4,1,0], "target": [5,1,0]}, {"t": 3, "eye": [4,1,8], "target": [5,1,8]}],
    "sun": {"direction": [0,2,0], "irradiance": [3,2,1]}, "sky": {"l0": [1,1,1], "zenith": [0.5,0,0]}})"));
  ASSERT_TRUE(c) << c.error().line();
  EXPECT_EQ(c->fps, 25);
  EXPECT_EQ(c->at(0.5).eye, (Vec3{1, 1, 0}));
  EXPECT_EQ(c->at(2.5).eye, (Vec3{4, 1, 4}));
  EXPECT_EQ(c->at(-1).eye, (Vec3{0, 1, 0}));
  EXPECT_EQ(c->at(9).target, (Vec3{5, 1, 8}));
  EXPECT_NEAR(c->velocityAt(1).x, 2, 1e-4);
  EXPECT_NEAR(c->velocityAt(2.5).z, 8, 1e-4);
  ASSERT_TRUE(c->sun && c->sky);
  EXPECT_EQ(c->sun->to_sun, (Vec3{0, 1, 0}));
  EXPECT_EQ(c->sky->l1[0], (Vec3{0, 0.5f, 0}));
}

TEST_F(Camera, RefusesWhatIsNotAPathAndNamesThePlace) {
  const std::pair<const char*, const char*> cases[] = {
      {"nonsense", "JSON"},
      {R"({"keys": []})", "keys"},
      {R"({"keys": [{"t": 0, "eye": [0,1], "target": [1,1,0]}]})", "key 0"},
      {R"({"keys": [{"t": 0, "eye": [0,1,2], "target": [1,1,0]}, {"eye": [0,1,2], "target": [1,1,0]}]})", "key 1"},
      {R"({"keys": [{"t": 1, "eye": [0,1,2], "target": [1,1,0]}, {"t": 0, "eye": [0,1,2], "target": [1,1,0]}]})", "key 1"},
      {R"({"keys": [{"t": 0, "eye": [0,1,2], "target": [1,1,0]}], "sun": {"direction": [0,0,0], "irradiance": [1,1,1]}})", "sun"},
      {R"({"keys": [{"t": 0, "eye": [0,1,2], "target": [1,1,0]}], "sky": 3})", "sky"},
      {R"({"fps": 0, "keys": [{"t": 0, "eye": [0,1,2], "target": [1,1,0]}]})", "fps"}};
  for (const auto& [text, place] : cases) {
    const auto c = readCamera(file(text));
    ASSERT_FALSE(c) << text;
    EXPECT_EQ(c.error().code, ErrorCode::kInvalidFile);
    EXPECT_NE(c.error().line().find(place), std::string::npos) << c.error().line();
  }
  EXPECT_EQ(readCamera("/nonexistent/camera.json").error().code, ErrorCode::kIo);
}

// A file has the scene's coordinates, which a float may be too short for.
TEST_F(Camera, CountsFromTheOriginOfTheWorld) {
  const auto c = readCamera(file(R"({"keys": [{"t": 0, "eye": [10000000.25, 1, -4000000.5], "target": [10000001.25, 1, -4000000.5]}]})"), {1e7, 0, -4e6});
  ASSERT_TRUE(c) << c.error().line();
  EXPECT_EQ(c->keys[0].eye, (Vec3{0.25f, 1, -0.5f}));
  EXPECT_EQ(c->keys[0].target, (Vec3{1.25f, 1, -0.5f}));
}

// A closed box that is seen from inside (or from outside), cut into patches of about `cell` m.
void addBox(ViewScene& scene, Vec3 lo, Vec3 hi, float cell, bool inside, Vec3 emission = {}) {
  const Vec3 s = hi - lo;
  const auto cut = [&](float length) { return std::max(1, static_cast<int>(length / cell + 0.5f)); };
  const int nx = cut(s.x), ny = cut(s.y), nz = cut(s.z);
  const auto sheet = [&](Vec3 at, Vec3 u, Vec3 v, int nu, int nv) {
    if (inside)
      addSheet(scene, at, u, v, nu, nv, {0.5f, 0.5f, 0.5f}, emission);
    else
      addSheet(scene, at, v, u, nv, nu, {0.5f, 0.5f, 0.5f}, emission);
  };
  const Vec3 x{s.x, 0, 0}, y{0, s.y, 0}, z{0, 0, s.z};
  sheet(lo, z, x, nz, nx);
  sheet(lo + y, x, z, nx, nz);
  sheet(lo, x, y, nx, ny);
  sheet(lo + z, y, x, ny, nx);
  sheet(lo, y, z, ny, nz);
  sheet(lo + x, z, y, nz, ny);
}

// A closed room of 12 x 3 x 8 m: the eye must be inside, as high as people's, look along it and stay clear of the walls.
TEST_F(Camera, FindsAPathInsideAClosedRoom) {
  ViewScene scene;
  addBox(scene, {0, 0, 0}, {12, 3, 8}, 1, true);
  EXPECT_EQ(openness(scene), 0);
  const CameraPath path = findPath(scene);
  for (double t = path.start(); t <= path.end(); t += 0.5) {
    const Vec3 eye = path.at(t).eye;
    EXPECT_GT(eye.x, 0.4f);
    EXPECT_LT(eye.x, 11.6f);
    EXPECT_NEAR(eye.y, 1.6f, 0.01f);
    EXPECT_GT(eye.z, 0.4f);
    EXPECT_LT(eye.z, 7.6f);
  }
  const Vec3 look = path.at(0).target - path.at(0).eye;
  EXPECT_GT(length(look), 5);
}

TEST_F(Camera, WalksOverAnOpenLandscapeAtEyeHeight) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 40}, {40, 0, 0}, 40, 40);
  for (int i = 0; i < 6; ++i) {  // something to look at
    const float x = 4 + 6 * static_cast<float>(i);
    addBox(scene, {x, 0, 20}, {x + 1, 2 + static_cast<float>(i % 3), 21}, 1, false);
  }
  for (formats::Node& n : scene.patches) n.sky_fraction = 1;
  EXPECT_EQ(openness(scene), 1);
  const CameraPath path = findPath(scene);
  for (double t = path.start(); t <= path.end(); t += 0.5) EXPECT_NEAR(path.at(t).eye.y, 1.6f, 0.01f);
  EXPECT_GT(length(path.at(path.end()).eye - path.at(0).eye), 0.5f);
}

// Two yards that have the same in them; lamps light one of them.
TEST_F(Camera, StandsByNightWhereLampsLightWhatIsInThePicture) {
  for (const float lit_side : {-1.0f, 1.0f}) {
    ViewScene scene;
    addSheet(scene, {-60, 0, -20}, {0, 0, 40}, {120, 0, 0}, 40, 120);
    for (const float side : {-1.0f, 1.0f})
      for (int i = 0; i < 5; ++i) {
        const float x = side * (20 + 6 * static_cast<float>(i));
        addBox(scene, {x, 0, 4}, {x + 1, 2 + static_cast<float>(i % 3), 5}, 1, false);
      }
    scene.lamps.clear();
    for (formats::Node& n : scene.patches) {
      n.sky_fraction = 1;
      n.albedo = {0.5f, 0.5f, 0.5f};
      const float far = std::abs(n.centroid.x - lit_side * 32) / 10;
      scene.lamps.push_back(Vec3{1, 1, 1} / (1 + far * far * far * far));
    }
    const CameraPath path = findPath(scene, true);
    EXPECT_NEAR(path.at(0).eye.x, lit_side * 32, 16);
    const Vec3 ahead = normalized(path.at(0).target - path.at(0).eye);
    EXPECT_NEAR((path.at(0).eye + ahead * 8).x, lit_side * 32, 20);
  }
}

// A furnished room with a flat roof, a cupboard that a person would fit into, a table, on a wide empty ground.
TEST_F(Camera, StandsInTheFurnishedRoomNotOnItsRoofNorInACupboardNorOnATable) {
  for (const float turned : {0.0f, 1.0f}) {
    ViewScene scene;
    scene.cell_m = 0.25f;
    addSheet(scene, {-60, -0.3f, -60}, {0, 0, 120}, {120, 0, 0}, 60, 60);  // the ground
    addBox(scene, {0, 0, 0}, {6, 2.6f, 5}, 0.25f, true);
    addBox(scene, {-0.3f, -0.3f, -0.3f}, {6.3f, 2.9f, 5.3f}, 0.25f, false);  // the house
    for (formats::Node& n : scene.patches) n.sky = n.centroid.y > 2.7f || std::abs(n.centroid.x) > 7 ? n.quanta : 0;
    addBox(scene, {2.6f, 2.5f, 2}, {3.2f, 2.55f, 2.6f}, 0.25f, false, {100, 100, 100});  // a lamp
    addBox(scene, {1.6f, 0.7f, 1.4f}, {4.4f, 0.75f, 3.2f}, 0.1f, false);                // a table
    addBox(scene, {5.0f, 0, 0.1f}, {5.9f, 2.4f, 1.6f}, 0.1f, false);                    // a cupboard,
    addBox(scene, {5.02f, 0.02f, 0.12f}, {5.88f, 2.38f, 1.58f}, 0.05f, true);           // and what is inside
    for (int i = 0; i < 4; ++i) {                                                       // chairs
      const float x = 1.8f + 0.65f * static_cast<float>(i);
      addBox(scene, {x, 0.4f, 3.4f}, {x + 0.4f, 0.45f, 3.8f}, 0.05f, false);
    }
    if (turned > 0)  // all of it the other way round
      for (Vec3& p : scene.corners) p = {-p.x, p.y, -p.z};
    if (turned > 0)
      for (formats::Node& n : scene.patches) {
        n.centroid = {-n.centroid.x, n.centroid.y, -n.centroid.z};
        n.normal = {-n.normal.x, n.normal.y, -n.normal.z};
      }
    scene.bounds = {};
    for (const Vec3 p : scene.corners) scene.bounds.add(p);
    const CameraPath path = findPath(scene);
    for (double t = path.start(); t <= path.end(); t += 0.5) {
      const Vec3 eye = path.at(t).eye * Vec3{turned > 0 ? -1.0f : 1.0f, 1, turned > 0 ? -1.0f : 1.0f};
      EXPECT_NEAR(eye.y, 1.6f, 0.01f) << eye.x << " " << eye.z;
      EXPECT_TRUE(eye.x > 0.4f && eye.x < 5.6f && eye.z > 0.4f && eye.z < 4.6f) << eye.x << " " << eye.z;
      EXPECT_FALSE(eye.x > 4.9f && eye.z < 1.7f) << "in the cupboard";
    }
  }
}

TEST_F(Camera, LooksAtAllThereIsFromOutsideWhereNobodyCanStand) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {4, 0, 0}, {0, 3, 0}, 4, 3);  // a single wall
  const CameraPath path = findPath(scene);
  EXPECT_GT(length(path.at(0).eye - Vec3{2, 1.5f, 0}), 4);
  EXPECT_EQ(path.at(0).target, (Vec3{2, 1.5f, 0}));
}

}  // namespace
}  // namespace ff::view
