#include "runtime/updater.h"

#include <cmath>

#include "runtime/full_solve.h"
#include "tests/formats/faulty_storage.h"
#include "tests/runtime/lit_state.h"
#include "tests/runtime/test_world.h"
#include "tests/stream/test_sources.h"

namespace ff::runtime {
namespace {

constexpr Sky kSky{{1, 2, 3},
                   {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}},
                   {{0.1f, 0.2f, 0.3f, 0.4f, 0.5f}, {0, 0, 0, 1, 0}, {0.5f, 0, 0, 0, 0.25f}}};

// Direct irradiance by node number: any function will do, as long as its caller can repeat it.
Vec3 directAt(uint32_t level, uint64_t node) {
  return {static_cast<float>((node * 7 + level) % 11), static_cast<float>(node % 5), 1};
}

struct Walker {
  explicit Walker(const TestWorld& test, stream::StreamSettings settings = {.radius_m = 8, .hysteresis = 1.0f}, std::unique_ptr<stream::TileSource> source = nullptr)
      : streamer(std::move(*stream::Streamer::create(test.world(), settings, std::move(source)))),
        solver(makeCpuGather(2)),
        updater(test.world(), *streamer, *solver) {
    EXPECT_TRUE(updater.setSky(kSky));
    updater.setDirectLight([&test, this](formats::TileId id, std::span<Vec3> out) {
      ++asked;
      const formats::TileInfo& info = test.world().tiles(id.level)[id.tile];
      for (uint32_t i = 0; i < info.nodes; ++i) out[i] = directAt(id.level, info.first_node + i) * strength;
    });
  }
  std::vector<Vec4> radiosity() {
    std::vector<Vec4> out(updater.matrix().slots());
    EXPECT_TRUE(updater.radiosity(out));
    return out;
  }
  std::vector<Vec4> reflected() {
    std::vector<Vec4> out(updater.matrix().slots());
    EXPECT_TRUE(updater.reflected(out));
    return out;
  }
  float strength = 1;
  int asked = 0;
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<Solver> solver;
  Updater updater;
};

// W/m2 at every node of a level from the lamps, straight from the strips.
std::vector<Vec3> lampsAt(const TestWorld& test, uint32_t level, std::span<const Vec3> scale) {
  std::vector<Vec3> light(test.world().levels()[level].nodes);
  for (const formats::TileInfo& info : test.world().tiles(level))
    for (const formats::LampLight& lamp : test.strip(info.id).lamps)
      light[info.first_node + lamp.row] += test.world().info().lamp_groups[lamp.group].emission * scale[lamp.group] * lamp.weight;
  return light;
}

void expectClose(const Vec4& got, Vec3 expected) {
  const float values[3] = {got.x, got.y, got.z};
  for (int c = 0; c < 3; ++c) ASSERT_NEAR(values[c], expected[c], 1e-5f * (1 + expected[c]));
}

TEST(Updater, SourceIsReflectedDirectLightSkyAndLampsAndRadiosityHoldsWhatIsEmittedToo) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 2});
  Walker walker(test);
  const std::vector<Vec3> scale{{1, 1, 1}, {0.5f, 0, 3}, {0, 0, 0}};
  for (uint32_t g = 0; g < scale.size(); ++g) ASSERT_TRUE(walker.updater.setLamp(g, scale[g]));
  ASSERT_TRUE(walker.updater.frame({16, 1, 16}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({16.5f, 1, 16}, {}, 1));
  const std::vector<Vec4> radiosity = walker.radiosity();
  const std::vector<Vec4> reflected = walker.reflected();
  bool lit = false, emits = false;
  for (const SlotRange& range : walker.updater.matrix().tiles) {
    const std::vector<Vec3> lamps = lampsAt(test, range.id.level, scale);
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint32_t slot = range.first_slot + i;
      const formats::Node& node = test.node(range.id.level, range.first_node + i);
      Vec3 expected;
      for (int c = 0; c < 3; ++c) {
        float quadratic = 0;
        for (size_t k = 0; k < 5; ++k) quadratic += kSky.l2[c][k] * node.sky_quadratic[k];
        const float sky = 3.14159265f * node.sky_fraction * (kSky.l0[c] + dot(kSky.l1[c], node.sky_direction) + quadratic);
        expected[c] = node.albedo[c] * (directAt(range.id.level, range.first_node + i)[c] + lamps[range.first_node + i][c] + sky);
      }
      expectClose(walker.updater.source()[slot], expected);
      const Vec3 emission = node.emission * scale[node.lamp_group];
      expectClose(walker.updater.emission()[slot], emission);
      const Vec4 r = reflected[slot];
      expectClose(radiosity[slot], Vec3{r.x, r.y, r.z} + emission);
      lit = lit || !(lamps[range.first_node + i] == Vec3{});
      emits = emits || !(emission == Vec3{});
    }
  }
  EXPECT_TRUE(lit && emits);
}

