#include "runtime/api/formfield.h"

#include <sched.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "runtime/choose_solver.h"
#include "runtime/updater.h"
#include "tests/runtime/test_world.h"
#include "tests/support/counted_memory.h"

namespace ff::runtime {
namespace {

// Any function of the node will do, as long as the other side can repeat it.
Vec3 directLightOf(uint32_t level, uint64_t node) {
  return {static_cast<float>((node * 7 + level) % 11), static_cast<float>(node % 5), 1};
}

void directLight(void* user, uint32_t level, uint32_t, uint64_t first_node, uint32_t nodes, const FormfieldNode* node,
                 float* irradiance) {
  ++*static_cast<int*>(user);
  for (uint32_t i = 0; i < nodes; ++i) {
    EXPECT_EQ(irradiance[3 * i], 0.0f);
    EXPECT_GT(node[i].area_m2, 0.0f);
    const Vec3 e = directLightOf(level, first_node + i);
    for (int c = 0; c < 3; ++c) irradiance[3 * i + static_cast<uint32_t>(c)] = e[c];
  }
}

constexpr FormfieldSky kBlueSky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}, {}};

class Formfield : public testing::Test {
 protected:
  Formfield() : test_({.side = 64, .tile_nodes = 40, .seed = 2}) {
    EXPECT_EQ(formfieldCreateCpuDevice(2, &device_), FORMFIELD_OK);
    formfieldDefaultWorldSettings(&settings_);
    settings_.radius_m = 8;
    settings_.hysteresis = 1;
  }
  ~Formfield() override {
    formfieldCloseWorld(world_);
    formfieldDestroyDevice(device_);
  }
  void open() {
    ASSERT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &settings_, &world_), FORMFIELD_OK)
        << formfieldError(device_);
    ASSERT_EQ(formfieldSetSky(world_, &kBlueSky), FORMFIELD_OK);
    ASSERT_EQ(formfieldSetDirectLight(world_, directLight, &asked_), FORMFIELD_OK);
  }
  void frame(Vec3 at) {
    const double observer[3] = {static_cast<double>(at.x), static_cast<double>(at.y), static_cast<double>(at.z)};
    const float velocity[3] = {};
    ASSERT_EQ(formfieldFrame(world_, observer, velocity), FORMFIELD_OK) << formfieldError(device_);
  }
  FormfieldStats stats() {
    FormfieldStats stats{};
    stats.size = sizeof(stats);
    EXPECT_EQ(formfieldGetStats(world_, &stats), FORMFIELD_OK);
    return stats;
  }
  std::vector<uint32_t> patchSlots() {
    std::vector<uint32_t> slots(test_.world().levels()[0].nodes);
    EXPECT_EQ(formfieldPatchSlots(world_, 0, static_cast<uint32_t>(slots.size()), slots.data()), FORMFIELD_OK);
    return slots;
  }

  TestWorld test_;
  FormfieldDevice device_ = nullptr;
  FormfieldWorld world_ = nullptr;
  FormfieldWorldSettings settings_;
  int asked_ = 0;
};

TEST_F(Formfield, GivesTheLightOfTheRuntimeBeneath) {
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK) << formfieldError(device_);
  const auto streamer = std::move(*stream::Streamer::create(test_.world(), {.radius_m = 8, .hysteresis = 1}));
  const auto solver = makeCpuGather(2);
  Updater updater(test_.world(), *streamer, *solver);
  ASSERT_TRUE(updater.setSky({{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}}));
  updater.setDirectLight([&](formats::TileId id, std::span<Vec3> out) {
    for (uint32_t i = 0; i < out.size(); ++i)
      out[i] = directLightOf(id.level, test_.world().tiles(id.level)[id.tile].first_node + i);
  });
  ASSERT_TRUE(updater.frame({30, 1, 30}, {}, 1));
  ASSERT_TRUE(streamer->settle());
  ASSERT_TRUE(updater.frame({30, 1, 30}, {}, 1));
  ASSERT_TRUE(updater.converge(1e-7f, 1000));
  std::vector<Vec4> expected(updater.matrix().slots());
  ASSERT_TRUE(updater.radiosity(expected));
  uint32_t slots = 0, tiles = 0, compared = 0;
  const float* const radiosity = formfieldRadiosity(world_, &slots);
  const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
  ASSERT_EQ(tiles, updater.matrix().tiles.size());
  for (uint32_t t = 0; t < tiles; ++t)
    for (uint32_t i = 0; i < tile[t].nodes; ++i, ++compared) {
      ASSERT_LT(tile[t].first_slot + i, slots);
      const Vec4 b = expected[updater.matrix().slotOf(tile[t].level, tile[t].first_node + i)];
      // Both stop when a change is below 1e-7 of the largest; albedo <= 0.9 leaves at most 9 such changes to come.
      ASSERT_NEAR(radiosity[4 * (tile[t].first_slot + i)], b.x, 2e-5f * (1 + b.x));
    }
  EXPECT_GT(compared, 1000u);
  EXPECT_LT(stats().residual, 1e-6);
}

