// A world of several files is the world of one.
#include "bake/import/files.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <set>

#include "bake/bake.h"
#include "tests/support/random_world.h"
#include "tools/scene/analytic.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace ff::bake {
namespace {

// Shards are named by their content.
std::set<std::string> shardsOf(const std::string& folder) {
  std::set<std::string> names;
  for (const auto& file : std::filesystem::directory_iterator(folder))
    if (file.path().extension() == ".ffs") names.insert(file.path().filename());
  return names;
}

// A town cut into files along no line in particular: every part of its one node is a file, and shares edges with the others.
TEST(SceneFiles, OfOneTownBakeToTheShardsOfTheTown) {
  const formats::TemporaryFolder folder;
  const auto town = tools::makeTown({.patches = 2000});
  ASSERT_TRUE(town);
  const tools::SceneModel whole = tools::townModel(*town, false);
  ASSERT_TRUE(tools::writeGlb(whole, folder.file("whole.glb")));
  std::filesystem::create_directories(folder.file("tiles"));
  size_t files = 0;
  for (const tools::SceneNode& node : whole.nodes)
    for (const tools::ScenePart& part : node.parts) {
      tools::SceneModel tile = whole;
      tile.nodes = {{node.name, {part}}};
      ASSERT_TRUE(tools::writeGlb(tile, folder.file("tiles/" + std::to_string(100 + files++) + ".glb")));
    }
  ASSERT_GT(files, 4u);
  const std::vector<std::string> paths = {folder.file("tiles")};
  const auto listed = sceneFiles(paths);
  ASSERT_TRUE(listed) << listed.error().line();
  EXPECT_EQ(listed->size(), files);
  const auto joined = importFiles(*listed), one = importGltf(folder.file("whole.glb"));
  ASSERT_TRUE(joined) << joined.error().line();
  ASSERT_TRUE(one);
  EXPECT_EQ(joined->triangles.size(), one->triangles.size());
  EXPECT_EQ(joined->name, "100.glb and " + std::to_string(files - 1) + " more");
  EXPECT_NE(joined->content_hash, one->content_hash);
  for (const char* name : {"a", "b"}) std::filesystem::create_directories(folder.file(name));
  const BakeSettings settings{.cell_m = 1, .rays = 64, .quanta = 64};
  ASSERT_TRUE(bakeWorld(*one, settings, folder.file("a/w.ffm")));
  ASSERT_TRUE(bakeWorld(*joined, settings, folder.file("b/w.ffm")));
  EXPECT_GE(shardsOf(folder.file("a")).size(), 3u);
  EXPECT_EQ(shardsOf(folder.file("a")), shardsOf(folder.file("b")));
}

TEST(SceneFiles, FarFromZeroShareOneOrigin) {
  const formats::TemporaryFolder folder;
  tools::SceneModel cap = tools::sphericalCap(60, 16, 0.5f, 1), beside = cap;
  for (auto* model : {&cap, &beside})
    for (Vec3& p : model->nodes[0].parts[0].positions) p += Vec3{1048576, 0, model == &cap ? 0.0f : 1024.0f};
  ASSERT_TRUE(tools::writeGlb(cap, folder.file("a.glb")));
  ASSERT_TRUE(tools::writeGlb(beside, folder.file("b.glb")));
  const std::vector<SceneFile> files = {{folder.file("a.glb")}, {folder.file("b.glb")}};
  const auto scene = importFiles(files);
  ASSERT_TRUE(scene) << scene.error().line();
  ASSERT_NE(scene->origin[0], 0);
  const size_t half = scene->positions.size() / 2;
  for (size_t i = 0; i < half; ++i) EXPECT_EQ(scene->positions[half + i], (scene->positions[i] + Vec3{0, 0, 1024}));
  EXPECT_EQ(scene->triangles.back().material, scene->materials.size() - 1);
}

TEST(SceneFiles, ThatAreMissingAreNamed) {
  const formats::TemporaryFolder folder;
  std::filesystem::create_directories(folder.file("empty"));
  const std::vector<std::string> empty = {folder.file("empty")};
  const auto none = sceneFiles(empty);
  ASSERT_FALSE(none);
  EXPECT_NE(none.error().line().find("no .glb"), std::string::npos);
  ASSERT_TRUE(tools::writeGlb(tools::furnaceBox(0.5f, 1), folder.file("a.glb")));
  const std::vector<SceneFile> files = {{folder.file("a.glb")}, {folder.file("absent.glb")}};
  const auto missing = importFiles(files);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().file, folder.file("absent.glb"));
  EXPECT_FALSE(importFiles({}));
}