TEST(Updater, ALampThatIsOffIsAWorldWithoutIt) {
  const stream::SyntheticSettings settings{.side = 32, .tile_nodes = 24, .seed = 2};
  for (uint32_t group = 0; group < 3; ++group) {
    stream::SyntheticSettings without_settings = settings;
    without_settings.without_lamps = static_cast<int>(group);
    const TestWorld test(settings), without(without_settings);
    Lamps lamps(test.world().info()), others(without.world().info());
    lamps.set(group, {});
    // All patches, double precision.
    const auto source = fullSource(test.world(), {}, kSky, lamps), expected_source = fullSource(without.world(), {}, kSky, others);
    ASSERT_TRUE(source && expected_source);
    EXPECT_EQ(*source, *expected_source);
    EXPECT_NE(*source, *fullSource(test.world(), {}, kSky, Lamps(test.world().info())));
    EXPECT_EQ(solveFullWorld(test.world(), *source)->radiosity, solveFullWorld(without.world(), *expected_source)->radiosity);
    // The cut, tiles entering while the lamp is off, and being there when it is switched.
    Walker walker(test), expected(without);
    for (Walker* w : {&walker, &expected}) ASSERT_TRUE(w->updater.frame({8, 1, 8}, {}, 1));
    ASSERT_TRUE(walker.updater.setLamp(group, {}));
    for (Walker* w : {&walker, &expected}) {
      for (const Vec3 at : {Vec3{8, 1, 8}, Vec3{20, 1, 20}}) {
        ASSERT_TRUE(w->updater.frame(at, {}, 1));
        ASSERT_TRUE(w->streamer->settle());
      }
      ASSERT_TRUE(w->updater.frame({20, 1, 20.01f}, {}, 300));  // an albedo of at most 0.9 to the 300th is 2e-14
    }
    const std::vector<Vec4> got = walker.radiosity(), want = expected.radiosity();
    for (const SlotRange& range : walker.updater.matrix().tiles)
      for (uint32_t i = 0; i < range.nodes; ++i) {
        const uint32_t slot = range.first_slot + i, other = expected.updater.matrix().slotOf(range.id.level, range.first_node + i);
        const Vec4 b = want[other];
        const Vec4 m = walker.updater.source()[slot], n = expected.updater.source()[other];
        ASSERT_EQ(m.x, n.x);
        ASSERT_EQ(m.y, n.y);
        ASSERT_EQ(m.z, n.z);
        expectClose(got[slot], {b.x, b.y, b.z});
      }
  }
}

TEST(Updater, ALampSwitchedOffAndOnAgainGivesTheSameBitsAndAsksForNothing) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 2});
  Walker walker(test);
  ASSERT_TRUE(walker.updater.frame({16, 1, 16}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({16, 1, 16.01f}, {}, 300));
  const auto bits = [&](std::span<const Vec4> values) {
    std::vector<float> all;
    for (const Vec4& v : values) all.insert(all.end(), {v.x, v.y, v.z});
    return all;
  };
  const auto source = bits(walker.updater.source()), emission = bits(walker.updater.emission());
  const std::vector<Vec4> settled = walker.radiosity();
  const uint64_t change = walker.updater.emissionChange();
  walker.asked = 0;
  for (const Vec3 scale : {Vec3{0, 0, 0}, Vec3{0.3f, 7, 1e-5f}}) {
    for (uint32_t g = 0; g < walker.updater.lamps().groups(); ++g) ASSERT_TRUE(walker.updater.setLamp(g, scale));
    const auto frame = walker.updater.frame({16, 1, 16.01f}, {}, 1);
    ASSERT_TRUE(frame);
    EXPECT_FALSE(frame->matrix_changed);
    EXPECT_NE(bits(walker.updater.source()), source);
    EXPECT_NE(bits(walker.updater.emission()), emission);
  }
  EXPECT_EQ(walker.updater.emissionChange(), change + 2);
  for (uint32_t g = 0; g < walker.updater.lamps().groups(); ++g) ASSERT_TRUE(walker.updater.setLamp(g, {1, 1, 1}));
  ASSERT_TRUE(walker.updater.frame({16, 1, 16.01f}, {}, 300));
  EXPECT_EQ(bits(walker.updater.source()), source);
  EXPECT_EQ(bits(walker.updater.emission()), emission);
  EXPECT_EQ(walker.asked, 0);
  const std::vector<Vec4> again = walker.radiosity();
  for (size_t s = 0; s < settled.size(); ++s) expectClose(again[s], {settled[s].x, settled[s].y, settled[s].z});
}

