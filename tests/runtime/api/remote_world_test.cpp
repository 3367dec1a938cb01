// A world behind a web server, through the C interface.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "runtime/api/formfield.h"
#include "tests/runtime/test_world.h"
#include "tests/support/nginx.h"
#include "tests/support/web_server.h"

namespace ff::runtime {
namespace {

TEST(FormfieldRemoteWorld, IsLitAsTheOneOnTheDiskBySettingsThatLieBesideIt) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const std::string path = test.world().path();
  formats::WebServer server;
  server.addFolder(formats::folderOf(path));
  server.files["/world.settings.json"] = R"({"solver": "gather", "iterations": 2, "radius_m": 9})";
  ::setenv("FORMFIELD_CACHE", "off", 1);
  // Of the active nodes, ascending: which slot each has depends on the order in which tiles arrive.
  const auto light = [](const std::string& from, float radius_m) {
    FormfieldDevice device = nullptr;
    FormfieldWorld world = nullptr;
    FormfieldWorldSettings settings;
    formfieldDefaultWorldSettings(&settings);
    settings.radius_m = radius_m;
    const FormfieldSky sky{{1, 2, 3}, {}, {}};
    const double at[3] = {30, 1, 30};
    const float velocity[3] = {};
    std::vector<float> radiosity;
    EXPECT_EQ(formfieldCreateCpuDevice(2, &device), FORMFIELD_OK);
    EXPECT_EQ(formfieldOpenWorld(device, from.c_str(), &settings, &world), FORMFIELD_OK) << formfieldError(device);
    if (world) {
      EXPECT_EQ(formfieldSetSky(world, &sky), FORMFIELD_OK);
      EXPECT_EQ(formfieldFrame(world, at, velocity), FORMFIELD_OK) << formfieldError(device);
      EXPECT_EQ(formfieldSettle(world, 1e-6f, 1000), FORMFIELD_OK) << formfieldError(device);
      uint32_t slots = 0;
      const float* values = formfieldRadiosity(world, &slots);
      for (uint32_t s = 0; s < slots; ++s)
        if (values[4 * s] > 0) radiosity.push_back(values[4 * s]);
      std::ranges::sort(radiosity);
    }
    formfieldCloseWorld(world);
    formfieldDestroyDevice(device);
    return radiosity;
  };
  // The second has its radius from the settings on the server.
  const auto near = light(path, 9), far = light(server.address("/world.ffm"), 0), other = light(path, 0);
  ::unsetenv("FORMFIELD_CACHE");
  ASSERT_GT(near.size(), 100u);
  ASSERT_EQ(near.size(), far.size());
  EXPECT_NE(near.size(), other.size()) << "the settings matter";
  for (size_t i = 0; i < near.size(); ++i) EXPECT_NEAR(near[i], far[i], 1e-4f * near.back());  // a hundred times what settling leaves
}

TEST(FormfieldRemoteWorld, ABakeThatTakesItsPlaceOnTheServerIsTakenUp) {
  const formats::TemporaryFolder folder;
  const auto bake = [&](uint64_t seed, uint32_t side) {
    ASSERT_TRUE(formats::writeWorld(stream::makeSyntheticWorld({.side = side, .tile_nodes = 40, .seed = seed}), folder.file("world.ffm"), uint64_t{1} << 18));
  };
  bake(2, 64);
  const auto nginx = formats::Nginx::start(folder.path());
  if (!nginx) GTEST_SKIP();
  ::setenv("FORMFIELD_CACHE", "off", 1);
  FormfieldDevice device = nullptr;
  FormfieldWorldSettings settings;
  formfieldDefaultWorldSettings(&settings);
  settings.radius_m = 8;
  settings.hysteresis = 1;
  settings.solver = FORMFIELD_SOLVER_GATHER;
  settings.reload_seconds = 0.02f;
  ASSERT_EQ(formfieldCreateCpuDevice(2, &device), FORMFIELD_OK);
  const auto open = [&] {
    FormfieldWorld world = nullptr;
    EXPECT_EQ(formfieldOpenWorld(device, nginx->address("world.ffm").c_str(), &settings, &world), FORMFIELD_OK) << formfieldError(device);
    return world;
  };
  const auto statsOf = [](FormfieldWorld world) {
    FormfieldStats stats{};
    stats.size = sizeof stats;
    EXPECT_EQ(formfieldGetStats(world, &stats), FORMFIELD_OK);
    return stats;
  };
  const auto frame = [&](FormfieldWorld world) {
    const double at[3] = {30, 1, 30};
    const float velocity[3] = {};
    ASSERT_EQ(formfieldFrame(world, at, velocity), FORMFIELD_OK) << formfieldError(device);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  };
  const auto polls = [&](int status) { return std::ranges::count_if(nginx->served(1), [&](const auto& one) { return one.status == status && one.path == "/world.ffm"; }); };
  FormfieldWorld world = open();
  ASSERT_TRUE(world);
  for (int i = 0; i < 5000 && polls(304) < 5; ++i) frame(world);
  EXPECT_GE(polls(304), 5) << "looks at it that bring nothing";
  for (const auto& one : nginx->served(1))
    if (one.status == 304) {
      EXPECT_EQ(one.body_bytes, 0u);
    }
  EXPECT_EQ(statsOf(world).reloads, 0u);
  bake(3, 128);
  for (int i = 0; i < 5000 && statsOf(world).reloads == 0; ++i) frame(world);
  EXPECT_EQ(statsOf(world).reloads, 1u) << formfieldReloadFailure(world);
  EXPECT_EQ(statsOf(world).reload_failures, 0u) << formfieldReloadFailure(world);
  FormfieldWorld fresh = open();
  FormfieldWorldInfo info{}, expected{};
  info.size = expected.size = sizeof info;
  EXPECT_EQ(formfieldGetWorldInfo(world, &info), FORMFIELD_OK);
  EXPECT_EQ(formfieldGetWorldInfo(fresh, &expected), FORMFIELD_OK);
  EXPECT_EQ(info.patches, expected.patches);
  EXPECT_GT(info.patches, uint64_t{64} * 64) << "the larger one";
  for (FormfieldWorld each : {world, fresh}) {
    frame(each);
    EXPECT_EQ(formfieldSettle(each, 1e-6f, 1000), FORMFIELD_OK) << formfieldError(device);
  }
  EXPECT_EQ(statsOf(world).leaves, statsOf(fresh).leaves);
  EXPECT_EQ(statsOf(world).entries, statsOf(fresh).entries);
  formfieldCloseWorld(world);
  formfieldCloseWorld(fresh);
  formfieldDestroyDevice(device);
  ::unsetenv("FORMFIELD_CACHE");
}

// In a process of its own: the cache is chosen once in each.
TEST(FormfieldRemoteWorld, SaysThatWhatIsReadCannotBeKept) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const auto said = [] {
    const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
    const std::string path = test.world().path();
    formats::WebServer server;
    server.addFolder(formats::folderOf(path));
    ::setenv("FORMFIELD_CACHE", "/dev/null", 1);
    FormfieldDevice device = nullptr;
    FormfieldWorld world = nullptr, near = nullptr;
    if (formfieldCreateCpuDevice(1, &device) != FORMFIELD_OK || formfieldOpenWorld(device, server.address("/world.ffm").c_str(), nullptr, &world) != FORMFIELD_OK ||
        formfieldOpenWorld(device, path.c_str(), nullptr, &near) != FORMFIELD_OK)
      std::_Exit(1);
    const bool of_near = *formfieldStorageWarning(near);
    std::fprintf(stderr, "%s %s\n", of_near ? "both" : "one", formfieldStorageWarning(world));
    std::_Exit(0);
  };
  EXPECT_EXIT(said(), testing::ExitedWithCode(0), "^one /dev/null: .*name another folder in FORMFIELD_CACHE, or \"off\"");
  EXPECT_STREQ(formfieldStorageWarning(nullptr), "");
}

}  // namespace
}  // namespace ff::runtime