void write(const std::string& path, const std::string& text) { std::ofstream(path) << text; }

TEST(SceneFiles, StandWhereAListPutsThem) {
  const formats::TemporaryFolder folder;
  std::filesystem::create_directories(folder.file("parts/houses"));
  ASSERT_TRUE(tools::writeGlb(tools::furnaceBox(0.5f, 1), folder.file("parts/box.glb")));
  ASSERT_TRUE(tools::writeGlb(tools::furnaceBox(0.5f, 1), folder.file("parts/houses/one.glb")));
  // As it is; turned by a quarter about y, doubled and moved; mirrored by a matrix, with all files of a folder.
  write(folder.file("parts/world.json"), R"({"files": ["box.glb",
    {"path": "box.glb", "translation": [10, 0, 5], "rotation": [0, 0.70710678118654752, 0, 0.70710678118654752], "scale": [2, 2, 2]},
    {"path": "houses", "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 20, 0, 1]}]})");
  const std::vector<std::string> list = {folder.file("parts/world.json")};
  const auto files = sceneFiles(list);
  ASSERT_TRUE(files) << files.error().line();
  ASSERT_EQ(files->size(), 3u);
  const auto scene = importFiles(*files);
  ASSERT_TRUE(scene) << scene.error().line();
  const size_t n = scene->positions.size() / 3;
  const auto normalOf = [&](size_t t) {
    const auto& v = scene->triangles[t].v;
    return cross(scene->positions[v[1]] - scene->positions[v[0]], scene->positions[v[2]] - scene->positions[v[0]]);
  };
  for (size_t i = 0; i < n; ++i) {
    const Vec3 p = scene->positions[i], turned = scene->positions[n + i], mirrored = scene->positions[2 * n + i];
    EXPECT_LT(length(turned - Vec3{10 + 2 * p.z, 2 * p.y, 5 - 2 * p.x}), 1e-5f);
    EXPECT_LT(length(mirrored - Vec3{-p.x, p.y + 20, p.z}), 1e-5f);
  }
  const size_t triangles = scene->triangles.size() / 3;
  for (size_t t = 0; t < triangles; ++t) {  // fronts stay fronts
    const Vec3 front = normalOf(t), turned = normalOf(triangles + t), mirrored = normalOf(2 * triangles + t);
    EXPECT_LT(length(turned - Vec3{front.z, front.y, -front.x} * 4), 1e-4f);
    EXPECT_LT(length(mirrored - Vec3{-front.x, front.y, front.z}), 1e-4f);
  }
}

TEST(SceneFiles, AListThatIsWrongIsRefusedInOneLine) {
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(tools::writeGlb(tools::furnaceBox(0.5f, 1), folder.file("a.glb")));
  const std::vector<std::string> list = {folder.file("world.json")};
  for (const auto& [text, words] : {std::pair{"", "not a list"}, {"[]", "not a list"}, {R"({"files": []})", "not a list"}, {R"({"files": [7]})", "file 0"},
                                    {R"({"files": ["a.glb", {"path": "a.glb", "translate": [1, 2, 3]}]})", "file 1: \"translate\" is not known"},
                                    {R"({"files": [{"path": "a.glb", "translation": [1, 2]}]})", "file 0"},
                                    {R"({"files": [{"path": "a.glb", "rotation": [1, 1, 0, 0]}]})", "unit quaternion"},
                                    {R"({"files": [{"path": "a.glb", "scale": [1, 0, 1]}]})", "scale is zero"},
                                    {R"({"files": [{"translation": [1, 2, 3]}]})", "path must name"},
                                    {R"({"files": ["world.json"]})", "path must name"}}) {
    write(folder.file("world.json"), text);
    const auto files = sceneFiles(list);
    ASSERT_FALSE(files) << text;
    EXPECT_EQ(files.error().code, ErrorCode::kInvalidFile);
    EXPECT_EQ(files.error().file, list[0]);
    EXPECT_NE(files.error().line().find(words), std::string::npos) << files.error().line();
  }
  write(folder.file("world.json"), R"({"files": ["absent.glb"]})");
  EXPECT_FALSE(importFiles(*sceneFiles(list)));
  const std::vector<std::string> absent = {folder.file("absent.json")};
  EXPECT_EQ(sceneFiles(absent).error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace ff::bake
