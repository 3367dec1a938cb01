#include "stream/streamer.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cmath>
#include <filesystem>
#include <future>
#include <limits>
#include <set>

#include "formats/read/whole_world.h"
#include "stream/file_source.h"
#include "stream/path_planner.h"
#include "stream/wanted_tiles.h"
#include "tests/stream/test_sources.h"
#include "tests/support/furnace_world.h"
#include "tests/support/synthetic_world.h"

namespace ff::stream {
namespace {

using formats::TileId;

class StreamerTest : public testing::Test {
 protected:
  StreamerTest() {
    const auto written = formats::writeWorld(makeSyntheticWorld({.side = 64, .levels = 5, .tile_nodes = 32}),
                                             folder_.file("w.ffm"), 1 << 20);
    if (!written) throw std::runtime_error(written.error().line());
    auto opened = formats::WholeWorld::open(folder_.file("w.ffm"));
    if (!opened) throw std::runtime_error(opened.error().line());
    world_ = std::make_unique<formats::WholeWorld>(std::move(*opened));
    const auto files = makeThreadSource(*world_, 1);
    for (uint32_t level = 0; level < world_->levels().size(); ++level)
      for (const formats::TileInfo& info : world_->tiles(level)) {
        std::promise<std::vector<std::byte>> promise;
        files->read(info.id, info.strip, {},
                    [&](TileId, Result<std::vector<std::byte>> bytes) { promise.set_value(std::move(*bytes)); });
        bytes_[info.id] = promise.get_future().get();
      }
  }

  std::unique_ptr<MemorySource> memory(uint64_t seed = 1, FateOf fate = nullptr) const {
    return std::make_unique<MemorySource>(bytes_, seed, std::move(fate));
  }
  // Where neighbours share reads.
  std::unique_ptr<MemorySource> sharing(uint64_t seed = 1, FateOf fate = nullptr, SharedReads allowed = kShared) const {
    MemorySource::Sharing sharing{allowed, {}};
    for (const auto& [id, bytes] : bytes_) sharing.extents[id] = world_->tiles(id.level)[id.tile].strip;
    return std::make_unique<MemorySource>(bytes_, seed, std::move(fate), std::move(sharing));
  }
  static constexpr SharedReads kShared{.gap_bytes = 2000, .max_bytes = 20000, .strips_per_read = 2};
  std::unique_ptr<Streamer> make(const StreamSettings& settings, std::unique_ptr<TileSource> source = nullptr) const {
    auto streamer = Streamer::create(*world_, settings, std::move(source));
    EXPECT_TRUE(streamer) << streamer.error().line();
    return std::move(*streamer);
  }
  static std::vector<TileId> ids(const Streamer& streamer) {
    std::vector<TileId> ids;
    for (const StripPtr& strip : streamer.active()) ids.push_back(strip->id);
    return ids;
  }
  static std::vector<TileId> settledAt(Streamer& streamer, Vec3 observer) {
    streamer.update(observer, {});
    EXPECT_TRUE(streamer.settle());
    return ids(streamer);
  }
  uint32_t top() const { return static_cast<uint32_t>(world_->levels().size() - 1); }
  // All tiles of all nodes' parents.
  std::set<TileId> parentsOf(TileId id) const {
    std::set<TileId> parents;
    const formats::TileInfo& info = world_->tiles(id.level)[id.tile];
    for (uint32_t i = 0; id.level < top() && i < info.nodes; ++i)
      parents.insert({id.level + 1, world_->tileOf(id.level + 1, world_->parent(id.level, info.first_node + i))});
    return parents;
  }
  // The wanted set by definition, from all tiles of the world. No budgets, no history.
  std::vector<TileId> wantedByDefinition(Vec3 observer, float radius_m, float growth, float beyond_m = 0) const {
    std::set<TileId> wanted;
    for (uint32_t level = top() + 1; level-- > 0;)
      for (const formats::TileInfo& info : world_->tiles(level)) {
        bool in =
            level == top() || info.bounds.distance(observer) < radius_m * std::pow(growth, static_cast<float>(level)) + beyond_m;
        for (const TileId parent : parentsOf(info.id)) in = in && wanted.count(parent) != 0;
        if (in) wanted.insert(info.id);
      }
    return {wanted.begin(), wanted.end()};
  }
  // The level-0 radius from which on a tile is wanted: its own and its ancestors' (growth 1.6).
  float reach(TileId id, Vec3 observer) const {
    if (id.level == top()) return 0;
    float reach =
        world_->tiles(id.level)[id.tile].bounds.distance(observer) / std::pow(1.6f, static_cast<float>(id.level));
    for (const TileId parent : parentsOf(id)) reach = std::max(reach, this->reach(parent, observer));
    return reach;
  }
  Vec3 randomPlace(std::mt19937_64& random) const {
    return {static_cast<float>(random() % 6400) / 100, 1, static_cast<float>(random() % 6400) / 100};
  }

