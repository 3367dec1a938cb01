// The device as engines need it: the caller's own device, a lost device, a full one; the solver behind them survives.
#include "runtime/vulkan/device.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "runtime/gather/vk_gather.h"
#include "runtime/solver/fallback_solver.h"
#include "runtime/vulkan/buffer.h"
#include "tests/support/hand_made.h"

namespace ff::runtime {
namespace {

// A ring of slots in which each sees the next two; radiosity differs from slot to slot.
std::shared_ptr<const LocalMatrix> ring(uint32_t slots) {
  LocalMatrix m;
  m.row_start.push_back(0);
  for (uint32_t s = 0; s < slots; ++s) {
    m.entries.push_back(packEntry((s + 1) % slots, 500));
    m.entries.push_back(packEntry((s + 2) % slots, 300));
    m.row_start.push_back(static_cast<uint32_t>(m.entries.size()));
    m.albedo.push_back({0.8f, 0.5f, 0.2f, 0});
    m.row_scale.push_back(1.0f / 1000);
    m.area_m2.push_back(1);
    m.leaf.push_back(1);
  }
  m.refined_level_start = {0};
  finishByHand(m);
  return std::make_shared<const LocalMatrix>(std::move(m));
}

std::vector<Vec4> lamp(uint32_t slots) {
  std::vector<Vec4> source(slots);
  source[slots / 2] = {10, 20, 30, 0};
  return source;
}

std::vector<Vec4> solved(Solver& solver, const std::shared_ptr<const LocalMatrix>& m, int iterations) {
  std::vector<Vec4> b(m->slots());
  const auto source = lamp(m->slots());
  auto r = setMatrix(solver, *m);
  if (r) r = solver.setSource(source);
  if (r) r = solver.iterate(iterations);
  if (r) r = solver.radiosity(b);
  EXPECT_TRUE(r) << (r ? "" : r.error().line());
  return b;
}

void expectSame(const std::vector<Vec4>& a, const std::vector<Vec4>& b) {
  ASSERT_EQ(a.size(), b.size());
  float largest = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    // A row has two terms and every term is >= 0: a few ulp an iteration.
    EXPECT_NEAR(a[i].x, b[i].x, 1e-5f * b[i].x) << i;
    EXPECT_NEAR(a[i].y, b[i].y, 1e-5f * b[i].y) << i;
    EXPECT_NEAR(a[i].z, b[i].z, 1e-5f * b[i].z) << i;
    largest = std::max(largest, b[i].z);
  }
  EXPECT_GE(largest, 30);
}

// An engine: makes its own instance, device and queue, and keeps using them.
struct EngineDevice {
  VkInstance instance = VK_NULL_HANDLE;
  VkPhysicalDevice physical = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  uint32_t family = 0;