// A cluster's light from the lamps is the mean of its patches': the level of the cut makes no difference.
TEST(Updater, LampsLightTheSameAtEveryLevelOfTheCut) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 2});
  const std::vector<Vec3> scale{{1, 1, 1}, {0.5f, 2, 3}, {0, 1, 0}};
  std::vector<Vec3> below = lampsAt(test, 0, scale);
  for (uint32_t level = 1; level <= test.top(); ++level) {
    const std::vector<Vec3> own = lampsAt(test, level, scale);
    for (uint32_t n = 0; n < own.size(); ++n) {
      Vec3 sum;
      float area = 0;
      for (const uint32_t child : test.world().children(level, n)) {
        sum += below[child] * test.node(level - 1, child).area_m2;
        area += test.node(level - 1, child).area_m2;
      }
      // Weights keep 12 bits: each side of a comparison is off by half a step of 2^-11 at most.
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(own[n][c], sum[c] / area, 0x1p-11f * own[n][c] + 1e-6f);
    }
    below = own;
  }
}

TEST(Updater, AsksForDirectLightOfATileWhenItEntersAndAfterAChangeOnly) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 2});
  Walker walker(test);
  ASSERT_TRUE(walker.updater.frame({4, 1, 4}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({4.01f, 1, 4}, {}, 1));
  walker.asked = 0;
  const auto still = walker.updater.frame({4.01f, 1, 4}, {}, 1);
  ASSERT_TRUE(still);
  EXPECT_FALSE(still->matrix_changed);
  EXPECT_EQ(walker.asked, 0);
  walker.updater.lightChanged();
  ASSERT_TRUE(walker.updater.frame({4.01f, 1, 4}, {}, 1));
  EXPECT_EQ(walker.asked, static_cast<int>(walker.updater.matrix().tiles.size()));
}

TEST(Updater, ConvergedRadiosityDependsOnTheObserverAloneNotOnThePath) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const auto settleAt = [](Walker& walker, Vec3 at) {
    EXPECT_TRUE(walker.updater.frame(at, {}, 1));
    EXPECT_TRUE(walker.streamer->settle());
    EXPECT_TRUE(walker.updater.frame(at, {}, 1));
    const auto settled = walker.updater.converge(1e-7f, 1000);
    EXPECT_TRUE(settled);
    EXPECT_TRUE(settled->settled);
  };
  Walker straight(test), wandering(test);
  settleAt(straight, {50, 1, 40});
  for (const Vec3 at : {Vec3{2, 1, 2}, Vec3{20, 1, 60}, Vec3{33, 1, 10}}) settleAt(wandering, at);
  wandering.strength = 3;
  wandering.updater.lightChanged();
  settleAt(wandering, {40, 1, 41});
  wandering.strength = 1;
  wandering.updater.lightChanged();
  settleAt(wandering, {50, 1, 40});
  const std::vector<Vec4> a = straight.radiosity(), b = wandering.radiosity();
  const LocalMatrix &m = straight.updater.matrix(), &n = wandering.updater.matrix();
  ASSERT_EQ(m.tiles.size(), n.tiles.size());
  ASSERT_EQ(m.used_entries, n.used_entries);
  float largest = 0, difference = 0;
  for (size_t t = 0; t < m.tiles.size(); ++t) {
    ASSERT_EQ(m.tiles[t].id, n.tiles[t].id);
    for (uint32_t i = 0; i < m.tiles[t].nodes; ++i) {
      const uint32_t s = m.tiles[t].first_slot + i, r = n.tiles[t].first_slot + i;
      largest = std::max(largest, a[s].y);
      difference = std::max(difference, std::abs(a[s].y - b[r].y));
    }
  }
  // Each stops when a change is below 1e-7 of the largest; albedo <= 0.9 leaves at most 9 such changes to come.
  EXPECT_LE(difference, 2 * 9 * 1e-7f * largest + 1e-6f * largest);
}