  formats::TemporaryFolder folder_;
  std::unique_ptr<formats::WholeWorld> world_;
  std::map<TileId, std::vector<std::byte>> bytes_;
};

const StreamSettings kNoHistory{.radius_m = 6, .growth = 1.6f, .hysteresis = 1.0f};

TEST_F(StreamerTest, SettlesOnTheTilesThatTheDefinitionNames) {
  for (const bool background : {false, true}) {
    StreamSettings settings = kNoHistory;
    settings.background = background;
    const auto streamer = make(settings);
    std::mt19937_64 random(1);
    size_t level0 = 0;
    for (int i = 0; i < 30; ++i) {
      const Vec3 at = randomPlace(random);
      const auto settled = settledAt(*streamer, at);
      ASSERT_EQ(settled, wantedByDefinition(at, 6, 1.6f));
      level0 += settled.front().level == 0;
    }
    EXPECT_GT(level0, 20u);
  }
}

TEST_F(StreamerTest, SettledSetWithoutHysteresisIsAFunctionOfTheObserverAlone) {
  for (const StreamSettings& settings :
       {kNoHistory, StreamSettings{.radius_m = 6, .hysteresis = 1.0f, .memory_bytes = 200000},
        StreamSettings{.radius_m = 12, .hysteresis = 1.0f, .max_level0_nodes = 200},
        StreamSettings{.radius_m = 12, .hysteresis = 1.0f, .max_nodes = 600}}) {
    const auto wandering = make(settings, memory(7));
    std::mt19937_64 random(2);
    for (int i = 0; i < 20; ++i) {
      for (int step = 0; step < 5; ++step) wandering->update(randomPlace(random), {1, 0, 2});
      const Vec3 at = randomPlace(random);
      const auto fresh = make(settings, memory(8));
      ASSERT_EQ(settledAt(*wandering, at), settledAt(*fresh, at));
    }
  }
}

TEST_F(StreamerTest, ActiveTilesAlwaysHaveActiveParentsAndTheTopLevelNeverLeaves) {
  for (const bool background : {false, true}) {
    const auto streamer = make({.radius_m = 9, .hysteresis = 1.2f, .background = background}, memory(3));
    std::mt19937_64 random(4);
    int changes = 0;
    Vec3 at;
    for (int i = 0; i < 300 || (i < 10000 && changes < 100); ++i) {
      if (i % 10 == 0) at = randomPlace(random);
      if (streamer->update(at, {}))
        ++changes;
      else
        std::this_thread::sleep_for(std::chrono::microseconds(500));
      const auto active = ids(*streamer);
      ASSERT_TRUE(std::is_sorted(active.begin(), active.end()));
      const std::set<TileId> in(active.begin(), active.end());
      for (const TileId id : active)
        for (const TileId parent : parentsOf(id)) ASSERT_TRUE(in.count(parent));
      for (const formats::TileInfo& info : world_->tiles(top())) ASSERT_TRUE(in.count(info.id));
    }
    EXPECT_GE(changes, 100);
  }
}

TEST_F(StreamerTest, HysteresisKeepsATileThatADistanceWithoutHistoryWouldNotWant) {
  const auto plain = make({.radius_m = 6, .hysteresis = 1.0f}, memory());
  const auto sticky = make({.radius_m = 6, .hysteresis = 1.3f}, memory());
  size_t kept = 0;
  for (float x = 10; x < 50; x += 0.25f) {
    const auto without = settledAt(*plain, {x, 1, 30}), with = settledAt(*sticky, {x, 1, 30});
    ASSERT_TRUE(std::includes(with.begin(), with.end(), without.begin(), without.end()));
    for (const TileId id : with)
      if (id.level < top()) {
        const float reach = 6 * std::pow(1.6f, static_cast<float>(id.level));
        ASSERT_LT(world_->tiles(id.level)[id.tile].bounds.distance({x, 1, 30}), 1.3f * reach * 1.0001f);
      }
    kept += with.size() - without.size();
  }
  EXPECT_GT(kept, 0u);
}

TEST_F(StreamerTest, ABudgetAdmitsTheNearestTilesFirst) {
  const auto budgeted = make({.radius_m = 20, .growth = 1.6f, .hysteresis = 1.0f, .max_level0_nodes = 300}, memory());
  std::mt19937_64 random(5);
  for (int i = 0; i < 10; ++i) {
    const Vec3 at = randomPlace(random);
    const auto settled = settledAt(*budgeted, at);
    uint32_t level0 = 0;
    float farthest = 0;
    for (const TileId id : settled)
      if (id.level == 0) {
        level0 += world_->tiles(0)[id.tile].nodes;
        farthest = std::max(farthest, reach(id, at));
      }
    ASSERT_LE(level0, 300u);
    ASSERT_GT(level0, 200u);
    for (const TileId id : wantedByDefinition(at, 20, 1.6f))
      if (id.level == 0 && reach(id, at) < farthest) {
        ASSERT_TRUE(std::binary_search(settled.begin(), settled.end(), id));
      }
  }
}

// Growth 1.6, and 1.4 at least: what lies within the radii of that is there first.
TEST_F(StreamerTest, ABudgetOfNodesActsAsASmallerGrowthFirst) {
  std::mt19937_64 random(15);
  size_t less = 0;
  for (int i = 0; i < 20; ++i) {
    const Vec3 at = randomPlace(random);
    const std::vector<TileId> least = wantedByDefinition(at, 8, 1.4f), most = wantedByDefinition(at, 8, 1.6f);
    const auto nodes = [&](const std::vector<TileId>& tiles) {
      uint32_t sum = 0;
      for (const TileId id : tiles) sum += world_->tiles(id.level)[id.tile].nodes;
      return sum;
    };
    for (const uint32_t budget : {nodes(least), (nodes(least) + nodes(most)) / 2, nodes(most)}) {
      const auto streamer = make({.radius_m = 8, .growth = 1.6f, .hysteresis = 1.0f, .max_nodes = budget}, memory());
      const auto settled = settledAt(*streamer, at);
      ASSERT_LE(nodes(settled), budget);
      ASSERT_TRUE(std::ranges::includes(settled, least));
      ASSERT_TRUE(std::ranges::includes(most, settled));
      less += settled.size() < most.size();
      const Reach reach = streamer->stats().reach;
      EXPECT_EQ(reach.short_of, settled.size() < most.size() ? Budget::kNodes : Budget::kNone);
      EXPECT_TRUE(std::ranges::includes(settled, wantedByDefinition(at, reach.radius_m - 1e-3f, reach.growth - 1e-4f)));
      EXPECT_GE(reach.growth, 1.4f - 1e-4f);
      EXPECT_EQ(reach == (Reach{8, 1.6f}), settled.size() == most.size());
    }
    EXPECT_EQ(settledAt(*make({.radius_m = 8, .growth = 1.6f, .hysteresis = 1.0f, .max_nodes = nodes(most)}, memory()), at), most);
  }
  EXPECT_GT(less, 10u);
}

// Level 0 is wanted so far ahead as its light takes; coarser levels less far by half of what they reach farther by themselves.
TEST_F(StreamerTest, TheLeadIsThatOfWhatIsShown) {
  const auto streamer = make({.radius_m = 6, .growth = 1.6f, .hysteresis = 1.0f}, memory());
  streamer->setLead({.active_seconds = 0.1f, .shown_seconds = 0.5f});
  const Vec3 at{20, 1, 30}, velocity{20, 0, 0};
  const auto nearTheWay = [&](uint32_t level, float ahead_m) {
    std::set<TileId> near;
    for (const formats::TileInfo& info : world_->tiles(level)) {
      float nearest = 1e9f;
      for (float m = 0; m <= ahead_m; m += 0.01f) nearest = std::min(nearest, info.bounds.distance(at + Vec3{m, 0, 0}));
      if (nearest < 6 * std::pow(1.6f, static_cast<float>(level)) - 0.05f) near.insert(info.id);
    }
    return near;
  };
  streamer->update(at, velocity);
  ASSERT_TRUE(streamer->settle());
  const auto settled = ids(*streamer);
  const float ahead_m[] = {10, 10 - 3.6f / 2, 10 - 9.36f / 2};
  for (uint32_t level = 0; level < 3; ++level)
    for (const TileId id : nearTheWay(level, ahead_m[level])) EXPECT_TRUE(std::ranges::binary_search(settled, id)) << level << ":" << id.tile;
  for (const TileId id : settled)
    if (id.level < 3) {
      EXPECT_LT(world_->tiles(id.level)[id.tile].bounds.distance(at), 6 * std::pow(1.6f, static_cast<float>(id.level)) + ahead_m[id.level] + 0.01f);
    }
}

TEST_F(StreamerTest, SaysWhatBudgetsHaveRoomFor) {
  for (const auto& [settings, budget] : {std::pair{StreamSettings{.radius_m = 12, .hysteresis = 1.0f, .max_level0_nodes = 200}, Budget::kPatches},
                                         std::pair{StreamSettings{.radius_m = 12, .hysteresis = 1.0f, .memory_bytes = 200000}, Budget::kMemory},
                                         std::pair{StreamSettings{.radius_m = 12, .hysteresis = 1.0f, .max_nodes = 600}, Budget::kNodes}})
    for (const bool background : {false, true}) {
      StreamSettings with = settings;
      with.background = background;
      const auto streamer = make(with, memory());
      EXPECT_EQ(streamer->stats().reach, (Reach{12, settings.growth}));
      const Vec3 at{32, 1, 32};
      const auto settled = settledAt(*streamer, at);
      const StreamStats stats = streamer->stats();
      EXPECT_EQ(stats.reach.short_of, budget);
      EXPECT_LT(stats.reach.radius_m, 12);
      EXPECT_TRUE(std::ranges::includes(settled, wantedByDefinition(at, stats.reach.radius_m - 1e-3f, stats.reach.growth - 1e-4f)));
      EXPECT_EQ(stats.first_short.short_of, budget);  // of a walk that knew less of the index, perhaps
      EXPECT_EQ(stats.first_short_at, at);
      (void)settledAt(*streamer, {10, 1, 10});
      EXPECT_EQ(streamer->stats().first_short_at, at);  // said once
      (void)settledAt(*streamer, {1e6f, 0, 0});
      EXPECT_EQ(streamer->stats().reach.short_of, Budget::kNone);
      EXPECT_EQ(streamer->stats().first_short.short_of, budget);
    }
}

TEST_F(StreamerTest, WhatIsWantedForItsLightAloneTakesNothingFromWhatIsNear) {
  std::mt19937_64 random(17);
  const Vec3 velocity{20, 0, 0};
  size_t more = 0;
  for (int i = 0; i < 30; ++i) {
    const Vec3 at = randomPlace(random);
    const auto settled = [&](float shown_seconds, uint32_t max_nodes) {
      const auto streamer = make({.radius_m = 6, .growth = 1.6f, .hysteresis = 1.0f, .max_nodes = max_nodes}, memory());
      streamer->setLead({.active_seconds = 0.1f, .shown_seconds = shown_seconds});
      streamer->update(at, velocity);
      EXPECT_TRUE(streamer->settle());
      EXPECT_EQ(streamer->stats().reach.short_of, Budget::kNone);
      return ids(*streamer);
    };
    const auto near = settled(0.1f, 60000), lit = settled(0.6f, 60000);
    uint32_t nodes = 0;
    for (const TileId id : near) nodes += world_->tiles(id.level)[id.tile].nodes;
    EXPECT_TRUE(std::ranges::includes(lit, near));
    more += lit.size() > near.size();
    EXPECT_TRUE(settled(0.6f, nodes) == near);
  }
  EXPECT_GT(more, 10u);
}

TEST_F(StreamerTest, WhatATurnMayBringNearIsWantedAfterAllElse) {
  std::mt19937_64 random(16);
  const Vec3 velocity{20, 0, 0};
  const auto nodes = [&](const std::vector<TileId>& tiles) {
    uint32_t sum = 0;
    for (const TileId id : tiles) sum += world_->tiles(id.level)[id.tile].nodes;
    return sum;
  };
  size_t more = 0;
  for (int i = 0; i < 30; ++i) {
    const Vec3 at = randomPlace(random);
    const auto settled = [&](float turn_seconds, uint32_t max_nodes) {
      const auto streamer = make({.radius_m = 6, .growth = 1.6f, .hysteresis = 1.0f, .max_nodes = max_nodes}, memory());
      streamer->setLead({.turn_seconds = turn_seconds, .active_seconds = 0.1f});
      streamer->update(at, velocity);
      EXPECT_TRUE(streamer->settle());
      return ids(*streamer);
    };
    const auto on_the_way = settled(0, 60000), any_way = settled(0.1f, 60000);
    EXPECT_TRUE(any_way == wantedByDefinition(at, 6, 1.6f, 2));
    EXPECT_TRUE(std::ranges::includes(any_way, on_the_way));
    more += nodes(any_way) > nodes(on_the_way);
    EXPECT_TRUE(settled(0.1f, nodes(on_the_way)) == on_the_way);
  }
  EXPECT_GT(more, 20u);
}

TEST_F(StreamerTest, MemoryStaysWithinItsBudgetOnARandomWalkWithTeleports) {
  const uint64_t budget = 300000;
  const auto streamer = make({.radius_m = 10, .hysteresis = 1.2f, .memory_bytes = budget}, memory(11));
  std::mt19937_64 random(6);
  Vec3 at{32, 1, 32};
  for (int i = 0; i < 600; ++i) {
    at += Vec3{static_cast<float>(random() % 200) / 100 - 1, 0, static_cast<float>(random() % 200) / 100 - 1};
    if (i % 50 == 0) at = randomPlace(random);
    streamer->update(at, {});
    if (i % 7 == 0) {
      ASSERT_TRUE(streamer->settle());
    }
    uint64_t bytes = 0;
    for (const StripPtr& strip : streamer->active()) bytes += residentBytes(*strip);
    ASSERT_LE(bytes, budget);
    ASSERT_LE(streamer->stats().resident_bytes, budget);
  }
  const StreamStats stats = streamer->stats();
  EXPECT_LE(stats.peak_resident_bytes, budget);
  EXPECT_GT(stats.evicted, 0u);
}

// Rows of as many samples as a world allows, all of them at one patch: their counts take many words each.
TEST(ResidentBytes, AStripTakesNoMoreThanIsKnownOfItBeforeItIsRead) {
  formats::RandomWorld made = formats::makeFurnaceWorld(64);
  made.info.quanta = formats::kMaxQuanta / formats::kMaxRowFactor;
  for (auto& level : made.strips) {
    formats::Strip& strip = level[0];
    const auto rows = static_cast<uint32_t>(strip.nodes.size());
    strip.blocks = {{0, rows}};
    strip.rows.clear();
    for (uint32_t i = 0; i < rows; ++i) {
      strip.rows.push_back(static_cast<uint8_t>(i));
      strip.nodes[i].quanta = formats::maxRowQuanta(made.info.quanta);
    }
    strip.columns.assign(rows, 0);
    strip.counts.assign(rows, static_cast<uint16_t>(strip.nodes[0].quanta));
  }
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(formats::writeWorld(made, folder.file("w.ffm"), 1 << 20));
  const auto world = formats::WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  for (const uint32_t level : {0u, 1u}) {
    const auto packed = readResident(*world, world->ref({level, 0}));
    ASSERT_TRUE(packed) << packed.error().line();
    EXPECT_LE(residentBytes(**packed), residentBytesBound(*world, world->tiles(level)[0]));
  }
}

TEST_F(StreamerTest, WhatIsWantedNoMoreIsKeptWithinABudgetOfItsOwn) {
  for (const uint64_t kept : {uint64_t{0}, uint64_t{50000}}) {
    const auto streamer = make({.radius_m = 6, .hysteresis = 1.0f, .kept_bytes = kept}, memory());
    std::mt19937_64 random(5);
    for (int i = 0; i < 12; ++i) {
      settledAt(*streamer, randomPlace(random));
      uint64_t wanted = 0;
      for (const StripPtr& strip : streamer->active()) wanted += residentBytes(*strip);  // settled: all that is wanted
      ASSERT_LE(streamer->stats().resident_bytes, wanted + kept);
      if (kept == 0) {
        ASSERT_EQ(streamer->stats().resident_tiles, streamer->stats().wanted_tiles);
      }
    }
    EXPECT_GT(streamer->stats().evicted, 0u);
  }
}

TEST_F(StreamerTest, AReturnWithinTheBudgetReadsNothingAgain) {
  const auto streamer = make(kNoHistory, memory());
  settledAt(*streamer, {10, 1, 10});
  settledAt(*streamer, {50, 1, 50});
  const uint64_t read = streamer->stats().strips_read;
  settledAt(*streamer, {10, 1, 10});
  EXPECT_EQ(streamer->stats().strips_read, read);
}

TEST_F(StreamerTest, AFailureIsRetriedOnceAndLeavesNoTrace) {
  for (const Fate fate : {Fate::kReadError, Fate::kFlippedByte, Fate::kTruncated, Fate::kEmpty}) {
    auto source = memory(1, [fate](TileId, int attempt) { return attempt == 0 ? fate : Fate::kGood; });
    const auto streamer = make(kNoHistory, std::move(source));
    EXPECT_EQ(settledAt(*streamer, {30, 1, 30}), wantedByDefinition({30, 1, 30}, 6, 1.6f));
    EXPECT_EQ(streamer->stats().failed, 0u);
  }
}

TEST_F(StreamerTest, AStripThatFailsTwiceIsCountedAndWhatLiesBelowItStandsAlone) {
  const Vec3 at{30, 1, 30};
  const auto wanted = wantedByDefinition(at, 6, 1.6f);
  for (const Fate fate : {Fate::kReadError, Fate::kFlippedByte, Fate::kTruncated, Fate::kEmpty}) {
    // One tile of level 1 is bad: everything else comes.
    ASSERT_EQ(wanted.front().level, 0u);
    const TileId bad = *parentsOf(wanted.front()).begin();
    auto source = memory(1, [=](TileId id, int) { return id == bad ? fate : Fate::kGood; });
    MemorySource* const watched = source.get();
    const auto streamer = make(kNoHistory, std::move(source));
    const auto settled = settledAt(*streamer, at);
    std::vector<TileId> expected;
    for (const TileId id : wanted)
      if (id != bad) expected.push_back(id);
    EXPECT_EQ(settled, expected);
    EXPECT_EQ(streamer->stats().failed, 1u);
    EXPECT_EQ(watched->attempts(bad), 2);
    EXPECT_EQ(streamer->stats().pending_tiles, 0u);
  }
}

TEST_F(StreamerTest, NeighboursShareReadsAndBringTheSameStrips) {
  std::mt19937_64 random(12);
  StreamSettings settings = kNoHistory;
  settings.kept_bytes = 0;
  for (int i = 0; i < 10; ++i) {
    const Vec3 at = randomPlace(random);
    auto source = sharing();
    MemorySource* const watched = source.get();
    const auto alone = make(settings, memory()), together = make(settings, std::move(source));
    ASSERT_EQ(settledAt(*alone, at), wantedByDefinition(at, 6, 1.6f));
    ASSERT_EQ(settledAt(*together, at), ids(*alone));
    for (size_t k = 0; k < alone->active().size(); ++k) {
      ASSERT_EQ(together->active()[k]->words, alone->active()[k]->words);
      ASSERT_EQ(together->active()[k]->row_start, alone->active()[k]->row_start);
    }
    const StreamStats by_one = alone->stats(), shared = together->stats();
    EXPECT_EQ(by_one.reads, by_one.strips_read);
    EXPECT_EQ(by_one.gap_bytes, 0u);
    EXPECT_EQ(shared.strips_read, by_one.strips_read);
    EXPECT_EQ(shared.bytes_read, by_one.bytes_read);
    EXPECT_LT(shared.reads, by_one.reads);
    EXPECT_LE(watched->largestSharedRead(), kShared.max_bytes);
  }
}

TEST_F(StreamerTest, WhatFailsOfASharedReadCostsNoNeighbour) {
  const Vec3 at{30, 1, 30};
  const auto wanted = wantedByDefinition(at, 6, 1.6f);
  for (const Fate fate : {Fate::kReadError, Fate::kFlippedByte, Fate::kTruncated, Fate::kEmpty}) {
    for (size_t k = 0; k < wanted.size(); k += 3) {
      const TileId bad = wanted[k];
      if (bad.level == top()) continue;
      auto source = sharing(1, [=](TileId id, int) { return id == bad ? fate : Fate::kGood; });
      MemorySource* const watched = source.get();
      const auto streamer = make(kNoHistory, std::move(source));
      std::vector<TileId> expected = wanted;
      std::erase(expected, bad);
      ASSERT_EQ(settledAt(*streamer, at), expected);
      ASSERT_EQ(streamer->stats().failed, 1u);
      ASSERT_GE(watched->attempts(bad), 2);
      ASSERT_EQ(streamer->stats().pending_tiles, 0u);
    }
    // A fault that passes leaves no trace, whoever shares the read.
    const auto streamer = make(kNoHistory, sharing(1, [fate](TileId, int attempt) { return attempt == 0 ? fate : Fate::kGood; }));
    EXPECT_EQ(settledAt(*streamer, at), wanted);
    EXPECT_EQ(streamer->stats().failed, 0u);
  }
}

// Teleports while shared reads are on their way, fail, and are made again strip by strip.
TEST_F(StreamerTest, WhateverIsUnderWayWhenTheObserverJumpsTheEndIsTheSame) {
  std::mt19937_64 random(21);
  for (const bool background : {false, true}) {
    StreamSettings settings = kNoHistory;
    settings.background = background;
    settings.queue_depth = 4;
    settings.decode_threads = 2;
    settings.retry_seconds = 0.01f;
    auto source = sharing(5, [drawn = std::mt19937_64(3)](TileId id, int) mutable {
      return id.level < 4 && drawn() % 6 == 0 ? static_cast<Fate>(1 + drawn() % 4) : Fate::kGood;
    });
    MemorySource* const watched = source.get();
    const auto streamer = make(settings, std::move(source));
    for (int round = 0; round < 20; ++round) {
      for (int jump = 0; jump < 10; ++jump) {
        watched->hold(random() % 3 == 0);
        streamer->update(randomPlace(random), {});
        std::this_thread::sleep_for(std::chrono::microseconds(random() % 500));
      }
      watched->hold(false);
      const Vec3 at = randomPlace(random);
      const auto wanted = wantedByDefinition(at, 6, 1.6f);
      for (int tries = 0; tries < 1000 && settledAt(*streamer, at) != wanted; ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(5));
      ASSERT_EQ(ids(*streamer), wanted);
      ASSERT_EQ(streamer->stats().pending_tiles, 0u);
    }
    EXPECT_GT(watched->sharedReadsSeen(), 0u);
    EXPECT_LE(watched->maxWaiting(), 4u) << "reads at a time";
    streamer->update(randomPlace(random), {});  // and destroyed on its way
  }
}

// The strip at the end of a shard that was cut off is read together with its neighbours.
TEST_F(StreamerTest, AShardThatEndsEarlyCostsOnlyTheStripsThatAreCutOff) {
  const Vec3 at{30, 1, 30};
  const auto wanted = wantedByDefinition(at, 6, 1.6f);
  const auto stripOf = [&](TileId id) { return world_->tiles(id.level)[id.tile].strip; };
  const TileId cut = *std::ranges::max_element(wanted, {}, [&](TileId id) { return id.level == 0 ? stripOf(id).offset : 0; });
  const uint64_t end = stripOf(cut).offset + stripOf(cut).stored_bytes / 2;
  const auto past = [&](TileId id) { return stripOf(id).shard == stripOf(cut).shard && stripOf(id).offset + stripOf(id).stored_bytes > end; };
  std::vector<TileId> expected;
  for (const TileId id : wanted)
    if (!past(id)) expected.push_back(id);
  ASSERT_LT(expected.size(), wanted.size());
  auto uring = makeUringSource(*world_);
  std::vector<std::unique_ptr<TileSource>> sources;
  sources.push_back(makeThreadSource(*world_));
  if (uring) sources.push_back(std::move(*uring));
  std::vector<std::unique_ptr<Streamer>> streamers;
  for (auto& source : sources) streamers.push_back(make(kNoHistory, std::move(source)));
  std::filesystem::resize_file(folder_.file(world_->shards()[stripOf(cut).shard].name), end);
  for (const auto& streamer : streamers) {
    EXPECT_EQ(settledAt(*streamer, at), expected);
    EXPECT_EQ(streamer->stats().failed, wanted.size() - expected.size());
    EXPECT_LT(streamer->stats().reads, streamer->stats().strips_read + streamer->stats().failed);
    EXPECT_NE(streamer->lastFailure().find("the file ends here"), std::string::npos) << streamer->lastFailure();
  }
}

TEST_F(StreamerTest, AStripThatFailedTwiceIsTriedAgainWhileTheObserverStays) {
  const Vec3 at{30, 1, 30};
  const auto wanted = wantedByDefinition(at, 6, 1.6f);
  for (const bool background : {false, true}) {
    StreamSettings settings = kNoHistory;
    settings.retry_seconds = 0.02f;
    settings.background = background;
    std::atomic<bool> works{false};
    const auto streamer = make(settings, memory(1, [&](TileId id, int) { return id.level == 1 && !works ? Fate::kReadError : Fate::kGood; }));
    EXPECT_LT(settledAt(*streamer, at).size(), wanted.size());
    EXPECT_GT(streamer->stats().failed, 0u);
    EXPECT_FALSE(streamer->lastFailure().empty());
    works = true;
    for (int tries = 0; tries < 1000 && settledAt(*streamer, at) != wanted; ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_EQ(ids(*streamer), wanted);
  }
}

// As a game has it, that calls nothing but update().
TEST_F(StreamerTest, InTheBackgroundAJumpIsPendingUntilAllIsThere) {
  StreamSettings settings = kNoHistory;
  settings.background = true;
  const auto streamer = make(settings, memory());
  EXPECT_EQ(streamer->stats().pending_tiles, 0u);
  streamer->update({1, 1, 1}, {});  // near the origin, where nobody has been either
  EXPECT_GT(streamer->stats().pending_tiles, 0u);
  settledAt(*streamer, {10, 1, 12});
  EXPECT_EQ(streamer->stats().pending_tiles, 0u);
  const Vec3 there{50, 1, 40};
  streamer->update(there, {});
  EXPECT_GT(streamer->stats().pending_tiles, 0u) << "nobody has looked there yet, or it is on its way";
  for (int frames = 0; frames < 1000 && (streamer->stats().pending_tiles > 0 || ids(*streamer) != wantedByDefinition(there, 6, 1.6f)); ++frames) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    streamer->update(there, {});
  }
  EXPECT_EQ(ids(*streamer), wantedByDefinition(there, 6, 1.6f));
  EXPECT_EQ(streamer->stats().pending_tiles, 0u);
  const auto now = std::chrono::steady_clock::now();
  const std::array<Hint, 2> hints{Hint{{10, 1, 55}, now + std::chrono::minutes(1)}, Hint{there, now - kHintStays - std::chrono::seconds(1)}};
  streamer->expect(hints);
  EXPECT_EQ(settledAt(*streamer, there), wantedByDefinition(there, 6, 1.6f));
  EXPECT_GT(streamer->stats().ahead_tiles, 5u);
  EXPECT_EQ(streamer->expected().size(), 1u);
}

// Shards are opened when they are first read.
TEST_F(StreamerTest, WhatCannotBeOpenedForWantOfDescriptorsComesOnceThereAreSome) {
  const auto path = folder_.file("shards.ffm");
  ASSERT_TRUE(formats::writeWorld(makeSyntheticWorld({.side = 64, .levels = 5, .tile_nodes = 32}), path, 20000));
  const auto world = formats::World::open(path);
  ASSERT_TRUE(world) << world.error().line();
  ASSERT_GT(world->shards().size(), 10u);
  StreamSettings settings = kNoHistory;
  settings.retry_seconds = 0.02f;
  auto streamer = Streamer::create(*world, settings);
  ASSERT_TRUE(streamer) << streamer.error().line();
  const Vec3 at{30, 1, 30};
  // The whole index first, so that it is strips that lack descriptors.
  for (uint32_t tile = 0; tile < world->levels()[0].tiles; ++tile) ASSERT_TRUE(world->tile(TileId{0, tile}));
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit none{3, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &none), 0);
  const size_t few = settledAt(**streamer, at).size();
  const uint64_t failed = (*streamer)->stats().failed;
  const std::string line = (*streamer)->lastFailure();
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &before), 0);
  const auto wanted = wantedByDefinition(at, 6, 1.6f);
  EXPECT_LT(few, wanted.size());
  EXPECT_GT(failed, 0u);
  EXPECT_NE(line.find("Too many open files"), std::string::npos) << line;
  for (int tries = 0; tries < 1000 && settledAt(**streamer, at) != wanted; ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_EQ(ids(**streamer), wanted);
}

