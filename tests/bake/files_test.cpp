// A world of several files is the world of one.
#include "bake/import/files.h"

#include <gtest/gtest.h>

#include <filesystem>
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
  const std::vector<std::string> files = {folder.file("a.glb"), folder.file("b.glb")};
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
  const std::vector<std::string> files = {folder.file("a.glb"), folder.file("absent.glb")};
  const auto missing = importFiles(files);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().file, folder.file("absent.glb"));
  EXPECT_FALSE(importFiles({}));
}

}  // namespace
}  // namespace ff::bake
