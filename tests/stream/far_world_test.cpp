// How often a reader waits for a storage that is slow to answer.
#include <gtest/gtest.h>

#include "formats/read/whole_world.h"
#include "stream/path_planner.h"
#include "stream/streamer.h"
#include "tests/support/round_trips.h"
#include "tests/support/synthetic_world.h"

namespace ff::stream {
namespace {

class FarWorld : public testing::Test {
 protected:
  static constexpr uint32_t kLevels = 6;
  static void SetUpTestSuite() {
    folder_ = std::make_unique<formats::TemporaryFolder>();
    const auto written = formats::writeWorld(makeSyntheticWorld({.side = 256, .levels = kLevels, .tile_nodes = 64, .quanta = 15}), path(), 1 << 26);
    ASSERT_TRUE(written) << written.error().line();
  }
  static void TearDownTestSuite() { folder_.reset(); }
  static std::string path() { return folder_->file("w.ffm"); }
  // As one who knows nothing of it.
  std::unique_ptr<formats::World> open() {
    auto opened = formats::World::open(path(), storage_);
    EXPECT_TRUE(opened) << opened.error().line();
    storage_->trips = storage_->reads = 0;
    return std::make_unique<formats::World>(std::move(*opened));
  }

  static inline std::unique_ptr<formats::TemporaryFolder> folder_;
  const std::shared_ptr<formats::RoundTrips> storage_ = std::make_shared<formats::RoundTrips>(formats::posixStorage());
};

TEST_F(FarWorld, TheIndexOfAStripsPartnersIsReadALevelAtATime) {
  const auto whole = formats::WholeWorld::open(path());
  ASSERT_TRUE(whole) << whole.error().line();
  for (const uint32_t number : {0u, 300u, whole->levels()[0].tiles - 1}) {
    const auto world = open();
    const auto tile = world->tile({0, number});
    ASSERT_TRUE(tile) << tile.error().line();
    storage_->trips = storage_->reads = 0;
    const auto strip = world->strip(*tile), same = whole->strip(formats::TileId{0, number});
    ASSERT_TRUE(strip && same);
    EXPECT_GT(storage_->reads, 3 * kLevels);
    EXPECT_LE(storage_->trips, 2 * kLevels) << storage_->reads << " chunks; a cell may have several records";
    ASSERT_EQ(strip->blocks.size(), same->blocks.size());
    for (size_t b = 0; b < same->blocks.size(); ++b) EXPECT_EQ(strip->blocks[b].partner_tile, same->blocks[b].partner_tile);
  }
}

TEST_F(FarWorld, TheIndexAroundAnObserverIsReadALevelAtATime) {
  const auto world = open();
  const auto streamer = Streamer::create(*world, {.radius_m = 40, .hysteresis = 1});
  ASSERT_TRUE(streamer) << streamer.error().line();
  (*streamer)->update({100, 1, 100}, {});
  ASSERT_TRUE((*streamer)->settle());
  EXPECT_EQ((*streamer)->active().front()->id.level, 0u);
  EXPECT_GT(storage_->reads, 60u);
  EXPECT_LT(storage_->trips, 4 * kLevels) << storage_->reads << " chunks";
}

TEST_F(FarWorld, TheIndexOnTheWayIsReadALevelAtATime) {
  const auto world = open();
  std::vector<formats::ChunkPtr> top;
  for (uint32_t k = 0; k < world->root()->children.size(); ++k) top.push_back(*world->child(world->root(), k));
  PathPlanner planner(*world, {.radius_m = 8, .ahead_seconds = 3}, top);
  storage_->trips = storage_->reads = 0;
  planner.aim(Observer{{4, 1, 4}, {60, 0, 60}}, {}, 0, {});
  planner.await();
  auto plan = std::make_unique<PathPlanner::Plan>();
  planner.take(plan);
  EXPECT_GT(plan->tiles.size(), 100u);
  EXPECT_EQ(plan->chunks.size(), storage_->reads);
  EXPECT_GT(storage_->reads, 3 * kLevels);
  EXPECT_LE(storage_->trips, kLevels) << storage_->reads << " chunks";
}

}  // namespace
}  // namespace ff::stream