// Of this process; without the kernel's own, which a ring has.
std::set<pid_t> threadsNow() {
  std::set<pid_t> threads;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string name;
    std::getline(std::ifstream(task.path() / "comm"), name);
    if (!name.starts_with("iou-")) threads.insert(std::stoi(task.path().filename()));
  }
  return threads;
}

TEST_F(Formfield, SaysWhatBudgetsHaveRoomFor) {
  settings_.radius_m = 0;
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
  EXPECT_EQ(stats().reached_radius_m, 16 * test_.world().info().cell_m);  // as the header says of 0
  EXPECT_EQ(stats().reached_growth, settings_.growth);
  EXPECT_STREQ(formfieldBudgetWarning(world_), "");
  formfieldCloseWorld(std::exchange(world_, nullptr));
  settings_.max_patches = 300;
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
  EXPECT_LT(stats().reached_radius_m, 16 * test_.world().info().cell_m);
  EXPECT_LE(stats().level0_leaves, 300u);
  EXPECT_EQ(std::string(formfieldBudgetWarning(world_)).find("max_patches ran out at (30, 1, 30) m: there was room for a radius of "), 0u);
  EXPECT_STREQ(formfieldBudgetWarning(nullptr), "");
}

TEST_F(Formfield, ThreadsOfAWorldTakeNoCoreFromAFrame) {
  if (sched_getscheduler(0) != SCHED_OTHER) GTEST_SKIP() << "the tests run under another policy of scheduling";
  const std::set<pid_t> before = threadsNow();
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
  std::map<int, int> threads;  // by policy
  for (const pid_t thread : threadsNow())
    if (!before.contains(thread)) ++threads[sched_getscheduler(thread)];
  EXPECT_GE(threads[SCHED_BATCH], 4);  // that read, decode, plan and put matrices together
  EXPECT_EQ(threads[SCHED_OTHER], 1);  // the solver's second, for which a frame waits
}

TEST_F(Formfield, SeveralObserversHaveOneWorld) {
  open();
  const FormfieldObserver all[] = {{{10, 1, 10}, {}}, {{50, 1, 40}, {}}};
  const auto patchesThere = [&] {  // at full resolution
    EXPECT_EQ(formfieldSettle(world_, 1e-6f, 1000), FORMFIELD_OK);
    uint32_t tiles = 0;
    std::set<uint64_t> patches;
    const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
    for (uint32_t t = 0; t < tiles && tile[t].level == 0; ++t) patches.insert(tile[t].first_node);
    return patches;
  };
  std::set<uint64_t> expected;
  for (const FormfieldObserver& one : all) {
    ASSERT_EQ(formfieldFrame(world_, one.position, one.velocity), FORMFIELD_OK);
    expected.merge(patchesThere());
  }
  ASSERT_EQ(formfieldFrameFor(world_, 2, all), FORMFIELD_OK) << formfieldError(device_);
  EXPECT_EQ(patchesThere(), expected);
  // Samples near either.
  const float points[] = {10, 1, 10, 50, 1, 40}, normals[] = {0, 1, 0, 0, 1, 0};
  float irradiance[6] = {};
  ASSERT_EQ(formfieldSample(world_, 2, points, normals, irradiance), FORMFIELD_OK);
  EXPECT_GT(irradiance[0], 0);
  EXPECT_GT(irradiance[3], 0);
  const std::vector<FormfieldObserver> many(FORMFIELD_MAX_OBSERVERS + 1);
  EXPECT_EQ(formfieldFrameFor(world_, FORMFIELD_MAX_OBSERVERS, many.data()), FORMFIELD_OK);
  EXPECT_EQ(formfieldFrameFor(world_, FORMFIELD_MAX_OBSERVERS + 1, many.data()), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldFrameFor(world_, 0, many.data()), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldFrameFor(world_, 1, nullptr), FORMFIELD_ERROR_USAGE);
  const FormfieldObserver nowhere{{NAN, 0, 0}, {}};
  EXPECT_EQ(formfieldFrameFor(world_, 1, &nowhere), FORMFIELD_ERROR_USAGE);
}