TEST(Updater, OnceAFaultHasPassedTheStateIsThatOfAWorldWithoutIt) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const Vec3 first{8, 1, 8}, at{50, 1, 40};
  std::map<formats::TileId, std::vector<std::byte>> bytes;
  for (uint32_t level = 0; level <= test.top(); ++level)
    for (const formats::TileInfo& info : test.world().tiles(level)) {
      bytes[info.id].resize(info.strip.stored_bytes);
      ASSERT_TRUE(test.world().readStored(info.strip, bytes[info.id]));
    }
  const stream::StreamSettings settings{.radius_m = 8, .hysteresis = 1.0f, .retry_seconds = 0.02f};
  const auto come = [&](Walker& walker) {  // teleports to `at` and stays
    for (const Vec3 place : {first, at, at}) {
      EXPECT_TRUE(walker.updater.frame(place, {}, 1));
      EXPECT_TRUE(walker.streamer->settle());
    }
    EXPECT_TRUE(walker.updater.frame(at, {}, 1));
  };
  Walker sound(test, settings);
  come(sound);
  const auto expected = stateOf(sound.updater, *sound.solver);
  const size_t tiles = sound.updater.matrix().tiles.size();

  // Half of the tiles fail; all do; those of a level do, so that what lies below stands alone.
  for (const int fault : {0, 1, 2, 3}) {
    std::atomic<bool> broken{false};
    const auto fate = [&](formats::TileId id, int) {
      const bool fails = fault == 0 ? (id.tile * 7 + id.level) % 2 == 0 : fault == 1 || id.level + 1 == static_cast<uint32_t>(fault);
      return broken && fails ? stream::Fate::kReadError : stream::Fate::kGood;
    };
    auto source = std::make_unique<stream::MemorySource>(bytes, 1, fate);
    Walker walker(test, settings, std::move(source));
    ASSERT_TRUE(walker.updater.frame(first, {}, 1));
    ASSERT_TRUE(walker.streamer->settle());
    broken = true;
    come(walker);
    EXPECT_GT(walker.streamer->stats().failed, 0u);
    const auto during = walker.reflected();
    for (const uint32_t slot : walker.updater.matrix().leaves) ASSERT_TRUE(std::isfinite(during[slot].y));
    EXPECT_LT(walker.updater.matrix().tiles.size(), tiles);
    if (fault == 2) {
      EXPECT_EQ(walker.updater.matrix().tiles.front().id.level, 0u) << "patches below clusters that failed";
    }
    broken = false;
    for (int tries = 0; tries < 1000 && walker.updater.matrix().tiles.size() != tiles; ++tries) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      ASSERT_TRUE(walker.streamer->settle());
      ASSERT_TRUE(walker.updater.frame(at, {}, 1));
    }
    EXPECT_EQ(stateOf(walker.updater, *walker.solver), expected) << "fault " << fault;
    EXPECT_EQ(walker.streamer->stats().late_tiles, 0u);
  }
}

TEST(Updater, AnOutageOfTheStorageThatPassesLeavesNoTrace) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const auto disk = std::make_shared<formats::FaultyStorage>(formats::posixStorage());
  const auto world = formats::World::open(test.world().path(), disk);  // its index goes with it
  ASSERT_TRUE(world) << world.error().line();
  const stream::StreamSettings settings{.radius_m = 8, .hysteresis = 1.0f, .retry_seconds = 0.02f};
  const Vec3 first{8, 1, 8}, at{50, 1, 40};
  LitState states[2];
  size_t tiles = 0;
  for (const bool outage : {false, true}) {
    const auto streamer = std::move(*stream::Streamer::create(*world, settings));
    const auto solver = makeCpuGather(1);
    Updater updater(*world, *streamer, *solver);
    ASSERT_TRUE(updater.setSky(kSky));
    ASSERT_TRUE(updater.frame(first, {}, 1));
    ASSERT_TRUE(streamer->settle());
    disk->outage = outage;
    ASSERT_TRUE(updater.frame(at, {}, 1));
    ASSERT_TRUE(streamer->settle());
    ASSERT_TRUE(updater.frame(at, {}, 1));
    if (outage) {
      EXPECT_LT(updater.matrix().tiles.size(), tiles);
      EXPECT_NE(streamer->lastFailure(), "");
    }
    disk->outage = false;
    for (int tries = 0; outage && tries < 1000 && updater.matrix().tiles.size() != tiles; ++tries) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      ASSERT_TRUE(streamer->settle());
      ASSERT_TRUE(updater.frame(at, {}, 1));
    }
    tiles = updater.matrix().tiles.size();
    states[outage] = stateOf(updater, *solver);
  }
  EXPECT_EQ(states[0], states[1]);
}

