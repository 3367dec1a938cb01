#include "tools/view_camera.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "tests/tools/view_scenes.h"

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

// A closed room of 12 x 3 x 8 m: the eye must be inside, look along it and stay clear of the walls.
TEST_F(Camera, FindsAPathInsideAClosedRoom) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 8}, {12, 0, 0}, 8, 12);
  addSheet(scene, {0, 3, 0}, {12, 0, 0}, {0, 0, 8}, 12, 8);
  addSheet(scene, {0, 0, 0}, {12, 0, 0}, {0, 3, 0}, 12, 3);
  addSheet(scene, {0, 0, 8}, {0, 3, 0}, {12, 0, 0}, 3, 12);
  addSheet(scene, {0, 0, 0}, {0, 3, 0}, {0, 0, 8}, 3, 8);
  addSheet(scene, {12, 0, 0}, {0, 0, 8}, {0, 3, 0}, 8, 3);
  EXPECT_EQ(openness(scene), 0);
  const CameraPath path = findPath(scene);
  for (double t = path.start(); t <= path.end(); t += 0.5) {
    const Vec3 eye = path.at(t).eye;
    EXPECT_GT(eye.x, 0.5f);
    EXPECT_LT(eye.x, 11.5f);
    EXPECT_GT(eye.y, 0.5f);
    EXPECT_LT(eye.y, 2.5f);
    EXPECT_GT(eye.z, 0.5f);
    EXPECT_LT(eye.z, 7.5f);
  }
  const Vec3 look = path.at(0).target - path.at(0).eye;
  EXPECT_GT(length(look), 6);
}

TEST_F(Camera, FindsAPathAboveAnOpenLandscape) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 40}, {40, 0, 0}, 40, 40);
  for (formats::Node& n : scene.patches) n.sky = n.quanta;
  EXPECT_EQ(openness(scene), 1);
  const CameraPath path = findPath(scene);
  for (double t = path.start(); t <= path.end(); t += 0.5) {
    EXPECT_GT(path.at(t).eye.y, 2);
    EXPECT_LT(path.at(t).target.y, path.at(t).eye.y);
  }
}

}  // namespace
}  // namespace ff::view