TEST_F(Formfield, WhatIsExpectedIsThereWhenTheObserverJumps) {
  uint32_t late[2];
  for (const bool expected : {false, true}) {
    open();
    frame({10, 1, 10});
    ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
    const FormfieldPlace place{{50, 1, 40}, 0.05f};
    if (expected) {
      ASSERT_EQ(formfieldExpect(world_, 1, &place), FORMFIELD_OK) << formfieldError(device_);
    }
    for (int i = 0; i < 1000 && (i < 20 || stats().pending_tiles > 0); ++i) {
      frame({10, 1, 10});
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    late[expected] = 0;
    for (int i = 0; i < 50; ++i) {  // the place is looked at between two of them
      frame({50, 1, 40});
      late[expected] = std::max(late[expected], stats().late_tiles);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    const std::vector<FormfieldPlace> many(FORMFIELD_MAX_OBSERVERS + 1);
    EXPECT_EQ(formfieldExpect(world_, FORMFIELD_MAX_OBSERVERS, many.data()), FORMFIELD_OK);
    EXPECT_EQ(formfieldExpect(world_, FORMFIELD_MAX_OBSERVERS + 1, many.data()), FORMFIELD_ERROR_USAGE);
    EXPECT_EQ(formfieldExpect(world_, 1, nullptr), FORMFIELD_ERROR_USAGE);
    for (const FormfieldPlace& none : {FormfieldPlace{{NAN, 0, 0}, 1}, FormfieldPlace{{0, 0, 0}, -1}}) EXPECT_EQ(formfieldExpect(world_, 1, &none), FORMFIELD_ERROR_USAGE);
    EXPECT_EQ(formfieldExpect(world_, 0, nullptr), FORMFIELD_OK);
    formfieldCloseWorld(std::exchange(world_, nullptr));
  }
  EXPECT_GT(late[0], 0u);
  EXPECT_EQ(late[1], 0u);
}

TEST_F(Formfield, BudgetsAFramesTiles) {
  settings_.max_applied_tiles = 1;
  open();
  frame({10, 1, 10});
  ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
  uint32_t waited = 0, applied = 0;
  for (int i = 0; i < 2000 && (i < 20 || stats().pending_tiles + stats().waiting_tiles > 0); ++i) {
    frame({50, 1, 40});
    EXPECT_LE(stats().applied_tiles, 1u);
    applied += stats().applied_tiles;
    waited += stats().waiting_tiles > 0;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));  // in which several come
  }
  EXPECT_GT(applied, 20u);
  EXPECT_GT(waited, 0u);
  EXPECT_EQ(stats().late_tiles, 0u);
}