TEST_F(StreamerTest, ATopLevelThatCannotBeReadIsAnErrorOfCreate) {
  const auto streamer = Streamer::create(*world_, kNoHistory, memory(1, [this](TileId id, int) {
    return id.level == top() ? Fate::kFlippedByte : Fate::kGood;
  }));
  ASSERT_FALSE(streamer);
  EXPECT_EQ(streamer.error().code, ErrorCode::kInvalidFile);
}

TEST_F(StreamerTest, UpdateNeverWaitsForASourceAndATeleportDropsWhatIsQueued) {
  auto source = memory();
  MemorySource* const held = source.get();
  const auto streamer = make({.radius_m = 6, .growth = 1.6f, .hysteresis = 1.0f, .queue_depth = 4}, std::move(source));
  held->hold(true);
  EXPECT_FALSE(streamer->update({5, 1, 5}, {}));  // would hang here if it waited
  // The index comes first, a level at a time; another thread starts the reads.
  while (held->maxWaiting() < 4) streamer->update({5, 1, 5}, {});
  // To and fro until that thread has seen a queue for one place, and then the next one for the other.
  while (streamer->stats().cancelled == 0)
    for (const float x : {5.0f, 60.0f}) streamer->update({x, 1, x}, {});
  EXPECT_EQ(held->maxWaiting(), 4u);
  held->hold(false);
  EXPECT_EQ(settledAt(*streamer, {60, 1, 60}), wantedByDefinition({60, 1, 60}, 6, 1.6f));
}