// A flight with the matrix put together in the background, then a frame that waits for it: the state is that of a flight within frames. In between every frame
// has a whole cut, and light that is finite.
TEST(Updater, InTheBackgroundTheCutComesToTheSameState) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  LitState states[2];
  for (const bool background : {false, true}) {
    const auto streamer = std::move(*stream::Streamer::create(test.world(), {.radius_m = 8, .hysteresis = 1.0f}));
    const auto solver = makeCpuGather(1);
    Updater updater(test.world(), *streamer, *solver, FarLight::kPyramid, background);
    ASSERT_TRUE(updater.setSky(kSky));
    int changes = 0;
    for (float x = 5; x < 58; x += 0.25f) {
      const auto stats = updater.frame({x, 1, 30}, {15, 0, 0}, 2);
      ASSERT_TRUE(stats) << stats.error().line();
      changes += stats->matrix_changed;
      std::this_thread::sleep_for(std::chrono::microseconds(500));
      ASSERT_EQ(updater.source().size(), updater.matrix().slots());
      std::vector<Vec4> light(updater.matrix().slots());
      ASSERT_TRUE(updater.reflected(light));
      for (const uint32_t slot : updater.matrix().leaves) ASSERT_TRUE(std::isfinite(light[slot].x) && light[slot].x >= 0);
    }
    EXPECT_GT(changes, 10);
    streamer->update({58, 1, 30}, {});
    ASSERT_TRUE(streamer->settle());
    updater.awaitCut();
    ASSERT_TRUE(updater.frame({58, 1, 30}, {}, 1));
    states[background] = stateOf(updater, *solver);
  }
  EXPECT_EQ(states[0], states[1]);
}

// Sky and lamps change while matrices are put together beside the frames, and what was reckoned there may be of a light that is gone.
TEST(Updater, SourcesAreThoseOfNowWhateverChangesWhileAMatrixIsPutTogether) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  for (const bool has_direct : {false, true}) {
    const auto streamer = std::move(*stream::Streamer::create(test.world(), {.radius_m = 8, .hysteresis = 1.0f}));
    const auto solver = makeCpuGather(1);
    Updater updater(test.world(), *streamer, *solver, FarLight::kPyramid, true);
    if (has_direct)
      updater.setDirectLight([&test](formats::TileId id, std::span<Vec3> out) {
        const formats::TileInfo& info = test.world().tiles(id.level)[id.tile];
        for (uint32_t i = 0; i < info.nodes; ++i) out[i] = directAt(id.level, info.first_node + i);
      });
    std::mt19937_64 random(3);
    Sky sky = kSky;
    std::vector<Vec3> scale(updater.lamps().groups(), {1, 1, 1});
    ASSERT_TRUE(updater.setSky(sky));
    uint32_t entered = 0;
    for (float x = 5; x < 58; x += 0.25f) {
      if (random() % 3 == 0) {
        sky.l0 = {static_cast<float>(random() % 5), 1, 2};
        ASSERT_TRUE(updater.setSky(sky));
      }
      if (random() % 3 == 0) {
        const auto group = static_cast<uint32_t>(random() % scale.size());
        scale[group] = {static_cast<float>(random() % 4), 1, 0.5f};
        ASSERT_TRUE(updater.setLamp(group, scale[group]));
      }
      const auto stats = updater.frame({x, 1, 30}, {15, 0, 0}, 2);
      ASSERT_TRUE(stats) << stats.error().line();
      entered += stats->applied_tiles;
      std::this_thread::sleep_for(std::chrono::microseconds(500));
      for (const SlotRange& range : updater.matrix().tiles) {
        const formats::TileInfo& info = test.world().tiles(range.id.level)[range.id.tile];
        std::vector<Vec3> lamps(info.nodes);
        for (const formats::LampLight& lamp : test.strip(info.id).lamps) lamps[lamp.row] += test.world().info().lamp_groups[lamp.group].emission * scale[lamp.group] * lamp.weight;
        for (uint32_t i = 0; i < range.nodes; ++i) {
          const formats::Node& node = test.node(range.id.level, range.first_node + i);
          const Vec3 direct = has_direct ? directAt(range.id.level, range.first_node + i) : Vec3{};
          expectClose(updater.source()[range.first_slot + i], node.albedo * (direct + lamps[i] + skyIrradiance(sky, node)));
          expectClose(updater.emission()[range.first_slot + i], node.emission * (node.lamp_group < scale.size() ? scale[node.lamp_group] : Vec3{1, 1, 1}));
        }
      }
      if (testing::Test::HasFailure()) return;
    }
    EXPECT_GT(entered, 20u);
  }
}

