// A world behind a web server, through the C interface.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "runtime/api/formfield.h"
#include "tests/runtime/test_world.h"
#include "tests/support/web_server.h"

namespace ff::runtime {
namespace {

TEST(FormfieldRemoteWorld, IsLitAsTheOneOnTheDiskBySettingsThatLieBesideIt) {
  const TestWorld test({.side = 64, .tile_nodes = 40, .seed = 2});
  const std::string path = test.world().path();
  formats::WebServer server;
  for (const auto& entry : std::filesystem::directory_iterator(std::filesystem::path(path).parent_path())) {
    const auto bytes = formats::readFile(entry.path());
    server.files["/" + entry.path().filename().string()] = {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
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

}  // namespace
}  // namespace ff::runtime