  bool start() {
    auto app = zeroed<VkApplicationInfo>(VK_STRUCTURE_TYPE_APPLICATION_INFO);
    app.apiVersion = VK_API_VERSION_1_2;
    auto info = zeroed<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
    info.pApplicationInfo = &app;
    if (vkCreateInstance(&info, nullptr, &instance) != VK_SUCCESS) return false;
    uint32_t n = 1;
    vkEnumeratePhysicalDevices(instance, &n, &physical);
    if (n == 0) return false;
    const float priority = 1;
    auto q = zeroed<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
    q.queueCount = 1;
    q.pQueuePriorities = &priority;
    auto timeline = zeroed<VkPhysicalDeviceTimelineSemaphoreFeatures>(
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES);
    timeline.timelineSemaphore = VK_TRUE;
    auto d = zeroed<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
    d.pNext = &timeline;
    d.queueCreateInfoCount = 1;
    d.pQueueCreateInfos = &q;
    if (vkCreateDevice(physical, &d, nullptr, &device) != VK_SUCCESS) return false;
    vkGetDeviceQueue(device, family, 0, &queue);
    return true;
  }
  ~EngineDevice() {
    if (device) vkDestroyDevice(device, nullptr);
    if (instance) vkDestroyInstance(instance, nullptr);
  }
};

TEST(AdoptedDevice, SolvesOnTheCallersQueueAndLeavesItsDeviceAlone) {
  EngineDevice engine;
  if (!engine.start()) GTEST_SKIP() << "no Vulkan 1.2 device, nothing was tested";
  const auto m = ring(300);
  const auto cpu = makeCpuGather(1);
  const auto want = solved(*cpu, m, 30);
  for (int repeat = 0; repeat < 2; ++repeat) {  // the second time proves that the first destroyed nothing of ours
    auto context = VkContext::adopt(engine.instance, engine.physical, engine.device, engine.family, engine.queue);
    ASSERT_TRUE(context) << context.error().line();
    EXPECT_EQ((*context)->device(), engine.device);
    auto solver = makeVulkanGather(*context);
    ASSERT_TRUE(solver) << solver.error().line();
    expectSame(solved(**solver, m, 30), want);
  }
  EXPECT_EQ(vkDeviceWaitIdle(engine.device), VK_SUCCESS);
}

TEST(AdoptedDevice, IsRefusedWithALineThatNamesWhatIsWrong) {
  EngineDevice engine;
  if (!engine.start()) GTEST_SKIP() << "no Vulkan 1.2 device, nothing was tested";
  auto no_queue = VkContext::adopt(engine.instance, engine.physical, engine.device, 0, VK_NULL_HANDLE);
  ASSERT_FALSE(no_queue);
  EXPECT_EQ(no_queue.error().code, ErrorCode::kUsage);
  auto no_family = VkContext::adopt(engine.instance, engine.physical, engine.device, 77, engine.queue);
  ASSERT_FALSE(no_family);
  EXPECT_NE(no_family.error().line().find("77"), std::string::npos) << no_family.error().line();
}

class VkDeviceTest : public testing::Test {
 protected:
  void open(uint64_t memory_bytes = 0) {
    auto c = openVulkan({.device = "auto", .validate = true, .gpu_assisted = false, .memory_bytes = memory_bytes});
    if (!c) GTEST_SKIP() << "no Vulkan device with validation layers, nothing was tested: " << c.error().line();
    context_ = *c;
  }
  void TearDown() override {
    if (!context_) return;
    for (const std::string& message : validationMessages(*context_)) ADD_FAILURE() << message;
  }
  std::shared_ptr<VkContext> context_;
};

TEST_F(VkDeviceTest, NumbersItsSubmissionsAndWaitsForAnyOfThem) {
  open();
  if (!context_) return;
  auto pool_info = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.queueFamilyIndex = context_->queueFamily();
  VkCommandPool pool = VK_NULL_HANDLE;
  ASSERT_EQ(vkCreateCommandPool(context_->device(), &pool_info, nullptr, &pool), VK_SUCCESS);
  auto info = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  info.commandPool = pool;
  info.commandBufferCount = 2;
  VkCommandBuffer commands[2];
  ASSERT_EQ(vkAllocateCommandBuffers(context_->device(), &info, commands), VK_SUCCESS);
  for (VkCommandBuffer c : commands) {
    const auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    ASSERT_EQ(vkBeginCommandBuffer(c, &begin), VK_SUCCESS);
    ASSERT_EQ(vkEndCommandBuffer(c), VK_SUCCESS);
  }
  auto first = context_->submit(commands[0]), second = context_->submit(commands[1]);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(*second, *first + 1);
  EXPECT_TRUE(context_->wait(*second));
  EXPECT_TRUE(context_->wait(*first));
  vkDestroyCommandPool(context_->device(), pool, nullptr);
}

TEST_F(VkDeviceTest, ReportsMemoryPastTheBudgetAndGoesOnBelowIt) {
  open(/*memory_bytes=*/1 << 20);
  if (!context_) return;
  auto fits = Buffer::create(*context_, 600 << 10, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
  ASSERT_TRUE(fits) << fits.error().line();
  auto exceeds = Buffer::create(*context_, 600 << 10, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
  ASSERT_FALSE(exceeds);
  EXPECT_EQ(exceeds.error().cause, ErrorCause::kOutOfDeviceMemory);
  EXPECT_NE(exceeds.error().line().find("VK_ERROR_OUT_OF_DEVICE_MEMORY"), std::string::npos) << exceeds.error().line();
  *fits = Buffer{};  // what is given back can be had again, also in one piece that is larger
  EXPECT_TRUE(Buffer::create(*context_, 900 << 10, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT));
}

TEST_F(VkDeviceTest, FailsAtOnceAfterTheDeviceWasLost) {
  open();
  if (!context_) return;
  context_->loseDeviceAfter(1);
  EXPECT_TRUE(context_->run([](VkCommandBuffer) {}));
  EXPECT_FALSE(context_->lost());
  for (int i = 0; i < 2; ++i) {
    auto r = context_->run([](VkCommandBuffer) {});
    ASSERT_FALSE(r);
    EXPECT_EQ(r.error().cause, ErrorCause::kDeviceLost);
    EXPECT_TRUE(context_->lost());
  }
}

TEST_F(VkDeviceTest, ALostDeviceIsSurvivedWithTheRadiosityLastSeen) {
  open();
  if (!context_) return;
  const auto m = ring(500);
  auto vulkan = makeVulkanGather(context_);
  ASSERT_TRUE(vulkan) << vulkan.error().line();
  auto solver = makeFallbackSolver(std::move(*vulkan), makeCpuGather(1));
  const auto seen = solved(*solver, m, 10);
  EXPECT_EQ(solver->reason(), "");
  EXPECT_NE(std::string(solver->name()).find("vulkan"), std::string::npos);
  context_->loseDeviceAfter(0);
  ASSERT_TRUE(solver->iterate(5));
  EXPECT_NE(solver->reason().find("VK_ERROR_DEVICE_LOST"), std::string::npos) << solver->reason();
  EXPECT_STREQ(solver->name(), "cpu");
  std::vector<Vec4> got(m->slots());
  ASSERT_TRUE(solver->radiosity(got));
  // 10 iterations on the device, then 5 on the CPU that start from them, are 15.
  const auto cpu = makeCpuGather(1);
  expectSame(got, solved(*cpu, m, 15));
}

TEST_F(VkDeviceTest, AMatrixThatOutgrowsItsRoomIsSurvived) {
  open(/*memory_bytes=*/4 << 20);
  if (!context_) return;
  const auto refused = makeVulkanGather(context_);  // the usual room is larger
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().cause, ErrorCause::kOutOfDeviceMemory);
  auto vulkan = makeVulkanGather(
      context_, {.slots = 1000, .tiles = 16, .pages = 64, .packed_bytes = 1 << 16, .entry_bytes = 1 << 16});
  ASSERT_TRUE(vulkan) << vulkan.error().line();
  auto solver = makeFallbackSolver(std::move(*vulkan), makeCpuGather(1));
  (void)solved(*solver, ring(100), 5);
  EXPECT_EQ(solver->reason(), "");
  const auto large = ring(40000);
  const auto cpu = makeCpuGather(1);
  expectSame(solved(*solver, large, 20), solved(*cpu, large, 20));
  EXPECT_NE(solver->reason().find("40000 slots, room was made for 1000"), std::string::npos) << solver->reason();
}

}  // namespace
}  // namespace ff::runtime