TEST_F(Formfield, BudgetsTheBytesOfASecond) {
  settings_.read_bytes_per_second = 300000;  // less than any machine reads
  open();
  frame({10, 1, 10});
  ASSERT_EQ(formfieldSettle(world_, 1e-4f, 100), FORMFIELD_OK);
  for (int i = 0; i < 20000 && (i < 20 || stats().pending_tiles > 0); ++i) {
    frame({50, 1, 40});
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GT(stats().reads_held, 0u);
  EXPECT_EQ(stats().late_tiles, 0u);
}

TEST_F(Formfield, KeepsItsLastFramesAsFiguresAndAsATrace) {
  settings_.logged_frames = 8;
  open();
  for (int k = 0; k < 20; ++k) frame({30 + 0.5f * static_cast<float>(k), 1, 30});
  const FormfieldStats s = stats();
  EXPECT_GT(s.frame_ms_p50, 0);
  EXPECT_LE(s.frame_ms_p50, s.frame_ms_p99);
  EXPECT_LE(s.frame_ms_p99, s.frame_ms_max);
  const formats::TemporaryFolder folder;
  const std::string path = folder.file("trace.json");
  ASSERT_EQ(formfieldWriteTrace(world_, path.c_str()), FORMFIELD_OK) << formfieldError(device_);
  std::ifstream in(path);
  const auto trace = nlohmann::json::parse(in);
  int solver = 0, late = 0;
  double last = -1, longest = 0;
  for (const auto& event : trace.at("traceEvents")) {
    EXPECT_GE(event.at("ts").get<double>(), 0);
    if (event.at("name") == "tiles") late += event.at("args").contains("late");
    if (event.at("name") != "stream") {
      solver += event.at("name") == "solver";
      continue;
    }
    EXPECT_GT(event.at("ts").get<double>(), last);  // frame after frame
    last = event.at("ts");
    longest = std::max(longest, event.at("dur").get<double>());
  }
  EXPECT_EQ(solver, 8);
  EXPECT_EQ(late, 8);
  EXPECT_LE(longest, 1000 * s.frame_ms_max * 1.001);
  EXPECT_EQ(formfieldWriteTrace(world_, (path + "/no").c_str()), FORMFIELD_ERROR_IO);
  formfieldCloseWorld(world_);
  settings_.logged_frames = 0;
  ASSERT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &settings_, &world_), FORMFIELD_OK);
  frame({30, 1, 30});
  EXPECT_EQ(stats().frame_ms_max, 0);
  EXPECT_EQ(formfieldWriteTrace(world_, path.c_str()), FORMFIELD_ERROR_USAGE);
}

TEST_F(Formfield, ListsLampGroupsAndSwitchesThemAtEverySlot) {
  open();
  FormfieldWorldInfo info{};
  info.size = sizeof(info);
  ASSERT_EQ(formfieldGetWorldInfo(world_, &info), FORMFIELD_OK);
  ASSERT_EQ(info.lamp_groups, 3u);
  FormfieldLampGroup groups[3]{};
  ASSERT_EQ(formfieldLampGroups(world_, 0, 3, groups), FORMFIELD_OK);
  uint32_t found = 0;
  for (uint32_t g = 0; g < 3; ++g) {
    EXPECT_GT(groups[g].emission[1], 0);
    EXPECT_GT(groups[g].patches, 0u);
    ASSERT_EQ(formfieldFindLampGroup(world_, groups[g].name, &found), FORMFIELD_OK);
    EXPECT_EQ(found, g);
  }
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK);
  frame({30, 1, 30});
  uint32_t slots = 0;
  const auto light = [&] {
    const float* const b = formfieldRadiosity(world_, &slots);
    return std::vector<float>(b, b + 4 * size_t{slots});
  };
  const std::vector<float> on = light();
  const float dark[3] = {0, 0, 0}, whole[3] = {1, 1, 1};
  for (uint32_t g = 0; g < 3; ++g) ASSERT_EQ(formfieldSetEmission(world_, g, dark), FORMFIELD_OK);
  asked_ = 0;
  const MemoryCalls before = memoryCalls();
  frame({30, 1, 30});
  EXPECT_EQ(memoryCalls().allocated, before.allocated);
  EXPECT_EQ(asked_, 0);
  const std::vector<float> off = light();
  uint32_t tiles = 0, emitting = 0;
  const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
  for (uint32_t t = 0; t < tiles; ++t)
    for (uint32_t i = 0; i < tile[t].nodes; ++i) {
      const Vec3 m = test_.node(tile[t].level, tile[t].first_node + i).emission;
      const size_t at = 4 * size_t{tile[t].first_slot + i};
      emitting += m.x > 0;
      // What it emits is gone at once, at every level, and what it reflects of other lamps is less.
      ASSERT_LE(off[at], on[at] - m.x + 1e-4f * on[at]);
    }
  EXPECT_GT(emitting, 20u);
  for (uint32_t g = 0; g < 3; ++g) ASSERT_EQ(formfieldSetEmission(world_, g, whole), FORMFIELD_OK);
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK);
  const std::vector<float> again = light();
  for (uint32_t t = 0; t < tiles; ++t)
    for (uint32_t i = 0; i < 4 * tile[t].nodes; ++i) {
      const size_t at = 4 * size_t{tile[t].first_slot} + i;
      // Both stop when a change is below 1e-7 of the largest; albedo <= 0.9 leaves at most 9 such changes to come.
      ASSERT_NEAR(again[at], on[at], 2e-5f * (1 + on[at]));
    }
}