// After a jump: never more than may, each cut a whole one; the state is that of one without a budget.
TEST(Updater, AFrameTakesAtMostItsBudgetOfTiles) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const stream::StreamSettings settings{.radius_m = 8, .hysteresis = 1.0f};
  const Vec3 first{8, 1, 8}, at{50, 1, 40};
  constexpr uint32_t kTiles = 4;
  LitState expected;
  for (const uint32_t budget : {0u, kTiles})
    for (const bool background : {false, true}) {
      const auto streamer = std::move(*stream::Streamer::create(test.world(), settings));
      const auto solver = makeCpuGather(1);
      Updater updater(test.world(), *streamer, *solver, FarLight::kPyramid, background, {}, budget);
      ASSERT_TRUE(updater.setSky(kSky));
      updater.awaitCut();
      ASSERT_TRUE(updater.frame(first, {}, 1));
      ASSERT_TRUE(streamer->settle());
      updater.awaitCut();
      ASSERT_TRUE(updater.frame(first, {}, 1));
      streamer->update(at, {});
      ASSERT_TRUE(streamer->settle());
      uint32_t frames = 0, applied = 0, most = 0;
      for (bool over = false; !over && frames < 1000; ++frames) {
        const auto stats = updater.frame(at, {}, 1);
        ASSERT_TRUE(stats) << stats.error().line();
        updater.awaitBuild();
        const LocalMatrix& m = updater.matrix();
        applied += stats->applied_tiles;
        most = std::max(most, stats->applied_tiles);
        ASSERT_EQ(stats->applied_tiles, stats->matrix_changed ? updater.change().entered.size() : 0u);
        for (const uint32_t t : stats->matrix_changed ? updater.change().entered : std::vector<uint32_t>()) {
          const formats::TileInfo& info = test.world().tiles(m.tiles[t].id.level)[m.tiles[t].id.tile];
          ASSERT_EQ(m.tiles[t].nodes, info.nodes);
          ASSERT_TRUE(info.id.level == test.top() || m.parent_slot[m.tiles[t].first_slot] != kNoSlot) << "without its parent";
        }
        over = m.tiles.size() == streamer->active().size() && stats->waiting_tiles == 0 && !stats->matrix_changed && applied > 0;
      }
      ASSERT_LT(frames, 1000u);
      EXPECT_GT(applied, 20u);
      if (budget > 0)
        EXPECT_LE(most, kTiles);
      else
        EXPECT_GT(most, kTiles);
      const LitState state = stateOf(updater, *solver);
      if (expected.empty()) expected = state;
      EXPECT_TRUE(state == expected);
    }
}

