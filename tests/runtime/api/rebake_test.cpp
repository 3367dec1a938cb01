// A scene is edited and baked again while frames of the world before go on.
#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "bake/bake.h"
#include "runtime/api/formfield_handles.h"
#include "tests/runtime/lit_state.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/town_scene.h"

namespace ff::runtime {
namespace {

TEST(Rebake, OfAnEditedSceneIsShownWithoutARestart) {
  const formats::TemporaryFolder folder;
  const std::string path = folder.file("town.ffm");
  bake::Scene scene = bake::test::townScene(folder, 4000);
  bake::BakeSettings settings{.cell_m = 1, .rays = 64};
  ASSERT_TRUE(bake::bakeWorld(scene, settings, path));
  FormfieldDevice device = nullptr;
  FormfieldWorld world = nullptr;
  ASSERT_EQ(formfieldCreateCpuDevice(2, &device), FORMFIELD_OK);
  FormfieldWorldSettings open;
  formfieldDefaultWorldSettings(&open);
  open.solver = FORMFIELD_SOLVER_GATHER;
  open.reload_seconds = 0.02f;
  open.radius_m = 10;
  open.hysteresis = 1;  // the way leaves no trace in the cut
  const FormfieldSky sky{{1, 2, 3}, {}, {}};
  Box all;
  for (const Vec3 p : scene.positions) all.add(p);
  const Vec3 middle = (all.lo + all.hi) * 0.5f;
  const auto show = [&](FormfieldWorld of, float dx, float speed) {
    const double at[3] = {static_cast<double>(middle.x + dx), 2, static_cast<double>(middle.z)};
    const float velocity[3] = {speed, 0, 0};
    ASSERT_EQ(formfieldFrame(of, at, velocity), FORMFIELD_OK) << formfieldError(device);
  };
  const auto stateAtRest = [&](FormfieldWorld of) {
    show(of, 0, 0);
    EXPECT_EQ(formfieldSettle(of, 1e-6f, 1000), FORMFIELD_OK) << formfieldError(device);
    return stateOf(of->updater(), *of->solver.solver);
  };
  const auto reloads = [&] {
    FormfieldStats stats{};
    stats.size = sizeof(stats);
    EXPECT_EQ(formfieldGetStats(world, &stats), FORMFIELD_OK);
    EXPECT_EQ(stats.reload_failures, 0u) << formfieldReloadFailure(world);
    return stats.reloads;
  };
  ASSERT_EQ(formfieldOpenWorld(device, path.c_str(), &open, &world), FORMFIELD_OK) << formfieldError(device);
  ASSERT_EQ(formfieldSetSky(world, &sky), FORMFIELD_OK);
  LitState before = stateAtRest(world);
  for (const float cell_m : {1.0f, 0.8f}) {  // a new house; then patches of another size
    settings.cell_m = cell_m;
    if (cell_m == 1) bake::test::addBlock(scene, middle + Vec3{2, -2, 2}, middle + Vec3{6, 9, 6}, scene.triangles[0].material, false);
    const uint32_t done = reloads();
    std::atomic<bool> baked{false};
    std::thread baker([&] { baked = bake::bakeWorld(scene, settings, path).has_value(); });
    float dx = 0;
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (reloads() == done && std::chrono::steady_clock::now() < until) {
      dx = dx > 8 ? -8 : dx + 0.05f;
      show(world, dx, 3);
      uint32_t slots = 0;
      const float* const light = formfieldRadiosity(world, &slots);
      for (const uint32_t slot : world->updater().matrix().leaves) ASSERT_TRUE(slot < slots && std::isfinite(light[4 * slot]) && light[4 * slot] >= 0);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    baker.join();
    ASSERT_TRUE(baked);
    ASSERT_EQ(reloads(), done + 1) << formfieldReloadFailure(world);
    const LitState now = stateAtRest(world);
    FormfieldWorld fresh = nullptr;
    ASSERT_EQ(formfieldOpenWorld(device, path.c_str(), &open, &fresh), FORMFIELD_OK) << formfieldError(device);
    ASSERT_EQ(formfieldSetSky(fresh, &sky), FORMFIELD_OK);
    EXPECT_TRUE(now == stateAtRest(fresh));
    EXPECT_FALSE(now == before) << "the edit is seen";
    before = now;
    formfieldCloseWorld(fresh);
  }
  formfieldCloseWorld(world);
  formfieldDestroyDevice(device);
}

}  // namespace
}  // namespace ff::runtime
