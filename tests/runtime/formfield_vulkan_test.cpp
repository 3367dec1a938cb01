#include "runtime/formfield_vulkan.h"

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
    const FormfieldSky sky{{1, 2, 3}, {{0.5f, 0.1f, 0}, {0, 1, 0}, {0.2f, 0, 0.4f}}};
    const float at[3] = {16, 1, 16}, above[3] = {16, 3, 16}, down[3] = {0, -1, 0};
    EXPECT_EQ(formfieldSetSky(world, &sky), FORMFIELD_OK);
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
  for (const FormfieldSolver solver : {FORMFIELD_SOLVER_GATHER, FORMFIELD_SOLVER_MULTIBOUNCE}) {
    FormfieldStats stats{};
    expectNear(lightAt(device_, solver, &stats), expected);
    EXPECT_EQ(stats.fallbacks, 0u);
  }
}

TEST_F(FormfieldVulkan, AFullDeviceHandsOverToTheCpuAndSaysSo) {
  make();
  if (IsSkipped()) return;
  const std::vector<float> expected = lightAt(device_, FORMFIELD_SOLVER_GATHER);
  FormfieldVulkanSettings small = settings_;
  small.memory_bytes = 100000;
  FormfieldDevice full = nullptr;
  ASSERT_EQ(formfieldCreateVulkanDevice(&small, &full), FORMFIELD_OK) << formfieldError(nullptr);
  FormfieldStats stats{};
  expectNear(lightAt(full, FORMFIELD_SOLVER_GATHER, &stats), expected);
  EXPECT_EQ(stats.fallbacks, 1u);
  formfieldDestroyDevice(full);
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