TEST_F(Formfield, RefusesLampsThatAreNoneAndScalesThatAreNoLight) {
  open();
  const float good[3] = {1, 1, 1}, negative[3] = {1, -0.5f, 1}, endless[3] = {1, 1, INFINITY}, none[3] = {NAN, 0, 0};
  uint32_t group = 0;
  FormfieldLampGroup listed;
  EXPECT_EQ(formfieldSetEmission(world_, 3, good), FORMFIELD_ERROR_USAGE);
  EXPECT_NE(std::string(formfieldError(device_)).find("is no lamp group"), std::string::npos);
  EXPECT_EQ(formfieldSetEmission(world_, 0, nullptr), FORMFIELD_ERROR_USAGE);
  for (const float* scale : {negative, endless, none}) EXPECT_EQ(formfieldSetEmission(world_, 0, scale), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldSetEmission(nullptr, 0, good), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldFindLampGroup(world_, "no such lamp", &group), FORMFIELD_ERROR_USAGE);
  EXPECT_NE(std::string(formfieldError(device_)).find("no such lamp"), std::string::npos);
  EXPECT_EQ(formfieldLampGroups(world_, 3, 1, &listed), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldLampGroups(world_, 3, 0, nullptr), FORMFIELD_OK);
  EXPECT_EQ(formfieldSetEmission(world_, 2, good), FORMFIELD_OK);
}

TEST_F(Formfield, TheMapOfSlotsNamesEveryPatchAndChangesWithTheCutAlone) {
  open();
  uint32_t none = 0;
  ASSERT_EQ(formfieldPatchSlots(world_, 7, 1, &none), FORMFIELD_OK);
  EXPECT_EQ(none, FORMFIELD_NO_SLOT);
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-3f, 10), FORMFIELD_OK);
  uint64_t change = 0, again = 0;
  formfieldTiles(world_, nullptr, &change);
  frame({30, 1, 30});
  formfieldTiles(world_, nullptr, &again);
  EXPECT_EQ(change, again);
  const std::vector<uint32_t> slots = patchSlots();
  uint32_t own = 0;
  for (uint32_t patch = 0; patch < slots.size(); ++patch) {
    uint32_t level = 99, ancestor = patch;
    uint64_t node = 0;
    ASSERT_EQ(formfieldSlotNode(world_, slots[patch], &level, &node), FORMFIELD_OK);
    for (uint32_t l = 0; l < level; ++l) ancestor = test_.world().parent(l, ancestor);
    ASSERT_EQ(node, ancestor);
    own += level == 0;
  }
  EXPECT_GT(own, 50u);
  EXPECT_LT(own, slots.size() / 2);
  frame({5, 1, 5});
  ASSERT_EQ(formfieldSettle(world_, 1e-3f, 10), FORMFIELD_OK);
  formfieldTiles(world_, nullptr, &again);
  EXPECT_NE(change, again);
  EXPECT_NE(slots, patchSlots());
}