TEST(CutBudget, LetsTheNearestInParentsFirst) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const Cut all = test.randomCut(1, 1), some = test.randomCut(0.3, 5);
  const stream::Observers observer(stream::Observer{{20, 1, 30}, {}});
  const auto key = [&](const stream::StripPtr& strip) {
    return std::pair(observer.distance(strip->tile.info().bounds) / test.world().levels()[strip->id.level].cell_m, test.top() - strip->id.level);
  };
  for (const uint32_t tiles : {1u, 7u, 50u, 100000u}) {
    CutBudget budget(test.world(), tiles);
    Cut there = some;
    for (int turn = 0; turn < 10; ++turn) {
      const auto limited = budget.limit(all, there, observer);
      Cut entered, kept_back;
      std::ranges::set_difference(limited, there, std::back_inserter(entered), {}, &stream::ResidentStrip::id, &stream::ResidentStrip::id);
      std::ranges::set_difference(all, limited, std::back_inserter(kept_back), {}, &stream::ResidentStrip::id, &stream::ResidentStrip::id);
      ASSERT_EQ(entered.size(), std::min<size_t>(tiles, all.size() - there.size()));
      ASSERT_EQ(kept_back.size(), budget.waiting());
      if (!entered.empty() && !kept_back.empty()) {
        EXPECT_LE(key(*std::ranges::max_element(entered, {}, key)), key(*std::ranges::min_element(kept_back, {}, key)));
      }
      std::set<formats::TileId> in;
      for (const stream::StripPtr& strip : limited) in.insert(strip->id);
      ASSERT_TRUE(std::ranges::is_sorted(limited, {}, [](const stream::StripPtr& s) { return s->id; }));
      for (const stream::StripPtr& strip : limited)
        if (strip->id.level < test.top()) {
          ASSERT_TRUE(in.contains({strip->id.level + 1, strip->tile.info().parent_tile}));
        }
      there.assign(limited.begin(), limited.end());
    }
  }
}

TEST(Updater, LightSettlesWhateverTilesThatLeftHadInTheirSlots) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  Walker walker(test);
  const auto moveTo = [&](Vec3 at, int iterations) {
    ASSERT_TRUE(walker.updater.frame(at, {}, 0));
    ASSERT_TRUE(walker.streamer->settle());
    ASSERT_TRUE(walker.updater.frame(at, {}, iterations));
  };
  for (int i = 0; i < 40; ++i) {  // light on its way, an odd and an even number of steps from one cut to the next
    walker.strength = 1 + static_cast<float>(i % 3);
    walker.updater.lightChanged();
    moveTo({static_cast<float>(i * 37 % 64), 1, static_cast<float>(i * 23 % 64)}, i % 3);
  }
  const auto settled = walker.updater.converge(1e-5f, 1000);
  ASSERT_TRUE(settled);
  EXPECT_LT(settled->iterations, 200);  // albedo <= 0.9 shrinks a change to a hundred thousandth in 110 steps
}

TEST(Updater, WhatIsReflectedCarriesOverByNodeWhenTheCutChanges) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  Walker walker(test);
  ASSERT_TRUE(walker.updater.frame({30, 1, 30}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({30, 1, 30.01f}, {}, 1));
  ASSERT_TRUE(walker.updater.converge(1e-6f, 1000));
  const std::vector<SlotRange> old = walker.updater.matrix().tiles;
  const std::vector<Vec4> before = walker.reflected();
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({36, 1, 30}, {}, 0));
  ASSERT_TRUE(walker.streamer->settle());
  const auto frame = walker.updater.frame({36, 1, 30.01f}, {}, 0);
  ASSERT_TRUE(frame);
  const std::vector<Vec4> after = walker.reflected();
  int kept = 0, inherited = 0;
  for (const SlotRange& range : walker.updater.matrix().tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      uint64_t node = range.first_node + i;
      uint32_t level = range.id.level, slot = slotOf(old, level, node);
      ++(slot != kNoSlot ? kept : inherited);
      for (; slot == kNoSlot; slot = slotOf(old, level, node)) node = test.world().parent(level++, node);
      ASSERT_EQ(after[range.first_slot + i].x, before[slot].x);
    }
  EXPECT_GT(kept, 0);
  EXPECT_GT(inherited, 0);
}

// Refuses what it is told for a while, as a device that has no room for a cut does.
class Refusing final : public Solver {
 public:
  int updates = 0, sources = 0;  // to refuse
  int last_steps = 0;
  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override {
    return updates-- > 0 ? refusal() : good_->update(matrix, change);
  }
  bool resolvesRows() const override { return good_->resolvesRows(); }
  Result<void> setSource(std::span<const Vec4> source) override { return sources-- > 0 ? refusal() : good_->setSource(source); }
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override { return good_->setRadiosity(radiosity); }
  Result<void> iterate(int k) override {
    last_steps = k;
    return good_->iterate(k);
  }
  Result<void> radiosity(std::span<Vec4> out) override { return good_->radiosity(out); }
  double lastMs() const override { return 0; }
  const char* name() const override { return "refusing"; }

 private:
  static Result<void> refusal() { return Error{ErrorCode::kIo, "", "", "refused", ""}; }
  std::unique_ptr<Solver> good_ = makeCpuGather(2);
};

