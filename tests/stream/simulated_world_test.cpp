// A world of 1e9 patches, alike everywhere (tests/support/simulated_world.h): it opens, the streamer flies through it, and it closes.
#include <gtest/gtest.h>

#include "formats/read/whole_world.h"
#include "stream/streamer.h"
#include "tests/support/random_world.h"
#include "tests/support/simulated_world.h"

namespace ff::stream {
namespace {

// A small one keeps every rule that is checked where all of a world is read; the large one is made in the same way.
TEST(SimulatedWorld, KeepsTheRulesOfTheFormat) {
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(formats::writeSimulatedWorld(folder.file("w.ffm"), 4));
  const auto world = formats::WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  EXPECT_EQ(world->levels()[0].nodes, 64u * 16 * 248);
  EXPECT_EQ(world->chunks(0).size(), 64u);
  for (const formats::TileInfo& tile : world->tiles(1)) {
    const auto strip = world->strip(tile.id);
    ASSERT_TRUE(strip) << strip.error().line();
  }
}

TEST(SimulatedWorld, OfABillionPatchesOpensFliesAndCloses) {
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(formats::writeSimulatedWorld(folder.file("w.ffm"), 10));
  const auto world = formats::World::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  EXPECT_GT(world->levels()[0].nodes, 1000000000u);
  auto streamer = Streamer::create(*world, {});
  ASSERT_TRUE(streamer) << streamer.error().line();
  for (const float x : {4000.0f, 4010.0f, 12000.0f, 15990.0f}) {  // a step, and two teleports
    (*streamer)->update({x, 2, 9000}, {});
    ASSERT_TRUE((*streamer)->settle());
    uint32_t patches = 0;
    for (const StripPtr& strip : (*streamer)->active())
      if (strip->id.level == 0) {
        patches += static_cast<uint32_t>(strip->nodes.size());
        EXPECT_LT(strip->tile.info().bounds.distance({x, 2, 9000}), 1.2f * StreamSettings{}.radius_m);
      }
    EXPECT_GT(patches, 400u);
    EXPECT_EQ((*streamer)->stats().failed, 0u) << (*streamer)->lastFailure();
  }
}

}  // namespace
}  // namespace ff::stream