TEST_F(Formfield, TheCutThatIsRecommendedBesideTheWorldHoldsWhereTheCallerLeavesTheDefaults) {
  const auto leaves = [&] {
    open();
    frame({30, 1, 30});
    EXPECT_EQ(formfieldSettle(world_, 1e-3f, 10), FORMFIELD_OK);
    const uint32_t fine = stats().level0_leaves;
    formfieldCloseWorld(world_);
    world_ = nullptr;
    return fine;
  };
  FormfieldWorldSettings defaults;
  formfieldDefaultWorldSettings(&defaults);
  const uint32_t at_8_m = leaves();
  settings_.radius_m = defaults.radius_m;
  const uint32_t at_default = leaves();
  ASSERT_LT(at_8_m, at_default);
  settings_.max_patches = 80;
  const uint32_t few = leaves();
  ASSERT_LT(few, at_8_m);
  settings_.max_patches = defaults.max_patches;

  const auto recommend = [&](const char* json) {
    std::ofstream(settingsPath(test_.world().path())) << json;
  };
  recommend(R"({"solver": "gather", "radius_m": 8})");
  EXPECT_EQ(leaves(), at_8_m);
  recommend(R"({"solver": "gather", "max_patches": 80})");
  EXPECT_EQ(leaves(), few);
  settings_.max_patches = 4000;  // the caller's own, which is room enough
  EXPECT_EQ(leaves(), at_default);
  recommend(R"({"solver": "gather", "radius_m": 8})");
  settings_.radius_m = 12.5f;
  const uint32_t own = leaves();
  recommend(R"({"solver": "gather"})");
  EXPECT_EQ(leaves(), own);
  recommend(R"({"solver": "gather", "radius_m": 8})");
  settings_.radius_m = defaults.radius_m;
  settings_.solver = FORMFIELD_SOLVER_GATHER;  // no more `auto`
  EXPECT_EQ(leaves(), at_default);
}

TEST_F(Formfield, DirectLightBySlotIsAsGoodAsByCallback) {
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK);
  uint32_t slots = 0, tiles = 0;
  const float* radiosity = formfieldRadiosity(world_, &slots);
  const std::vector<float> expected(radiosity, radiosity + size_t{4} * slots);
  ASSERT_EQ(formfieldSetDirectLight(world_, nullptr, nullptr), FORMFIELD_OK);
  frame({30, 1, 30});  // dark
  const FormfieldTile* const tile = formfieldTiles(world_, &tiles, nullptr);
  for (uint32_t t = 0; t < tiles; ++t) {
    std::vector<Vec3> light;
    for (uint32_t i = 0; i < tile[t].nodes; ++i) light.push_back(directLightOf(tile[t].level, tile[t].first_node + i));
    ASSERT_EQ(formfieldSetDirectIrradiance(world_, tile[t].first_slot, tile[t].nodes, &light[0].x), FORMFIELD_OK);
  }
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK);
  radiosity = formfieldRadiosity(world_, &slots);
  for (uint32_t t = 0; t < tiles; ++t)
    for (uint32_t i = 0; i < 4 * tile[t].nodes; ++i) {
      const size_t at = size_t{4} * tile[t].first_slot + i;
      ASSERT_NEAR(radiosity[at], expected[at], 2e-5f * (1 + expected[at]));
    }
}

class FormfieldWalk : public Formfield, public testing::WithParamInterface<FormfieldSolver> {};

