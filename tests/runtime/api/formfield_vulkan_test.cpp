#include "runtime/api/formfield_vulkan.h"

#include <chrono>
#include <cmath>
#include <fstream>
#include <thread>

#include "runtime/api/formfield_handles.h"
#include "runtime/choose_solver.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "tests/runtime/test_world.h"

namespace ff::runtime {
namespace {

class FormfieldVulkan : public testing::Test {
 protected:
  FormfieldVulkan() : test_({.side = 32, .tile_nodes = 24, .seed = 2}) {
    settings_.size = sizeof(settings_);
    settings_.device_name = "cpu";
    settings_.validate = 1;
  }
  // Skips the test where there is no driver or no validation layer.
  void make() {
    if (formfieldCreateVulkanDevice(&settings_, &device_) != FORMFIELD_OK) GTEST_SKIP() << formfieldError(nullptr);
  }
  std::vector<float> lightAt(FormfieldDevice device, FormfieldSolver solver, FormfieldStats* stats = nullptr) {
    FormfieldWorldSettings settings;
    formfieldDefaultWorldSettings(&settings);
    settings.radius_m = 8;
    settings.solver = solver;
    settings.dense_places = 256;
    settings.probes = 16;
    FormfieldWorld world = nullptr;
    EXPECT_EQ(formfieldOpenWorld(device, test_.world().path().c_str(), &settings, &world), FORMFIELD_OK)
        << formfieldError(device);
    if (!world) return {};
    const FormfieldSky sky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}, {}};
    const double at[3] = {16, 1, 16};
    const float above[3] = {16, 3, 16}, down[3] = {0, -1, 0};
    EXPECT_EQ(formfieldSetSky(world, &sky), FORMFIELD_OK);
    for (uint32_t g = 0; g < 2; ++g) EXPECT_EQ(formfieldSetEmission(world, g, kScales[g]), FORMFIELD_OK);
    for (int i = 0; i < 3; ++i) EXPECT_EQ(formfieldFrame(world, at, nullptr), FORMFIELD_OK) << formfieldError(device);
    EXPECT_EQ(formfieldSettle(world, 1e-6f, 300), FORMFIELD_OK) << formfieldError(device);
    uint32_t slots = 0;
    std::vector<uint32_t> map(test_.world().levels()[0].nodes);
    EXPECT_EQ(formfieldPatchSlots(world, 0, static_cast<uint32_t>(map.size()), map.data()), FORMFIELD_OK);
    const float* const radiosity = formfieldRadiosity(world, &slots);
    std::vector<float> light;
    for (const uint32_t slot : map) light.insert(light.end(), radiosity + 4 * slot, radiosity + 4 * slot + 3);
    light.resize(light.size() + 3);
    EXPECT_EQ(formfieldSample(world, 1, above, down, &light[light.size() - 3]), FORMFIELD_OK);
    if (stats) {
      stats->size = sizeof(*stats);
      EXPECT_EQ(formfieldGetStats(world, stats), FORMFIELD_OK);
      EXPECT_EQ(stats->fallbacks == 1, *formfieldFallbackReason(world) != '\0');
    }
    formfieldCloseWorld(world);
    return light;
  }
  static FormfieldStats statsOf(FormfieldWorld world) {
    FormfieldStats stats{};
    stats.size = sizeof(stats);
    EXPECT_EQ(formfieldGetStats(world, &stats), FORMFIELD_OK);
    return stats;
  }
  // A world whose solver takes no command buffers, and says why.
  void expectDoesNotRecord(FormfieldDevice device, FormfieldWorld world, const char* why) {
    EXPECT_EQ(formfieldRecord(world, nullptr, kAt, nullptr), FORMFIELD_ERROR_UNSUPPORTED);
    EXPECT_NE(std::string(formfieldError(device)).find(why), std::string::npos) << formfieldError(device);
  }
  void open(FormfieldDevice device, FormfieldSolver solver, uint32_t places, FormfieldWorld* world) {
    FormfieldWorldSettings settings;
    formfieldDefaultWorldSettings(&settings);
    settings.solver = solver;
    settings.dense_places = places;
    ASSERT_EQ(formfieldOpenWorld(device, test_.world().path().c_str(), &settings, world), FORMFIELD_OK)
        << formfieldError(device);
  }
  void expectNear(const std::vector<float>& got, const std::vector<float>& expected) {
    ASSERT_EQ(got.size(), expected.size());
    // Both are settled to 1e-6 of the largest radiosity; sums are in fp32, in different orders.
    for (size_t i = 0; i < got.size(); ++i) ASSERT_NEAR(got[i], expected[i], 1e-4f * (1 + expected[i]));
  }
  ~FormfieldVulkan() override {
    if (device_) {
      const char* last = nullptr;
      EXPECT_EQ(formfieldValidationMessages(device_, &last), 0u) << last;
    }
    formfieldDestroyDevice(device_);
  }