TEST_F(StreamerTest, ASourceIsNotGivenMoreReadsThanItIsGoodFor) {
  auto source = memory();
  source->setReadsAtOnce(3);
  MemorySource* const watched = source.get();
  const auto streamer = make(kNoHistory, std::move(source));
  EXPECT_GT(kNoHistory.queue_depth, 3);
  EXPECT_EQ(settledAt(*streamer, {60, 1, 60}), wantedByDefinition({60, 1, 60}, 6, 1.6f));
  EXPECT_LE(watched->maxWaiting(), 3u);
}

TEST_F(StreamerTest, TilesAheadAreReadBeforeTilesBehind) {
  for (const float direction : {-1.0f, 1.0f}) {
    std::vector<TileId> order;  // written under the source's lock, read after settling
    auto source = memory(1, [&order](TileId id, int) {
      order.push_back(id);
      return Fate::kGood;
    });
    MemorySource* const held = source.get();
    const auto streamer = make({.radius_m = 12, .hysteresis = 1.0f, .queue_depth = 1}, std::move(source));
    order.clear();
    held->hold(true);
    streamer->update({32, 1, 32}, {direction * 20, 0, 0});
    held->hold(false);
    ASSERT_TRUE(streamer->settle());
    std::vector<float> ahead;
    for (const TileId id : order)
      if (id.level == 0) {
        const Box& box = world_->tiles(0)[id.tile].bounds;
        ahead.push_back(direction * ((box.lo.x + box.hi.x) / 2 - 32));
      }
    ASSERT_GT(ahead.size(), 8u);
    const size_t third = ahead.size() / 3;
    float early = 0, late = 0;
    for (size_t i = 0; i < third; ++i) {
      early += ahead[i];
      late += ahead[ahead.size() - 1 - i];
    }
    EXPECT_GT(early, late);
  }
}