TEST_P(FormfieldWalk, AllocatesAndFreesNothingOnTheCallersThread) {
  settings_.solver = GetParam();
  settings_.dense_places = 512;
  const uint32_t frames = GetParam() == FORMFIELD_SOLVER_GATHER ? 3000 : 600;
  settings_.memory_bytes = 600000;
  settings_.probes = 32;
  settings_.probe_rays = 32;
  open();
  std::mt19937_64 random(5);
  std::vector<uint32_t> slots(test_.world().levels()[0].nodes);
  Vec3 at{32, 1, 32}, step{0.3f, 0, 0.1f};
  uint64_t changes = 0, allocated = 0, freed = 0;
  formfieldPatchSlots(world_, 0, static_cast<uint32_t>(slots.size()), slots.data());  // reads the index of what it lists, once
  const MemoryCalls start = memoryCalls();
  // However slowly strips arrive: until enough have come and gone.
  const auto enough = [&] { return changes > frames / 30 && stats().strips_evicted > frames / 30; };
  for (uint32_t i = 0; i < frames || (i < 20 * frames && !enough()); ++i) {
    if (i % 40 == 0)
      step = {static_cast<float>(random() % 100) / 100 - 0.5f, 0, static_cast<float>(random() % 100) / 100 - 0.5f};
    if (i % 500 == 499) at = {static_cast<float>(random() % 64), 1, static_cast<float>(random() % 64)};
    at = ff::max(ff::min(at + step, {64, 1, 64}), {0, 1, 0});
    const MemoryCalls before = memoryCalls();
    frame(at);
    if (i % 50 == 0) formfieldLightChanged(world_);
    if (i % 30 == 0) formfieldSetSky(world_, &kBlueSky);
    if (i % 10 == 0) {
      const float point[6] = {at.x + 1, 2, at.z, at.x, 3, at.z - 1}, normal[6] = {0, 1, 0, 0.6f, 0, 0.8f};
      float irradiance[6];
      ASSERT_EQ(formfieldSample(world_, 2, point, normal, irradiance), FORMFIELD_OK) << formfieldError(device_);
      formfieldPatchSlots(world_, 0, static_cast<uint32_t>(slots.size()), slots.data());
    }
    changes += stats().cut_changed;
    const MemoryCalls after = memoryCalls();
    allocated += after.allocated - before.allocated;
    freed += after.freed - before.freed;
    if (i % 10 == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));  // so that there are arrivals
  }
  EXPECT_EQ(allocated, 0u);
  EXPECT_EQ(freed, 0u);
  EXPECT_EQ(memoryCalls().allocated - start.allocated, 0u);
  EXPECT_GT(changes, frames / 30);
  EXPECT_GT(stats().strips_evicted, frames / 30);
  EXPECT_GT(asked_, 100);
}

INSTANTIATE_TEST_SUITE_P(Solvers, FormfieldWalk, testing::Values(FORMFIELD_SOLVER_GATHER, FORMFIELD_SOLVER_MULTIBOUNCE),
                         [](const auto& each) { return each.param == FORMFIELD_SOLVER_GATHER ? "Gather" : "Multibounce"; });

// The same light by the dense matrix, in places too few for all leaves; and by the solver that settling picks.
TEST_F(Formfield, EverySolverSettlesOnTheSameLight) {
  std::vector<float> expected;
  for (const FormfieldSolver solver : {FORMFIELD_SOLVER_GATHER, FORMFIELD_SOLVER_MULTIBOUNCE, FORMFIELD_SOLVER_AUTO}) {
    settings_.solver = solver;
    settings_.dense_places = 512;
    open();
    frame({30, 1, 30});
    ASSERT_EQ(formfieldSettle(world_, 1e-7f, 1000), FORMFIELD_OK) << formfieldError(device_);
    frame({30, 1, 30});
    EXPECT_NE(std::string(formfieldSolverReason(world_)), "");
    EXPECT_EQ(stats().dense_nodes > 0, std::string(formfieldSolverName(world_)).find("multibounce") != std::string::npos);
    uint32_t slots = 0;
    const std::vector<uint32_t> map = patchSlots();
    const float* const radiosity = formfieldRadiosity(world_, &slots);
    if (expected.empty())
      for (const uint32_t slot : map) expected.push_back(radiosity[4 * slot]);
    for (size_t p = 0; p < map.size(); ++p)
      ASSERT_NEAR(radiosity[4 * map[p]], expected[p], 2e-5f * (1 + expected[p])) << formfieldSolverName(world_);
    formfieldCloseWorld(world_);
    world_ = nullptr;
  }
}