TEST(Updater, OneStepAFrameDoesOnceLightHasRested) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const auto streamer = std::move(*stream::Streamer::create(test.world(), {.radius_m = 8, .hysteresis = 1.0f}));
  Refusing solver;
  Updater updater(test.world(), *streamer, solver);
  ASSERT_TRUE(updater.setSky(kSky));
  Vec3 at{10, 1, 30};
  const auto framesUntilOne = [&] {
    for (int frame = 1; frame < 200; ++frame) {
      at.x += 0.05f;  // the cut changes
      EXPECT_TRUE(updater.frame(at, {}, Updater::kAsLightNeeds));
      if (solver.last_steps == 1) return frame;
      EXPECT_EQ(solver.last_steps, 2);
    }
    return 0;
  };
  EXPECT_NEAR(framesUntilOne(), 60, 1);
  ASSERT_TRUE(updater.setLamp(0, {0, 0, 0}));
  EXPECT_NEAR(framesUntilOne(), 60, 1) << "a lamp has been switched";
  at.x += 20;
  EXPECT_NEAR(framesUntilOne(), 60, 1) << "somebody has jumped";
  ASSERT_TRUE(updater.frame(at, {}, 5));
  EXPECT_EQ(solver.last_steps, 5) << "who says how many gets so many";
}

TEST(Updater, TellsASolverAgainWhatItRefusedUntilItTakesIt) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  Walker expected(test);
  const auto streamer = std::move(*stream::Streamer::create(test.world(), {.radius_m = 8, .hysteresis = 1.0f}));
  Refusing solver;
  Updater updater(test.world(), *streamer, solver);
  ASSERT_TRUE(updater.setSky(kSky));
  updater.setDirectLight([&](formats::TileId id, std::span<Vec3> out) {
    const formats::TileInfo& info = test.world().tiles(id.level)[id.tile];
    for (uint32_t i = 0; i < info.nodes; ++i) out[i] = directAt(id.level, info.first_node + i);
  });
  const auto expectTheLightOf = [&](const Sky& sky, Vec3 at) {
    ASSERT_TRUE(expected.updater.setSky(sky));
    ASSERT_TRUE(expected.updater.frame(at, {}, 1));
    ASSERT_TRUE(expected.streamer->settle());
    ASSERT_TRUE(expected.updater.frame(at + Vec3{0, 0, 0.01f}, {}, 1));
    ASSERT_TRUE(expected.updater.converge(1e-6f, 1000));
    ASSERT_TRUE(updater.converge(1e-6f, 1000));
    std::vector<Vec4> radiosity(updater.matrix().slots());
    ASSERT_TRUE(updater.radiosity(radiosity));
    const std::vector<Vec4> right = expected.radiosity();
    ASSERT_EQ(updater.matrix().tiles.size(), expected.updater.matrix().tiles.size());
    for (const SlotRange& range : expected.updater.matrix().tiles)
      for (uint32_t i = 0; i < range.nodes; ++i) {
        const Vec4& r = right[range.first_slot + i];
        expectClose(radiosity[updater.matrix().slotOf(range.id.level, range.first_node + i)], {r.x, r.y, r.z});
      }
  };
  // The first cut of all, a later one, and one more that comes before that has been taken up.
  Vec3 at{10, 1, 10};
  for (const Vec3 next : {Vec3{10, 1, 10}, Vec3{40, 1, 40}, Vec3{20, 1, 50}}) {
    solver.updates = 3;
    at = next;
    int refused = 0;
    for (int frame = 0; frame < 3; ++frame) {
      ASSERT_TRUE(streamer->settle());
      refused += !updater.frame(frame == 1 ? at + Vec3{6, 0, 0} : at, {}, 1);
    }
    EXPECT_EQ(refused, 3);
    const auto taken = updater.frame(at, {}, 1);
    ASSERT_TRUE(taken) << taken.error().line();
    EXPECT_TRUE(taken->matrix_changed);
    expectTheLightOf(kSky, at);
  }
  // And light alone.
  Sky dim = kSky;
  dim.l0 = {0.5f, 0.25f, 0};
  ASSERT_TRUE(updater.setSky(dim));
  solver.sources = 2;
  EXPECT_FALSE(updater.frame(at, {}, 1));
  EXPECT_FALSE(updater.frame(at, {}, 1));
  EXPECT_TRUE(updater.frame(at, {}, 1));
  expectTheLightOf(dim, at);
}

}  // namespace
}  // namespace ff::runtime