TEST(ForetoldPath, IsALineWithoutATurnAndACircleWithOne) {
  const auto line = foretoldPath({1, 2, 3}, {10, 0, 0}, {}, 2, 4);
  ASSERT_EQ(line.size(), 5u);
  EXPECT_EQ(line[0], (Vec3{1, 2, 3}));
  EXPECT_NEAR(line[4].x, 21, 1e-4);
  // 10 m/s at 1 radian a second: a radius of 10 m. Chords through the middle of each step err by (0.1)^2 / 24 of it.
  const auto circle = foretoldPath({0, 0, 0}, {10, 0, 0}, {0, 1, 0}, 1.5f, 15);
  for (const Vec3 at : circle) EXPECT_NEAR(length(at - Vec3{0, 0, -10}), 10, 0.02f);
}

// Whatever its thread does at the time, and however the last aim and the end run into one another.
TEST_F(StreamerTest, APlannerThatHasJustBeenAimedEnds) {
  const Observers observers{Observer{{32, 1, 32}, {10, 0, 0}}};
  for (int i = 0; i < 4000; ++i) {
    PathPlanner planner(*world_, kNoHistory, {});
    const auto until = std::chrono::steady_clock::now() + std::chrono::nanoseconds(50 * i);
    do planner.aim(observers, {}, 0, {});
    while (std::chrono::steady_clock::now() < until);
  }
}

