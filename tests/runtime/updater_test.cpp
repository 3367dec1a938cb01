#include "runtime/updater.h"

#include <cmath>

#include "runtime/full_solve.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

constexpr Sky kSky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}};

// Direct irradiance by node number: any function will do, as long as its caller can repeat it.
Vec3 directAt(uint32_t level, uint32_t node) {
  return {static_cast<float>((node * 7 + level) % 11), static_cast<float>(node % 5), 1};
}

struct Walker {
  explicit Walker(const TestWorld& test, stream::StreamSettings settings = {.radius_m = 8, .hysteresis = 1.0f})
      : streamer(std::move(*stream::Streamer::create(test.world(), settings))),
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
  float strength = 1;
  int asked = 0;
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<Solver> solver;
  Updater updater;
};

TEST(Updater, SourceIsEmissionAndReflectedSkyAndDirectLight) {
  const TestWorld test({.side = 32, .tile_nodes = 24, .seed = 2});
  Walker walker(test);
  ASSERT_TRUE(walker.updater.frame({16, 1, 16}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({16.5f, 1, 16}, {}, 1));
  for (const SlotRange& range : walker.updater.matrix().tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const formats::Node& node = test.node(range.id.level, range.first_node + i);
      const Vec3 direct = directAt(range.id.level, range.first_node + i);
      for (int c = 0; c < 3; ++c) {
        const float sky = 3.14159265f * static_cast<float>(node.sky) / static_cast<float>(node.quanta) *
                          (kSky.l0[c] + dot(kSky.l1[c], node.sky_direction));
        const float expected_direct = node.emission[c] + node.albedo[c] * direct[c];
        const float expected = expected_direct + node.albedo[c] * sky;
        const Vec4 got = walker.updater.source()[range.first_slot + i],
                   got_direct = walker.updater.direct()[range.first_slot + i];
        ASSERT_NEAR(c == 0 ? got.x : c == 1 ? got.y : got.z, expected, 1e-5f * (1 + expected));
        ASSERT_NEAR(c == 0   ? got_direct.x
                    : c == 1 ? got_direct.y
                             : got_direct.z,
                    expected_direct, 1e-5f * (1 + expected));
      }
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

TEST(Updater, RadiosityCarriesOverByNodeWhenTheCutChanges) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  Walker walker(test);
  ASSERT_TRUE(walker.updater.frame({30, 1, 30}, {}, 1));
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({30, 1, 30.01f}, {}, 1));
  ASSERT_TRUE(walker.updater.converge(1e-6f, 1000));
  const std::vector<SlotRange> old = walker.updater.matrix().tiles;
  const std::vector<Vec4> before = walker.radiosity();
  ASSERT_TRUE(walker.streamer->settle());
  ASSERT_TRUE(walker.updater.frame({36, 1, 30}, {}, 0));
  ASSERT_TRUE(walker.streamer->settle());
  const auto frame = walker.updater.frame({36, 1, 30.01f}, {}, 0);
  ASSERT_TRUE(frame);
  const std::vector<Vec4> after = walker.radiosity();
  int kept = 0, inherited = 0;
  for (const SlotRange& range : walker.updater.matrix().tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      uint32_t node = range.first_node + i, level = range.id.level, slot = slotOf(old, level, node);
      ++(slot != kNoSlot ? kept : inherited);
      for (; slot == kNoSlot; slot = slotOf(old, level, node)) node = test.world().parent(level++, node);
      ASSERT_EQ(after[range.first_slot + i].x, before[slot].x);
    }
  EXPECT_GT(kept, 0);
  EXPECT_GT(inherited, 0);
}

}  // namespace
}  // namespace ff::runtime
