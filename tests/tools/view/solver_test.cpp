#include "tools/view/solver.h"

#include <gtest/gtest.h>

#include <fstream>

#include "formats/read/whole_world.h"
#include "runtime/choose_solver.h"
#include "tests/support/random_world.h"

namespace ff::view {
namespace {

TEST(CutSettings, AreTheOptionsThenWhatIsRecommendedThenTwentyFourCells) {
  const formats::TemporaryFolder folder;
  const std::string path = folder.file("w.ffm");
  ASSERT_TRUE(formats::writeWorld(formats::makeRandomWorld({}), path, 1 << 28));
  const auto world = formats::WholeWorld::open(path);
  ASSERT_TRUE(world);
  auto cut = cutSettings(*world, {}, {});
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->radius_m, 24 * world->info().cell_m);
  EXPECT_EQ(cut->max_level0_nodes, 0xffffffffu);
  const float growth = cut->growth;

  std::ofstream(runtime::settingsPath(path)) << R"({"solver": "gather", "radius_m": 9.5, "growth": 2, "max_patches": 700})";
  cut = cutSettings(*world, {}, {});
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->radius_m, 9.5f);
  EXPECT_EQ(cut->growth, 2.0f);
  EXPECT_EQ(cut->max_level0_nodes, 700u);
  cut = cutSettings(*world, {}, {.radius_m = 5, .max_patches = 9});
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->radius_m, 5.0f);
  EXPECT_EQ(cut->max_level0_nodes, 9u);
  cut = cutSettings(*world, {.kind = "gather"}, {});  // not `auto`
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->radius_m, 24 * world->info().cell_m);
  EXPECT_EQ(cut->growth, growth);

  std::ofstream(runtime::settingsPath(path)) << R"({"solver": "gather", "radius_m": -1})";
  EXPECT_FALSE(cutSettings(*world, {}, {}));
}

}  // namespace
}  // namespace ff::view