TEST(TurnRate, FollowsATurnThatLastsAndNoCorner) {
  TurnRate turns;
  const auto heading = [](float angle) { return Vec3{std::cos(angle), 0, -std::sin(angle)} * 30; };
  EXPECT_EQ(turns.follow(heading(0), 0.02f), Vec3{});
  EXPECT_EQ(turns.follow(heading(0), 0.02f), Vec3{});
  EXPECT_EQ(turns.follow(heading(1.5f), 0.02f), Vec3{});
  EXPECT_EQ(turns.follow(heading(1.5f), 0.02f), Vec3{});
  EXPECT_EQ(turns.follow(heading(1.54f), 0.02f), Vec3{});
  EXPECT_NEAR(turns.follow(heading(1.58f), 0.02f).y, 2, 1e-3);
  EXPECT_EQ(turns.follow(Vec3{}, 0.02f), Vec3{});
}

// Along lines, bends and round corners of 90 degrees: as long as reads are done between two steps, no tile is late that comes into reach; where nothing is
// read ahead, many are.
TEST_F(StreamerTest, WhatThePathWillWantIsThereBeforeItIsWanted) {
  const float step_seconds = 0.02f, speed = 25;
  for (const float ahead_seconds : {0.5f, 0.0f}) {
    StreamSettings settings = kNoHistory;
    settings.ahead_seconds = ahead_seconds;
    uint32_t late = 0, entered = 0;
    for (const int kind : {0, 1, 2}) {
      const auto streamer = make(settings, memory());
      Vec3 at{10, 1, 12}, velocity{speed, 0, 0};
      streamer->update(at, velocity);
      ASSERT_TRUE(streamer->settle());
      for (int step = 0; step < 80; ++step) {
        const float angle = kind == 1 ? 0.02f * static_cast<float>(step) : kind == 2 && step / 20 % 2 == 1 ? 1.5707963f : 0;
        velocity = Vec3{std::cos(angle), 0, std::sin(angle)} * speed;
        at += velocity * step_seconds;
        const auto before = ids(*streamer);
        streamer->update(at, velocity);
        const auto now = ids(*streamer), wanted = wantedByDefinition(at, settings.radius_m, settings.growth);
        for (const TileId id : wanted) late += !std::ranges::binary_search(now, id);
        ASSERT_TRUE(streamer->settle());
        for (const TileId id : ids(*streamer)) entered += !std::ranges::binary_search(before, id);
      }
    }
    EXPECT_GT(entered, 50u);
    if (ahead_seconds > 0)
      EXPECT_EQ(late, 0u);
    else
      EXPECT_GT(late, 50u);
  }
}

