// Worlds that are baked again while they are shown.
#include <cmath>
#include <filesystem>
#include <thread>

#include "formats/codec/records.h"
#include "runtime/api/formfield_handles.h"
#include "tests/runtime/lit_state.h"
#include "tests/support/counted_memory.h"
#include "tests/support/synthetic_world.h"

namespace ff::runtime {
namespace {

constexpr FormfieldSky kSkyOverBakes{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}, {}};
const stream::SyntheticSettings kFirst{.side = 64, .tile_nodes = 40, .seed = 2};

// Does with level and node of this bake alone, so that a world just opened gets the same.
void lightByNumber(void*, uint32_t level, uint32_t, uint64_t first_node, uint32_t nodes, const FormfieldNode*, float* irradiance) {
  for (uint32_t i = 0; i < nodes; ++i) irradiance[3 * i] = static_cast<float>(((first_node + i) * 7 + level) % 11);
}

class Reload : public testing::Test {
 protected:
  Reload() {
    EXPECT_EQ(formfieldCreateCpuDevice(2, &device_), FORMFIELD_OK);
    formfieldDefaultWorldSettings(&settings_);
    settings_.radius_m = 8;
    settings_.hysteresis = 1;
    settings_.solver = FORMFIELD_SOLVER_GATHER;  // the bits of a dense matrix depend on how nodes came and went
    settings_.probes = 16;
    settings_.probe_rays = 32;
    bake(stream::makeSyntheticWorld(kFirst));
  }
  ~Reload() override {
    formfieldCloseWorld(world_);
    formfieldDestroyDevice(device_);
  }
  void bake(const formats::RandomWorld& world) { ASSERT_TRUE(formats::writeWorld(world, path_, uint64_t{1} << 18)); }
  FormfieldWorld open() {
    FormfieldWorld world = nullptr;
    EXPECT_EQ(formfieldOpenWorld(device_, path_.c_str(), &settings_, &world), FORMFIELD_OK) << formfieldError(device_);
    EXPECT_EQ(formfieldSetSky(world, &kSkyOverBakes), FORMFIELD_OK);
    EXPECT_EQ(formfieldSetDirectLight(world, lightByNumber, nullptr), FORMFIELD_OK);
    return world;
  }
  void frame(FormfieldWorld world, double x, float speed = 3) {
    const double at[3] = {x, 1, 30};
    const float velocity[3] = {speed, 0, 0};
    ASSERT_EQ(formfieldFrame(world, at, velocity), FORMFIELD_OK) << formfieldError(device_);
  }
  static FormfieldStats stats(FormfieldWorld world) {
    FormfieldStats stats{};
    stats.size = sizeof(stats);
    EXPECT_EQ(formfieldGetStats(world, &stats), FORMFIELD_OK);
    return stats;
  }
  // Frames of an observer who walks along, at least one, until `done` or for half a minute. Each has a whole cut and sound light, and takes no memory.
  template <class Done>
  bool walkUntil(const Done& done) {
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    for (bool over = false; !over && std::chrono::steady_clock::now() < until;) {
      x_ = x_ > 50 ? 10 : x_ + 0.05;
      const MemoryCalls before = memoryCalls();
      frame(world_, x_);
      const MemoryCalls after = memoryCalls();
      EXPECT_EQ(after.allocated - before.allocated + after.freed - before.freed, 0u);
      uint32_t slots = 0, tiles = 0;
      const float* const light = formfieldRadiosity(world_, &slots);
      const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
      for (uint32_t t = 0; t < tiles; ++t)
        for (uint32_t s = tile[t].first_slot; s < tile[t].first_slot + tile[t].nodes; ++s) EXPECT_TRUE(s < slots && std::isfinite(light[4 * s]) && light[4 * s] >= 0);
      over = done();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return done();
  }
  bool walkUntilReloads(uint32_t reloads) {
    return walkUntil([&] { return stats(world_).reloads >= reloads; });
  }
  void setLamp(FormfieldWorld world, const char* name, float scale) {
    uint32_t group = 0;
    const float scales[3] = {scale, scale, scale};
    ASSERT_EQ(formfieldFindLampGroup(world, name, &group), FORMFIELD_OK) << formfieldError(device_);
    ASSERT_EQ(formfieldSetEmission(world, group, scales), FORMFIELD_OK);
  }
  // What all nodes come to where an observer stays.
  LitState settledState(FormfieldWorld world, double x) {
    frame(world, x, 0);
    EXPECT_EQ(formfieldSettle(world, 1e-6f, 2000), FORMFIELD_OK) << formfieldError(device_);
    return stateOf(world->updater(), *world->solver.solver);
  }
  static void expectSame(const LitState& got, const LitState& expected) {
    EXPECT_EQ(got.size(), expected.size());
    for (const auto& [node, values] : expected) {
      const auto at = got.find(node);
      ASSERT_TRUE(at != got.end()) << "node " << node.second << " of level " << node.first;
      ASSERT_EQ(at->second, values) << "node " << node.second << " of level " << node.first;
    }
  }
  // What is shown is what a world just opened shows.
  void expectFresh() {
    const auto got = settledState(world_, 33);
    FormfieldWorld fresh = open();
    setLamp(fresh, "lamp 1", 0.25f);
    expectSame(got, settledState(fresh, 33));
    FormfieldWorldInfo info{}, expected{};
    info.size = expected.size = sizeof(info);
    EXPECT_EQ(formfieldGetWorldInfo(world_, &info), FORMFIELD_OK);
    EXPECT_EQ(formfieldGetWorldInfo(fresh, &expected), FORMFIELD_OK);
    EXPECT_EQ(info.patches, expected.patches);
    EXPECT_EQ(info.origin[0], expected.origin[0]);
    const float point[3] = {33, 2, 30}, up[3] = {0, 1, 0};
    float irradiance[3], of_fresh[3];
    EXPECT_EQ(formfieldSample(world_, 1, point, up, irradiance), FORMFIELD_OK);
    EXPECT_EQ(formfieldSample(fresh, 1, point, up, of_fresh), FORMFIELD_OK);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(irradiance[c], of_fresh[c], 1e-4f * of_fresh[c]);
    formfieldCloseWorld(fresh);
  }

  formats::TemporaryFolder folder_;
  const std::string path_ = folder_.file("world.ffm");
  FormfieldDevice device_ = nullptr;
  FormfieldWorld world_ = nullptr;
  FormfieldWorldSettings settings_;
  double x_ = 20;
};

TEST_F(Reload, AReBakeIsTakenUpBetweenTwoFramesAndTheStateIsThatOfAFreshStart) {
  settings_.reload_seconds = 0.01f;
  world_ = open();
  setLamp(world_, "lamp 1", 0.25f);
  ASSERT_TRUE(walkUntil([&] { return stats(world_).late_tiles == 0; }));
  auto other = kFirst;
  other.seed = 3;
  bake(stream::makeSyntheticWorld(other));
  ASSERT_TRUE(walkUntilReloads(1)) << formfieldReloadFailure(world_);
  expectFresh();
  // Of another size, depth and number of levels.
  auto larger = kFirst;
  larger.side = 128, larger.levels = 5, larger.tile_nodes = 64, larger.seed = 4;
  bake(stream::makeSyntheticWorld(larger));
  ASSERT_TRUE(walkUntilReloads(2)) << formfieldReloadFailure(world_);
  expectFresh();
  // Its lamp groups in another order, one of them gone, one new.
  auto lamps = stream::makeSyntheticWorld(kFirst);
  lamps.info.lamp_groups[0].name = "lamp 1";
  lamps.info.lamp_groups[1].name = "torch";
  bake(lamps);
  ASSERT_TRUE(walkUntilReloads(3)) << formfieldReloadFailure(world_);
  expectFresh();
  // Its grid begins elsewhere.
  lamps.info.origin = {8, 0, 0};
  bake(lamps);
  ASSERT_TRUE(walkUntilReloads(4)) << formfieldReloadFailure(world_);
  expectFresh();
  EXPECT_EQ(stats(world_).reload_failures, 0u);
  EXPECT_STREQ(formfieldReloadFailure(world_), "");
}

TEST_F(Reload, LightGoesOnNodeByNodeAndFiguresCountOn) {
  world_ = open();
  frame(world_, 30);
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 2000), FORMFIELD_OK);
  std::map<std::pair<uint32_t, uint32_t>, float> before;
  const auto light = [&] {
    std::map<std::pair<uint32_t, uint32_t>, float> values;
    uint32_t slots = 0, tiles = 0;
    const float* const radiosity = formfieldRadiosity(world_, &slots);
    const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
    for (uint32_t t = 0; t < tiles; ++t)
      for (uint32_t i = 0; i < tile[t].nodes; ++i) values[{tile[t].level, tile[t].first_node + i}] = radiosity[4 * (tile[t].first_slot + i) + 1];
    return values;
  };
  before = light();
  const auto read = stats(world_).strips_read;
  ASSERT_EQ(formfieldReload(world_), FORMFIELD_OK);  // the same world
  for (int i = 0; stats(world_).reloads == 0 && i < 10000; ++i) {
    frame(world_, 30);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ASSERT_EQ(stats(world_).reloads, 1u);
  const auto after = light();  // of the frame that changed over
  ASSERT_EQ(after.size(), before.size());
  float largest = 0;
  for (const auto& [node, b] : before) largest = std::max(largest, b);
  // What is left after settling, as in GivesTheLightOfTheRuntimeBeneath.
  for (const auto& [node, b] : before) EXPECT_NEAR(after.at(node), b, 2e-5f * largest);
  EXPECT_GT(stats(world_).strips_read, read);
}

TEST_F(Reload, WhatCannotBeOpenedIsLeftAloneInOneLineUntilItCan) {
  world_ = open();
  setLamp(world_, "lamp 1", 0.25f);
  ASSERT_TRUE(walkUntil([&] { return stats(world_).late_tiles == 0; }));
  const auto expected = settledState(world_, 33);
  auto other = kFirst;
  other.seed = 3;
  const auto next = stream::makeSyntheticWorld(other);
  uint32_t failures = 0;
  const auto expectRefused = [&](const char* name, const std::string& damage) {
    ASSERT_EQ(formfieldReload(world_), FORMFIELD_OK);
    ++failures;
    ASSERT_TRUE(walkUntil([&] { return stats(world_).reload_failures == failures; })) << damage;
    const std::string line = formfieldReloadFailure(world_);
    EXPECT_NE(line.find(name), std::string::npos) << line;
    EXPECT_EQ(line.find('\n'), std::string::npos);
    // Again: nothing new to say.
    ASSERT_EQ(formfieldReload(world_), FORMFIELD_OK);
    for (int i = 0; i < 50; ++i) ASSERT_TRUE(walkUntil([] { return true; }));
    EXPECT_EQ(stats(world_).reload_failures, failures) << damage;
    EXPECT_EQ(stats(world_).reloads, 0u);
    expectSame(settledState(world_, 33), expected);
  };
  bake(next);
  const auto manifest = formats::readFile(path_);
  const std::string shard = formats::shardOf(path_, formats::kKindRows);
  const auto rows = formats::readFile(shard);

  formats::writeFile(path_, std::span(manifest).first(manifest.size() / 2));
  expectRefused("world.ffm", "half a manifest");
  auto bytes = manifest;
  bytes[8] = std::byte{0x7f};
  formats::writeFile(path_, bytes);
  expectRefused("world.ffm", "another format");
  std::filesystem::remove(path_);
  ASSERT_EQ(formfieldReload(world_), FORMFIELD_OK);
  ++failures;
  ASSERT_TRUE(walkUntil([&] { return stats(world_).reload_failures == failures; })) << "no manifest";
  formats::writeFile(path_, manifest);
  std::filesystem::remove(shard);
  expectRefused(std::filesystem::path(shard).filename().c_str(), "a shard that has not come yet");
  formats::writeFile(shard, std::span(rows).first(rows.size() - 100));
  expectRefused(std::filesystem::path(shard).filename().c_str(), "half a shard");
  bytes = rows;
  for (size_t at = formats::kShardHeaderBytes; at < bytes.size(); at += 97) bytes[at] ^= std::byte{1};
  formats::writeFile(shard, bytes);
  expectRefused(std::filesystem::path(shard).filename().c_str(), "damaged strips");
  // It has come whole.
  formats::writeFile(shard, rows);
  ASSERT_EQ(formfieldReload(world_), FORMFIELD_OK);
  ASSERT_TRUE(walkUntilReloads(1)) << formfieldReloadFailure(world_);
  EXPECT_STREQ(formfieldReloadFailure(world_), "");
  expectFresh();
}

TEST_F(Reload, AWorldThatIsLookedAtTriesAgainAtTheNextChangeAndKeepsToTheSameBytes) {
  settings_.reload_seconds = 0.01f;
  world_ = open();
  setLamp(world_, "lamp 1", 0.25f);
  ASSERT_TRUE(walkUntil([&] { return stats(world_).late_tiles == 0; }));
  bake(stream::makeSyntheticWorld(kFirst));  // the same bytes in another file
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(walkUntil([] { return true; }));
  EXPECT_EQ(stats(world_).reloads, 0u);
  formats::writeFile(path_, std::vector<std::byte>(1000));
  ASSERT_TRUE(walkUntil([&] { return stats(world_).reload_failures >= 1; }));  // 2 if it was looked at while it was being written
  EXPECT_NE(std::string(formfieldReloadFailure(world_)), "");
  auto other = kFirst;
  other.seed = 3;
  bake(stream::makeSyntheticWorld(other));
  ASSERT_TRUE(walkUntilReloads(1)) << formfieldReloadFailure(world_);
  expectFresh();
}

TEST_F(Reload, CanBeClosedAtAnyTime) {
  settings_.reload_seconds = 0.001f;
  for (int i = 0; i < 8; ++i) {
    auto other = kFirst;
    other.seed = static_cast<uint64_t>(10 + i);
    world_ = open();
    frame(world_, 30);
    bake(stream::makeSyntheticWorld(other));
    std::this_thread::sleep_for(std::chrono::milliseconds(i));
    if (i % 2 == 1) frame(world_, 30);
    formfieldCloseWorld(std::exchange(world_, nullptr));
  }
}

}  // namespace
}  // namespace ff::runtime