TEST_F(Formfield, SamplesFollowTheLight) {
  open();
  frame({30, 1, 30});
  ASSERT_EQ(formfieldSettle(world_, 1e-6f, 1000), FORMFIELD_OK);
  const float point[3] = {30, 3, 30}, down[3] = {0, -1, 0}, up[3] = {0, 1, 0};
  Vec3 below, above;
  ASSERT_EQ(formfieldSample(world_, 1, point, down, &below.x), FORMFIELD_OK) << formfieldError(device_);
  ASSERT_EQ(formfieldSample(world_, 1, point, up, &above.x), FORMFIELD_OK);
  // The world's patches lie on a plane that faces up: below is their light and, through its holes, the sky; above the
  // sky alone, whose closed form is pi (l0 + 2/3 l1.y).
  EXPECT_GT(below.x, 0.5f);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(above[c], 3.14159265f * (kBlueSky.radiance[c] + kBlueSky.gradient[c][1] * 2 / 3), 0.01f * above[c]);
  EXPECT_EQ(stats().probes_traced, 2u);
  ASSERT_EQ(formfieldSample(world_, 1, point, down, &below.x), FORMFIELD_OK);
  EXPECT_EQ(stats().probes_remembered, 1u);
}

TEST_F(Formfield, WhatIsWrongIsACodeAndALine) {
  const auto line = [&] { return std::string(formfieldError(device_)); };
  EXPECT_EQ(formfieldOpenWorld(device_, "/no/such/world.ffm", nullptr, &world_), FORMFIELD_ERROR_IO);
  EXPECT_NE(line().find("/no/such/world.ffm"), std::string::npos);
  EXPECT_EQ(world_, nullptr);
  EXPECT_EQ(formfieldOpenWorld(device_, nullptr, nullptr, &world_), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldOpenWorld(nullptr, "x", nullptr, &world_), FORMFIELD_ERROR_USAGE);
  EXPECT_NE(std::string(formfieldError(nullptr)), "");
  FormfieldWorldSettings wrong = settings_;
  wrong.size = 0;
  EXPECT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &wrong, &world_), FORMFIELD_ERROR_USAGE);
  wrong = settings_;
  wrong.radius_m = -1;
  EXPECT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &wrong, &world_), FORMFIELD_ERROR_USAGE);
  FormfieldDevice none = nullptr;
  EXPECT_EQ(formfieldCreateCpuDevice(-1, &none), FORMFIELD_ERROR_USAGE);
  open();
  const float point[3] = {1, 2, 3}, zero[3] = {0, 0, 0};
  float out[3];
  EXPECT_EQ(formfieldSample(world_, 1, point, zero, out), FORMFIELD_ERROR_USAGE);
  const float unit[3] = {0, 1, 0};
  EXPECT_EQ(formfieldSample(world_, 1, point, unit, out), FORMFIELD_ERROR_USAGE);  // before a frame
  EXPECT_EQ(formfieldSettle(world_, 1e-3f, 10), FORMFIELD_ERROR_USAGE);
  const double here[3] = {1, 2, 3};
  EXPECT_EQ(formfieldFrame(nullptr, here, zero), FORMFIELD_ERROR_USAGE);
  const double nowhere[3] = {std::nan(""), 0, 0};
  EXPECT_EQ(formfieldFrame(world_, nowhere, nullptr), FORMFIELD_ERROR_USAGE);
  uint32_t slot;
  EXPECT_EQ(formfieldPatchSlots(world_, 4000000000u, 500000000u, &slot), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldSlotNode(world_, 4000000000u, nullptr, nullptr), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(formfieldSetDirectIrradiance(world_, FORMFIELD_MAX_SLOTS - 9999, 10000, point), FORMFIELD_ERROR_USAGE);
  FormfieldStats small{};
  EXPECT_EQ(formfieldGetStats(world_, &small), FORMFIELD_ERROR_USAGE);
}

TEST_F(Formfield, AnOlderProgramsSmallerStructuresAreTakenAsTheyAre) {
  settings_.size = offsetof(FormfieldWorldSettings, probes);
  settings_.probes = 7;  // not known to it: the default holds
  settings_.probe_rays = 0;
  open();
  frame({30, 1, 30});
  FormfieldStats stats{};
  stats.size = offsetof(FormfieldStats, entries);
  stats.entries = 12345;
  ASSERT_EQ(formfieldGetStats(world_, &stats), FORMFIELD_OK);
  EXPECT_GT(stats.leaves, 0u);
  EXPECT_EQ(stats.entries, 12345u);
  EXPECT_EQ(stats.size, offsetof(FormfieldStats, entries));
}

}  // namespace
}  // namespace ff::runtime