TEST_F(StreamerTest, SeveralObserversSeeWhatEachWouldAloneAndShareIt) {
  const Vec3 places[] = {{10, 1, 10}, {14, 1, 12}, {50, 1, 40}};
  std::set<TileId> together, read;
  uint64_t alone_strips = 0;
  for (const Vec3 at : places) {
    const auto streamer = make(kNoHistory, memory());
    streamer->update(at, {});
    ASSERT_TRUE(streamer->settle());
    for (const TileId id : ids(*streamer)) together.insert(id);
    alone_strips += streamer->stats().strips_read;
  }
  const auto streamer = make(kNoHistory, memory());
  std::array<Observer, 3> all;
  for (size_t i = 0; i < all.size(); ++i) all[i] = {places[i], {}};
  streamer->update(Observers(std::span(all)));
  ASSERT_TRUE(streamer->settle());
  EXPECT_EQ(ids(*streamer), std::vector<TileId>(together.begin(), together.end()));
  EXPECT_LT(streamer->stats().strips_read, alone_strips);
  streamer->update(Observers(std::span(all).first(1)));  // the others have gone
  ASSERT_TRUE(streamer->settle());
  EXPECT_EQ(ids(*streamer), wantedByDefinition(places[0], kNoHistory.radius_m, kNoHistory.growth));
}

TEST_F(StreamerTest, WhatThePathsOfSeveralObserversWillWantIsThereBeforeItIsWanted) {
  const float step_seconds = 0.02f, speed = 25;
  StreamSettings settings = kNoHistory;
  settings.radius_m = 2;
  for (const float ahead_seconds : {0.5f, 0.0f}) {
    settings.ahead_seconds = ahead_seconds;
    const auto streamer = make(settings, memory());
    std::array<Observer, 3> all{Observer{{10, 1, 12}, {speed, 0, 0}}, Observer{{55, 1, 50}, {0, 0, -speed}}, Observer{{30, 1, 30}, {}}};
    streamer->update(Observers(std::span(all)));
    ASSERT_TRUE(streamer->settle());
    uint32_t late = 0;
    for (int step = 0; step < 60; ++step) {
      for (Observer& observer : all) observer.at += observer.velocity * step_seconds;
      streamer->update(Observers(std::span(all)));
      const auto now = ids(*streamer);
      for (const Observer& observer : all)
        for (const TileId id : wantedByDefinition(observer.at, settings.radius_m, settings.growth)) late += !std::ranges::binary_search(now, id);
      ASSERT_TRUE(streamer->settle());
    }
    if (ahead_seconds > 0)
      EXPECT_EQ(late, 0u);
    else
      EXPECT_GT(late, 10u);
  }
}

TEST_F(StreamerTest, WhatIsReadAheadKeepsToItsBudgetAndIsGivenUpForWhatIsWanted) {
  uint32_t ahead = 0;
  for (const auto& [memory_bytes, ahead_bytes] : {std::pair<uint64_t, uint64_t>{500000, 1 << 20}, {1 << 20, 1 << 20}, {2 << 20, 1 << 20}, {8 << 20, 200000}}) {
    const auto streamer = make({.radius_m = 8, .hysteresis = 1.0f, .memory_bytes = memory_bytes, .kept_bytes = 0, .ahead_bytes = ahead_bytes}, memory());
    for (float x = 5; x < 60; x += 0.5f) {
      streamer->update({x, 1, 30}, {25, 0, 0});
      ASSERT_TRUE(streamer->settle());
      const StreamStats stats = streamer->stats();
      ahead += stats.ahead_tiles;
      ASSERT_LE(stats.peak_resident_bytes, memory_bytes);
      uint64_t active = 0;
      for (const StripPtr& strip : streamer->active()) active += residentBytes(*strip);
      ASSERT_LE(stats.resident_bytes, active + ahead_bytes);
    }
    streamer->update({60, 1, 30}, {});
    ASSERT_TRUE(streamer->settle());
    EXPECT_EQ(streamer->stats().ahead_tiles, 0u);
  }
  EXPECT_GT(ahead, 100u);
}