  static constexpr double kAt[3] = {16, 1, 16};
  static constexpr float kScales[2][3] = {{0, 0, 0}, {0.5f, 1, 2}};  // of two lamp groups; the third is as baked
  TestWorld test_;
  FormfieldVulkanSettings settings_{};
  FormfieldDevice device_ = nullptr;
};

TEST_F(FormfieldVulkan, GivesTheLightOfTheCpu) {
  make();
  if (IsSkipped()) return;
  FormfieldDevice cpu = nullptr;
  ASSERT_EQ(formfieldCreateCpuDevice(1, &cpu), FORMFIELD_OK);
  const std::vector<float> expected = lightAt(cpu, FORMFIELD_SOLVER_GATHER);
  formfieldDestroyDevice(cpu);
  for (const FormfieldSolver solver : {FORMFIELD_SOLVER_AUTO, FORMFIELD_SOLVER_MULTIBOUNCE}) {
    FormfieldStats stats{};
    expectNear(lightAt(device_, solver, &stats), expected);
    EXPECT_EQ(stats.fallbacks, 0u);
  }
}

TEST_F(FormfieldVulkan, TakesASmallerOlderStructureAndRefusesALargerOne) {
  FormfieldVulkanSettings s{};
  s.size = offsetof(FormfieldVulkanSettings, validate);
  s.device_name = "cpu";
  s.frames_in_flight = 99;  // past the older structure's end
  const FormfieldResult made = formfieldCreateVulkanDevice(&s, &device_);
  if (made != FORMFIELD_OK && made != FORMFIELD_ERROR_USAGE) GTEST_SKIP() << formfieldError(nullptr);
  ASSERT_EQ(made, FORMFIELD_OK) << formfieldError(nullptr);
  FormfieldDevice none = nullptr;
  s.size = sizeof(s) + 8;
  EXPECT_EQ(formfieldCreateVulkanDevice(&s, &none), FORMFIELD_ERROR_USAGE);
  EXPECT_EQ(none, nullptr);
}

class FormfieldVulkanRecords : public FormfieldVulkan, public testing::WithParamInterface<FormfieldSolver> {};
INSTANTIATE_TEST_SUITE_P(Solvers, FormfieldVulkanRecords,
                         testing::Values(FORMFIELD_SOLVER_GATHER, FORMFIELD_SOLVER_MULTIBOUNCE), [](const auto& each) {
                           return each.param == FORMFIELD_SOLVER_GATHER ? "Gather" : "Multibounce";
                         });