TEST_F(StreamerTest, WhatIsHintedIsThereWhenAnObserverJumps) {
  const Vec3 here{10, 1, 12}, there{50, 1, 40};
  const auto soon = std::chrono::steady_clock::now() + std::chrono::seconds(1);
  for (const bool moves : {false, true}) {
    const Vec3 velocity = moves ? Vec3{5, 0, 0} : Vec3{};
    std::vector<uint32_t> late;
    for (const bool hinted : {false, true}) {
      const auto streamer = make(kNoHistory, memory());
      streamer->update(here, velocity);
      ASSERT_TRUE(streamer->settle());
      const uint32_t ahead = streamer->stats().ahead_tiles;
      const Hint hint{there, soon};
      if (hinted) streamer->expect({&hint, 1});
      streamer->update(here, velocity);
      ASSERT_TRUE(streamer->settle());
      EXPECT_EQ(streamer->stats().ahead_tiles > ahead, hinted);
      EXPECT_EQ(ids(*streamer), wantedByDefinition(here, kNoHistory.radius_m, kNoHistory.growth)) << "a hint is no observer";
      streamer->update(there, velocity);
      const auto now = ids(*streamer);
      late.push_back(0);
      for (const TileId id : wantedByDefinition(there, kNoHistory.radius_m, kNoHistory.growth)) late.back() += !std::ranges::binary_search(now, id);
    }
    EXPECT_GT(late[0], 10u);
    EXPECT_EQ(late[1], 0u);
  }
}

TEST_F(StreamerTest, HintsKeepToTheirBudgetTheNearestFirstAndAreForgotten) {
  using namespace std::chrono_literals;
  StreamSettings settings = kNoHistory;
  settings.kept_bytes = 0;
  settings.hint_bytes = 250000;
  const Vec3 here{10, 1, 12}, sooner{50, 1, 40}, later{12, 1, 55};
  const auto streamer = make(settings, memory());
  streamer->update(here, {});
  ASSERT_TRUE(streamer->settle());
  const uint64_t before = streamer->stats().resident_bytes;
  const auto now = std::chrono::steady_clock::now();
  const std::array<Hint, 2> hints{Hint{later, now + 60s}, Hint{sooner, now + 30s}};
  streamer->expect(hints);
  streamer->update(here, {});
  ASSERT_TRUE(streamer->settle());
  EXPECT_LE(streamer->stats().resident_bytes, before + settings.hint_bytes);
  ASSERT_GT(streamer->stats().ahead_tiles, 5u);
  // Which are there shows in a jump: within the budget, those of the sooner place by their reach.
  const auto there = [&](Vec3 place, Vec3 other) {
    float farthest_there = 0, nearest_absent = 1e9f;
    std::set<TileId> at_home;
    for (const Vec3 of : {here, other})
      for (const TileId id : wantedByDefinition(of, settings.radius_m, settings.growth)) at_home.insert(id);
    const auto jumped = make(settings, memory());
    jumped->update(here, {});
    EXPECT_TRUE(jumped->settle());
    jumped->expect(hints);
    jumped->update(here, {});
    EXPECT_TRUE(jumped->settle());
    jumped->update(place, {});
    const auto active = ids(*jumped);
    for (const TileId id : wantedByDefinition(place, settings.radius_m, settings.growth)) {
      if (at_home.contains(id)) continue;
      if (std::ranges::binary_search(active, id))
        farthest_there = std::max(farthest_there, reach(id, place));
      else
        nearest_absent = std::min(nearest_absent, reach(id, place));
    }
    return std::pair(farthest_there, nearest_absent);
  };
  const auto [farthest_there, nearest_absent] = there(sooner, here);
  EXPECT_GT(farthest_there, 0);
  EXPECT_LE(farthest_there, nearest_absent * 1.0001f);
  EXPECT_EQ(there(later, sooner).first, 0) << "nothing is left for what is wanted later";
  // Past its time and kHintStays a hint is none.
  const Hint old{sooner, now - kHintStays - 1s};
  streamer->expect({&old, 1});
  streamer->update(here, {});
  ASSERT_TRUE(streamer->settle());
  EXPECT_EQ(streamer->stats().ahead_tiles, 0u);
  EXPECT_EQ(streamer->stats().resident_bytes, before);
  EXPECT_TRUE(streamer->expected().empty());
}

TEST_F(StreamerTest, AStillObserverWithNothingUnderWayCausesNoChange) {
  const auto streamer = make(kNoHistory, memory());
  settledAt(*streamer, {20, 1, 20});
  const auto before = ids(*streamer);
  for (int i = 0; i < 5; ++i) EXPECT_FALSE(streamer->update({20, 1, 20}, {}));
  EXPECT_EQ(ids(*streamer), before);
}

TEST_F(StreamerTest, CanBeDestroyedWhileReadsAreUnderWay) {
  for (uint64_t i = 0; i < 40; ++i) {
    const auto streamer = make({.radius_m = 30, .decode_threads = 2, .background = i % 4 < 2}, i % 2 ? memory(i) : nullptr);
    streamer->update({30, 1, 30}, {});
  }
}

TEST_F(StreamerTest, RefusesSettingsThatCannotWork) {
  for (const StreamSettings& settings :
       {StreamSettings{.radius_m = 0}, StreamSettings{.radius_m = -1}, StreamSettings{.growth = 0.5f},
        StreamSettings{.hysteresis = 0.9f}, StreamSettings{.memory_bytes = 100}, StreamSettings{.max_nodes = 1},
        StreamSettings{.radius_m = std::numeric_limits<float>::quiet_NaN()}}) {
    const auto streamer = Streamer::create(*world_, settings, memory());
    ASSERT_FALSE(streamer);
    EXPECT_EQ(streamer.error().code, ErrorCode::kUsage);
  }
}

}  // namespace
}  // namespace ff::stream