// An engine's loop: its own device, a command buffer a frame, two in flight.
TEST_P(FormfieldVulkanRecords, IntoTheCallersCommandBuffersOnTheCallersDevice) {
  const auto engine = VkContext::open({.device = "cpu", .validate = true});
  if (!engine) GTEST_SKIP() << engine.error().line();
  const VkDevice device = (*engine)->device();
  FormfieldDevice cpu = nullptr;
  ASSERT_EQ(formfieldCreateCpuDevice(1, &cpu), FORMFIELD_OK);
  const std::vector<float> expected = lightAt(cpu, FORMFIELD_SOLVER_GATHER);
  formfieldDestroyDevice(cpu);

  FormfieldVulkanSettings s{};
  s.size = sizeof(s);
  s.instance = (*engine)->instance();
  s.physical_device = (*engine)->physicalDevice();
  s.device = device;
  s.queue_family = (*engine)->queueFamily();
  vkGetDeviceQueue(device, s.queue_family, 0, &s.queue);
  ASSERT_EQ(formfieldCreateVulkanDevice(&s, &device_), FORMFIELD_OK) << formfieldError(nullptr);
  auto pool_info = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
  pool_info.queueFamilyIndex = s.queue_family;
  VkCommandPool pool = VK_NULL_HANDLE;
  ASSERT_EQ(vkCreateCommandPool(device, &pool_info, nullptr, &pool), VK_SUCCESS);
  auto buffers_info = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  buffers_info.commandPool = pool;
  buffers_info.commandBufferCount = 2;
  VkCommandBuffer commands[2];
  ASSERT_EQ(vkAllocateCommandBuffers(device, &buffers_info, commands), VK_SUCCESS);
  const auto fence_info = zeroed<VkFenceCreateInfo>(VK_STRUCTURE_TYPE_FENCE_CREATE_INFO);
  VkFence fences[2];
  for (VkFence& fence : fences) ASSERT_EQ(vkCreateFence(device, &fence_info, nullptr, &fence), VK_SUCCESS);

  FormfieldWorldSettings settings;
  formfieldDefaultWorldSettings(&settings);
  settings.radius_m = 8;
  settings.hysteresis = 1;  // the way here leaves no trace in the cut
  settings.solver = GetParam();
  settings.dense_places = 256;
  settings.probes = 16;
  FormfieldWorld world = nullptr;
  ASSERT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), &settings, &world), FORMFIELD_OK);
  const VkBuffer buffer = formfieldRadiosityBuffer(world);
  EXPECT_TRUE(buffer != VK_NULL_HANDLE && formfieldSourceBuffer(world) != VK_NULL_HANDLE);
  const FormfieldSky sky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}, {}};
  ASSERT_EQ(formfieldSetSky(world, &sky), FORMFIELD_OK);

  const auto meanLight = [&] {
    std::vector<uint32_t> slot_of(test_.world().levels()[0].nodes);
    EXPECT_EQ(formfieldPatchSlots(world, 0, static_cast<uint32_t>(slot_of.size()), slot_of.data()), FORMFIELD_OK);
    const float* const light = formfieldRadiosity(world, nullptr);
    double sum = 0;
    for (const uint32_t slot : slot_of) sum += static_cast<double>(light[4 * slot] + light[4 * slot + 1] + light[4 * slot + 2]);
    return sum / static_cast<double>(slot_of.size());
  };

  constexpr int kFrames = 1300, kSwitch = 30, kAnew = 40, kReload = 80;  // from the latter on slots are given out anew, when what was being put together is done
  double before = 0;
  bool anew = false;
  uint64_t entered_nodes = 0, started = 0;
  for (int frame = 0; frame < kFrames; ++frame) {
    const int ring = frame % 2;
    if (frame >= 2) {
      ASSERT_EQ(vkWaitForFences(device, 1, &fences[ring], VK_TRUE, UINT64_MAX), VK_SUCCESS);
      ASSERT_EQ(vkResetFences(device, 1, &fences[ring]), VK_SUCCESS);
    }
    auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    ASSERT_EQ(vkBeginCommandBuffer(commands[ring], &begin), VK_SUCCESS);
    for (uint32_t g = 0; frame == kSwitch && g < 2; ++g)  // a switch in mid-flight
      ASSERT_EQ(formfieldSetEmission(world, g, kScales[g]), FORMFIELD_OK);
    // In from afar, once to and fro, then still: cuts change while frames are in flight.
    const double aside = 0.1 * std::max(0, 60 - std::abs(frame - 160));
    const double at[3] = {std::max(16.0, 28 - 0.2 * frame) + aside, 1, 16};
    if (frame == kReload) {  // a re-bake, of the same bytes, with frames in flight
      before = meanLight();
      ASSERT_EQ(formfieldReload(world), FORMFIELD_OK);
      for (int i = 0; i < 5000 && !world->reloader->ready(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      ASSERT_TRUE(world->reloader->ready()) << formfieldReloadFailure(world);
    }
    if (frame == kAnew) {
      before = meanLight();
      world->updater().renumberNext();
    }
    if (frame > kAnew && frame <= kAnew + 2) world->updater().awaitBuild();
    const uint64_t submissions = device_->submissions();
    const uint32_t reloads = world->reloads;
    const uint64_t uploaded = statsOf(world).uploaded_light_bytes;
    ASSERT_EQ(formfieldRecord(world, commands[ring], at, nullptr), FORMFIELD_OK) << formfieldError(device_);
    EXPECT_EQ(device_->submissions(), submissions) << "frame " << frame << " has waited for the device";
    const uint64_t light_bytes = statsOf(world).uploaded_light_bytes - uploaded;
    const uint64_t all_slots = world->updater().matrix().slots();
    const bool cut_changed = world->frame_stats.matrix_changed, given_anew = cut_changed && world->updater().change().renumbered;
    if (cut_changed && !given_anew) {
      EXPECT_NE(world->updater().change().packed, nullptr) << "frame " << frame << " packs rows itself";
    }
    if (frame == 0 || frame == kSwitch) {
      EXPECT_GE(light_bytes, all_slots * sizeof(Vec4)) << "frame " << frame;
    } else if (!given_anew && world->reloads == reloads) {  // sources and emission of what entered, and which tiles fade
      uint64_t nodes = 0;
      for (size_t i = 0; cut_changed && i < world->updater().change().entered.size(); ++i) nodes += world->updater().matrix().tiles[world->updater().change().entered[i]].nodes;
      EXPECT_LE(light_bytes, 2 * nodes * sizeof(Vec4) + world->updater().matrix().tiles.size() * sizeof(shaders::FadingSlots)) << "frame " << frame;
      entered_nodes += nodes;
    }
    if (frame > 0 && cut_changed && !given_anew && world->reloads == reloads) {
      const LocalMatrix& m = world->updater().matrix();
      std::vector<Vec4> seen(m.slots());
      world->solver.recording->lastSeen(seen);
      for (const uint32_t t : world->updater().change().entered)
        for (uint32_t i = 0, slot = m.tiles[t].first_slot; i < m.tiles[t].nodes; ++i, ++slot) {
          const uint32_t parent = m.parent_slot[slot];
          if (parent == kNoSlot) continue;
          const Vec4 start = onAlbedo(seen[parent], m.albedo[parent], m.albedo[slot], seen[parent]);
          ASSERT_NEAR(seen[slot].y, start.y, 1e-5f * (1 + start.y)) << "frame " << frame << ": a node that enters starts from its parent";
          started += start.y > 0;
        }
    }
    anew = anew || (frame >= kAnew && frame <= kAnew + 2 && world->updater().change().renumbered);
    EXPECT_TRUE(frame != kAnew + 2 || anew);
    EXPECT_EQ(world->reloads, frame < kReload ? 0u : 1u);
    if ((frame >= kAnew && frame < kAnew + 6) || (frame >= kReload && frame < kReload + 6)) {
      EXPECT_NEAR(meanLight(), before, 0.1 * before) << "frame " << frame;
    }
    ASSERT_EQ(vkEndCommandBuffer(commands[ring]), VK_SUCCESS);
    auto submit = zeroed<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
    submit.commandBufferCount = 1;
    submit.pCommandBuffers = &commands[ring];
    ASSERT_EQ(vkQueueSubmit(s.queue, 1, &submit, fences[ring]), VK_SUCCESS);
    uint32_t slots = 0;
    const float* const lagging = formfieldRadiosity(world, &slots);
    for (uint32_t i = 0; i < 4 * slots; ++i) ASSERT_LT(std::abs(lagging[i]), 1000.0f);  // no garbage in new slots
  }
  ASSERT_EQ(vkDeviceWaitIdle(device), VK_SUCCESS);
  EXPECT_GT(entered_nodes, 0u);
  EXPECT_GT(started, 0u);
  EXPECT_EQ(formfieldRadiosityBuffer(world), buffer);
  // The device's own buffer holds the same, emission included.
  uint32_t used = 0, tiles = 0;
  const float* const brought_back = formfieldRadiosity(world, &used);
  const auto copied = Buffer::create(**engine, used * sizeof(Vec4), 0, MemoryUse::kHost);
  ASSERT_TRUE(copied);
  const VkBufferCopy copy{0, 0, used * sizeof(Vec4)};
  ASSERT_TRUE((*engine)->run([&](VkCommandBuffer c) { vkCmdCopyBuffer(c, buffer, copied->handle(), 1, &copy); }));
  const auto* const on_device = reinterpret_cast<const float*>(copied->mapped());
  const FormfieldTile* const tile = formfieldTiles(world, &tiles, nullptr);
  for (uint32_t t = 0; t < tiles; ++t)
    for (uint32_t i = 4 * tile[t].first_slot; i < 4 * (tile[t].first_slot + tile[t].nodes); ++i)  // w is 0 on both sides
      ASSERT_NEAR(on_device[i], brought_back[i], 1e-3f * (1 + on_device[i]));

  // What the last frames brought back is the settled light. (160 iterations at an albedo of at most 0.9.)
  uint32_t slots = 0;
  std::vector<uint32_t> map(test_.world().levels()[0].nodes);
  ASSERT_EQ(formfieldPatchSlots(world, 0, static_cast<uint32_t>(map.size()), map.data()), FORMFIELD_OK);
  const float* const radiosity = formfieldRadiosity(world, &slots);
  for (size_t p = 0; p < map.size(); ++p)
    for (size_t c = 0; c < 3; ++c)
      ASSERT_NEAR(radiosity[4 * map[p] + c], expected[3 * p + c], 1e-3f * (1 + expected[3 * p + c]));
  FormfieldStats stats{};
  stats.size = sizeof(stats);
  ASSERT_EQ(formfieldGetStats(world, &stats), FORMFIELD_OK);
  if (GetParam() == FORMFIELD_SOLVER_GATHER) {
    EXPECT_LT(stats.residual, 0);
  } else {
    EXPECT_EQ(stats.dense_nodes, std::min(256u, stats.leaves));
    EXPECT_EQ(stats.dense_nodes + stats.dense_waiting, stats.leaves);
    EXPECT_EQ(stats.dense_rebuilds + stats.dense_refused, 0u);
    EXPECT_GE(stats.residual, 0);
    EXPECT_LE(stats.residual, 1e-5);
  }
  const float above[3] = {16, 3, 16}, down[3] = {0, -1, 0};
  float irradiance[3];
  ASSERT_EQ(formfieldSample(world, 1, above, down, irradiance), FORMFIELD_OK);
  EXPECT_NEAR(irradiance[1], expected[expected.size() - 2], 1e-3f * irradiance[1]);

  formfieldCloseWorld(world);
  for (const VkFence fence : fences) vkDestroyFence(device, fence, nullptr);
  vkDestroyCommandPool(device, pool, nullptr);
  formfieldDestroyDevice(device_);
  device_ = nullptr;
  for (const std::string& message : (*engine)->messages()) ADD_FAILURE() << message;
}

TEST_F(FormfieldVulkan, TheSeedDoesNotRecordAndSaysSo) {
  make();
  if (IsSkipped()) return;
  FormfieldWorld world = nullptr;
  ASSERT_NO_FATAL_FAILURE(open(device_, FORMFIELD_SOLVER_SEED, 64, &world));
  expectDoesNotRecord(device_, world, "seed is a baseline");
  EXPECT_EQ(formfieldRadiosityBuffer(world), VkBuffer{VK_NULL_HANDLE});
  formfieldCloseWorld(world);
}

TEST_F(FormfieldVulkan, AutoTakesARecommendedSolverThatRecordsAndFits) {
  make();
  if (IsSkipped()) return;
  const struct {
    const char* json;
    const char* name;
    const char* why;
  } cases[] = {
      {R"({"solver": "multibounce", "storage": "fp16", "places": 128})", "multibounce vulkan fp16", "recommended"},
      {R"({"solver": "multibounce", "luminance": true, "places": 128})", "fp32 luminance", "recommended"},
      {R"({"solver": "multibounce", "places": 65536})", "vulkan: ", "gather: multibounce vulkan"},
      {R"({"solver": "seed"})", "vulkan: ", "can record"}};
  for (const auto& each : cases) {
    std::ofstream(settingsPath(test_.world().path())) << each.json;
    FormfieldWorld world = nullptr;
    ASSERT_EQ(formfieldOpenWorld(device_, test_.world().path().c_str(), nullptr, &world), FORMFIELD_OK)
        << formfieldError(device_);
    EXPECT_NE(std::string(formfieldSolverName(world)).find(each.name), std::string::npos) << formfieldSolverName(world);
    EXPECT_NE(std::string(formfieldSolverReason(world)).find(each.why), std::string::npos)
        << formfieldSolverReason(world);
    EXPECT_TRUE(formfieldRadiosityBuffer(world) != VK_NULL_HANDLE) << each.json;
    formfieldCloseWorld(world);
  }
}

TEST_F(FormfieldVulkan, AFullDeviceHandsOverToTheCpuAndSaysSo) {
  make();
  if (IsSkipped()) return;
  const std::vector<float> expected = lightAt(device_, FORMFIELD_SOLVER_GATHER);
  // Not enough for either; enough for gather, and not for a matrix of 256 places.
  constexpr uint64_t kForGather = 4000000;
  FormfieldVulkanSettings enough = settings_;
  enough.memory_bytes = kForGather;
  FormfieldDevice fits = nullptr;
  ASSERT_EQ(formfieldCreateVulkanDevice(&enough, &fits), FORMFIELD_OK) << formfieldError(nullptr);
  FormfieldStats none{};
  expectNear(lightAt(fits, FORMFIELD_SOLVER_GATHER, &none), expected);
  EXPECT_EQ(none.fallbacks, 0u);
  formfieldDestroyDevice(fits);
  for (const auto& [bytes, solver] :
       {std::pair(uint64_t{100000}, FORMFIELD_SOLVER_GATHER), std::pair(uint64_t{100000}, FORMFIELD_SOLVER_MULTIBOUNCE),
        std::pair(kForGather, FORMFIELD_SOLVER_MULTIBOUNCE)}) {
    FormfieldVulkanSettings small = settings_;
    small.memory_bytes = bytes;
    FormfieldDevice full = nullptr;
    ASSERT_EQ(formfieldCreateVulkanDevice(&small, &full), FORMFIELD_OK) << formfieldError(nullptr);
    FormfieldStats stats{};
    expectNear(lightAt(full, solver, &stats), expected);
    EXPECT_EQ(stats.fallbacks, 1u);
    FormfieldWorld world = nullptr;
    ASSERT_NO_FATAL_FAILURE(open(full, solver, 256, &world));
    expectDoesNotRecord(full, world, "the CPU has taken over");
    EXPECT_EQ(formfieldFrame(world, kAt, nullptr), FORMFIELD_OK) << formfieldError(full);
    formfieldCloseWorld(world);
    formfieldDestroyDevice(full);
  }
}

// What a recorder has room for is that of the world that it was made for; more is the CPU's from then on.
TEST_F(FormfieldVulkan, AReBakeThatOutgrowsTheRecorderHandsOverToTheCpu) {
  const auto engine = VkContext::open({.device = "cpu", .validate = true});
  if (!engine) GTEST_SKIP() << engine.error().line();
  FormfieldVulkanSettings s{};
  s.size = sizeof(s);
  s.instance = (*engine)->instance();
  s.physical_device = (*engine)->physicalDevice();
  s.device = (*engine)->device();
  s.queue_family = (*engine)->queueFamily();
  vkGetDeviceQueue(s.device, s.queue_family, 0, &s.queue);
  ASSERT_EQ(formfieldCreateVulkanDevice(&s, &device_), FORMFIELD_OK) << formfieldError(nullptr);
  auto pool_info = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.queueFamilyIndex = s.queue_family;
  VkCommandPool pool = VK_NULL_HANDLE;
  ASSERT_EQ(vkCreateCommandPool(s.device, &pool_info, nullptr, &pool), VK_SUCCESS);
  auto buffer_info = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  buffer_info.commandPool = pool;
  buffer_info.commandBufferCount = 1;
  VkCommandBuffer commands = VK_NULL_HANDLE;
  ASSERT_EQ(vkAllocateCommandBuffers(s.device, &buffer_info, &commands), VK_SUCCESS);
  const auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
  ASSERT_EQ(vkBeginCommandBuffer(commands, &begin), VK_SUCCESS);
  const formats::TemporaryFolder folder;
  const auto bake = [&](uint32_t side) { return formats::writeWorld(stream::makeSyntheticWorld({.side = side, .tile_nodes = 40}), folder.file("w.ffm"), 1 << 20); };
  ASSERT_TRUE(bake(16));
  FormfieldWorldSettings settings;
  formfieldDefaultWorldSettings(&settings);
  settings.radius_m = 40;
  settings.solver = FORMFIELD_SOLVER_GATHER;
  FormfieldWorld world = nullptr;
  ASSERT_EQ(formfieldOpenWorld(device_, folder.file("w.ffm").c_str(), &settings, &world), FORMFIELD_OK) << formfieldError(device_);
  EXPECT_EQ(formfieldRecord(world, commands, kAt, nullptr), FORMFIELD_OK) << formfieldError(device_);
  ASSERT_STREQ(formfieldFallbackReason(world), "");
  const uint32_t slots = world->updater().matrix().slots();
  ASSERT_TRUE(bake(128));
  ASSERT_EQ(formfieldReload(world), FORMFIELD_OK);
  for (int i = 0; i < 5000 && !world->reloader->ready(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  ASSERT_TRUE(world->reloader->ready()) << formfieldReloadFailure(world);
  EXPECT_EQ(formfieldRecord(world, commands, kAt, nullptr), FORMFIELD_ERROR_UNSUPPORTED) << "the CPU has taken over";
  EXPECT_GT(world->updater().matrix().slots(), 4 * slots);
  EXPECT_EQ(statsOf(world).fallbacks, 1u);
  EXPECT_EQ(formfieldFrame(world, kAt, nullptr), FORMFIELD_OK) << formfieldError(device_);
  EXPECT_EQ(vkEndCommandBuffer(commands), VK_SUCCESS);
  formfieldCloseWorld(world);
  vkDestroyCommandPool(s.device, pool, nullptr);
  formfieldDestroyDevice(device_);  // before the engine's
  device_ = nullptr;
  for (const std::string& message : (*engine)->messages()) ADD_FAILURE() << message;
}

TEST_F(FormfieldVulkan, RefusesHalfADevice) {
  FormfieldVulkanSettings half = settings_;
  half.queue_family = 0;
  half.device = reinterpret_cast<VkDevice>(uintptr_t{1});
  FormfieldDevice none = nullptr;
  EXPECT_EQ(formfieldCreateVulkanDevice(&half, &none), FORMFIELD_ERROR_USAGE);
  EXPECT_NE(std::string(formfieldError(nullptr)).find("all four"), std::string::npos);
}

}  // namespace
}  // namespace ff::runtime
