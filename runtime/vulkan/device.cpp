#include "runtime/vulkan/device.h"

#include <algorithm>
#include <cctype>
#include <cstring>

#include "runtime/clock.h"
#include "runtime/vulkan/buffer.h"

namespace ff::runtime {
namespace {

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";
constexpr uint32_t kStorageBuffers = 8;  // bindings of a shader of ours, at most (the specification promises 4)
constexpr uint32_t kWorkGroup = 128;     // invocations of a work group of ours, at most

const char* resultName(VkResult r) {
  switch (r) {
    case VK_ERROR_OUT_OF_HOST_MEMORY:
      return "VK_ERROR_OUT_OF_HOST_MEMORY";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
      return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
    case VK_ERROR_INITIALIZATION_FAILED:
      return "VK_ERROR_INITIALIZATION_FAILED";
    case VK_ERROR_DEVICE_LOST:
      return "VK_ERROR_DEVICE_LOST";
    case VK_ERROR_LAYER_NOT_PRESENT:
      return "VK_ERROR_LAYER_NOT_PRESENT";
    case VK_ERROR_EXTENSION_NOT_PRESENT:
      return "VK_ERROR_EXTENSION_NOT_PRESENT";
    case VK_ERROR_FEATURE_NOT_PRESENT:
      return "VK_ERROR_FEATURE_NOT_PRESENT";
    case VK_ERROR_INCOMPATIBLE_DRIVER:
      return "VK_ERROR_INCOMPATIBLE_DRIVER";
    case VK_ERROR_TOO_MANY_OBJECTS:
      return "VK_ERROR_TOO_MANY_OBJECTS";
    case VK_TIMEOUT:
      return "VK_TIMEOUT";
    default:
      return nullptr;
  }
}

Error deviceError(std::string message, std::string remedy = {}) {
  return Error{ErrorCode::kIo, "", "vulkan", std::move(message), std::move(remedy)};
}

std::string lower(std::string s) {
  for (char& c : s) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return s;
}

bool hasLayer(const char* name) {
  uint32_t n = 0;
  vkEnumerateInstanceLayerProperties(&n, nullptr);
  std::vector<VkLayerProperties> layers(n);
  vkEnumerateInstanceLayerProperties(&n, layers.data());
  return std::any_of(layers.begin(), layers.end(),
                     [&](const VkLayerProperties& l) { return std::strcmp(l.layerName, name) == 0; });
}

// Lower is better; the order of VulkanChoice "auto".
int rank(VkPhysicalDeviceType type) {
  switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
      return 0;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
      return 1;
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU:
      return 2;
    case VK_PHYSICAL_DEVICE_TYPE_CPU:
      return 3;
    default:
      return 4;
  }
}

std::vector<VkQueueFamilyProperties> queueFamilies(VkPhysicalDevice physical) {
  uint32_t n = 0;
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, nullptr);
  std::vector<VkQueueFamilyProperties> families(n);
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, families.data());
  return families;
}

// Number of the first queue family with compute and graphics; -1: none.
int graphicsFamily(VkPhysicalDevice physical) {
  const auto families = queueFamilies(physical);
  constexpr VkQueueFlags kNeeded = VK_QUEUE_COMPUTE_BIT | VK_QUEUE_GRAPHICS_BIT;
  for (size_t i = 0; i < families.size(); ++i)
    if ((families[i].queueFlags & kNeeded) == kNeeded) return static_cast<int>(i);
  return -1;
}

// What a device lacks for us, whatever its queues; empty: nothing.
std::string lacks(VkPhysicalDevice physical) {
  VkPhysicalDeviceProperties first;
  vkGetPhysicalDeviceProperties(physical, &first);
  if (first.apiVersion < VK_API_VERSION_1_2) return "Vulkan 1.2";
  auto subgroup = zeroed<VkPhysicalDeviceSubgroupProperties>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES);
  auto p = zeroed<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  p.pNext = &subgroup;
  vkGetPhysicalDeviceProperties2(physical, &p);
  if (!(subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) ||
      !(subgroup.supportedOperations & VK_SUBGROUP_FEATURE_ARITHMETIC_BIT))
    return "subgroup arithmetic in compute shaders";
  if (p.properties.limits.maxPerStageDescriptorStorageBuffers < kStorageBuffers)
    return std::to_string(kStorageBuffers) + " storage buffers in a shader";
  if (p.properties.limits.maxComputeWorkGroupInvocations < kWorkGroup)
    return "work groups of " + std::to_string(kWorkGroup) + " invocations";
  auto timeline =
      zeroed<VkPhysicalDeviceTimelineSemaphoreFeatures>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES);
  auto features = zeroed<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);
  features.pNext = &timeline;
  vkGetPhysicalDeviceFeatures2(physical, &features);
  if (!timeline.timelineSemaphore) return "timeline semaphores";
  return {};
}

std::string lacksForOpen(VkPhysicalDevice physical) {
  std::string missing = lacks(physical);
  if (missing.empty() && graphicsFamily(physical) < 0) missing = "a queue with compute and graphics";
  return missing;
}

}  // namespace

Error vkError(const char* call, VkResult result) {
  const char* name = resultName(result);
  std::string remedy;
  if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY) remedy = "use a smaller radius or another device";
  if (result == VK_ERROR_DEVICE_LOST) remedy = "open the device again or go on with the CPU solver";
  Error e = deviceError(std::string(call) + " failed: " + (name ? name : "VkResult " + std::to_string(result)), remedy);
  if (result == VK_ERROR_DEVICE_LOST) e.cause = ErrorCause::kDeviceLost;
  if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY) e.cause = ErrorCause::kOutOfDeviceMemory;
  return e;
}

Result<std::shared_ptr<VkContext>> openVulkan(const VulkanChoice& choice) { return VkContext::open(choice); }
std::string deviceName(const VkContext& context) { return context.deviceName(); }
bool isSoftwareDevice(const VkContext& context) { return context.isSoftware(); }
std::vector<std::string> validationMessages(const VkContext& context) { return context.messages(); }

Result<std::shared_ptr<VkContext>> VkContext::open(const VulkanChoice& choice) {
  std::shared_ptr<VkContext> c(new VkContext());
  c->memory_bytes_ = choice.memory_bytes;
  if (auto r = c->createInstance(choice); !r) return r.error();
  if (auto r = c->choosePhysicalDevice(choice.device); !r) return r.error();
  if (auto r = c->createDevice(choice); !r) return r.error();
  if (auto r = c->createOwnObjects(); !r) return r.error();
  return c;
}

Result<std::shared_ptr<VkContext>> VkContext::adopt(VkInstance instance, VkPhysicalDevice physical, VkDevice device,
                                                    uint32_t queue_family, VkQueue queue, uint64_t memory_bytes) {
  const auto refused = [](const std::string& message, const std::string& remedy) {
    return Error{ErrorCode::kUsage, "", "vulkan", message, remedy};
  };
  if (!instance || !physical || !device || !queue)
    return refused("instance, physical device, device and queue must all be given", "pass the application's own four");
  if (const std::string missing = lacks(physical); !missing.empty())
    return deviceError("the device lacks " + missing, "use another device or the CPU solver");
  const auto families = queueFamilies(physical);
  if (queue_family >= families.size())
    return refused("the device has no queue family " + std::to_string(queue_family), "pass the queue's own family");
  if (!(families[queue_family].queueFlags & VK_QUEUE_COMPUTE_BIT))
    return refused("queue family " + std::to_string(queue_family) + " cannot compute", "pass a queue that can");
  std::shared_ptr<VkContext> c(new VkContext());
  c->owns_device_ = false;
  c->memory_bytes_ = memory_bytes;
  c->instance_ = instance;
  c->physical_ = physical;
  c->device_ = device;
  c->family_ = queue_family;
  c->queue_ = queue;
  c->readProperties();
  if (auto r = c->createOwnObjects(); !r) return r.error();
  return c;
}

VkContext::~VkContext() {
  if (device_) {
    // On the caller's device only our own submissions are waited for: vkDeviceWaitIdle would concern all its queues.
    if (owns_device_)
      vkDeviceWaitIdle(device_);
    else if (timeline_ && !lost_)
      (void)wait(submitted_).has_value();
    heap_.reset();
    vkDestroyQueryPool(device_, queries_, nullptr);
    vkDestroySemaphore(device_, timeline_, nullptr);
    vkDestroyCommandPool(device_, pool_, nullptr);
    if (owns_device_) vkDestroyDevice(device_, nullptr);
  }
  if (messenger_) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance_, "vkDestroyDebugUtilsMessengerEXT"));
    destroy(instance_, messenger_, nullptr);
  }
  if (instance_ && owns_device_) vkDestroyInstance(instance_, nullptr);
}

std::vector<std::string> VkContext::messages() const {
  const std::lock_guard lock(message_mutex_);
  return messages_;
}

VkBool32 VkContext::onMessage(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                              const VkDebugUtilsMessengerCallbackDataEXT* data, void* user) {
  auto* self = static_cast<VkContext*>(user);
  const std::lock_guard lock(self->message_mutex_);
  self->messages_.emplace_back(data->pMessage);
  return VK_FALSE;
}

Result<void> VkContext::createInstance(const VulkanChoice& choice) {
  auto app = zeroed<VkApplicationInfo>(VK_STRUCTURE_TYPE_APPLICATION_INFO);
  app.pApplicationName = "Formfield";
  app.apiVersion = VK_API_VERSION_1_2;
  auto info = zeroed<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
  info.pApplicationInfo = &app;

  std::vector<VkValidationFeatureEnableEXT> enables{VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT};
  if (choice.gpu_assisted) {
    enables.push_back(VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_EXT);
    enables.push_back(VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_RESERVE_BINDING_SLOT_EXT);
  }
  auto features = zeroed<VkValidationFeaturesEXT>(VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT);
  features.enabledValidationFeatureCount = static_cast<uint32_t>(enables.size());
  features.pEnabledValidationFeatures = enables.data();
  auto messenger = zeroed<VkDebugUtilsMessengerCreateInfoEXT>(VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT);
  messenger.messageSeverity =
      VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  messenger.messageType =
      VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
  messenger.pfnUserCallback = onMessage;
  messenger.pUserData = this;
  const char* const extensions[] = {VK_EXT_DEBUG_UTILS_EXTENSION_NAME, VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
  if (choice.validate) {
    if (!hasLayer(kValidationLayer))
      return deviceError(std::string(kValidationLayer) + " is not installed", "install vulkan-validationlayers");
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &kValidationLayer;
    info.enabledExtensionCount = 2;
    info.ppEnabledExtensionNames = extensions;
    features.pNext = &messenger;  // so that vkCreateInstance itself is watched, too
    info.pNext = &features;
  }
  if (const VkResult r = vkCreateInstance(&info, nullptr, &instance_); r != VK_SUCCESS)
    return r == VK_ERROR_INCOMPATIBLE_DRIVER
               ? deviceError("there is no Vulkan driver", "install mesa-vulkan-drivers (lavapipe runs on the CPU)")
               : vkError("vkCreateInstance", r);
  if (choice.validate) {
    const auto create = reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance_, "vkCreateDebugUtilsMessengerEXT"));
    if (const VkResult r = create(instance_, &messenger, nullptr, &messenger_); r != VK_SUCCESS)
      return vkError("vkCreateDebugUtilsMessengerEXT", r);
  }
  return {};
}

Result<void> VkContext::choosePhysicalDevice(const std::string& wanted) {
  uint32_t n = 0;
  vkEnumeratePhysicalDevices(instance_, &n, nullptr);
  std::vector<VkPhysicalDevice> devices(n);
  vkEnumeratePhysicalDevices(instance_, &n, devices.data());
  std::string seen;
  int best = 100;
  for (VkPhysicalDevice d : devices) {
    VkPhysicalDeviceProperties p;
    vkGetPhysicalDeviceProperties(d, &p);
    const std::string missing = lacksForOpen(d);
    seen +=
        (seen.empty() ? "" : ", ") + std::string(p.deviceName) + (missing.empty() ? "" : " (lacks " + missing + ")");
    const bool named = wanted == "auto" || (wanted == "cpu" && p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU) ||
                       (wanted != "cpu" && lower(p.deviceName).find(lower(wanted)) != std::string::npos);
    if (!named || !missing.empty() || rank(p.deviceType) >= best) continue;
    best = rank(p.deviceType);
    physical_ = d;
  }
  if (!physical_)
    return deviceError("no usable device matches '" + wanted + "'",
                       seen.empty() ? "install a Vulkan driver, such as mesa-vulkan-drivers" : "there is: " + seen);
  family_ = static_cast<uint32_t>(graphicsFamily(physical_));
  readProperties();
  return {};
}

void VkContext::readProperties() {
  auto subgroup = zeroed<VkPhysicalDeviceSubgroupProperties>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES);
  auto p2 = zeroed<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  p2.pNext = &subgroup;
  vkGetPhysicalDeviceProperties2(physical_, &p2);
  properties_ = p2.properties;
  subgroup_size_ = subgroup.subgroupSize;
  has_timestamps_ = queueFamilies(physical_)[family_].timestampValidBits > 0;
}

Result<void> VkContext::createDevice(const VulkanChoice& choice) {
  const float priority = 1;
  auto queue = zeroed<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
  queue.queueFamilyIndex = family_;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  VkPhysicalDeviceFeatures has{}, features{};
  vkGetPhysicalDeviceFeatures(physical_, &has);
  if (choice.gpu_assisted) {  // the instrumented shaders write their findings to a buffer
    features.fragmentStoresAndAtomics = has.fragmentStoresAndAtomics;
    features.vertexPipelineStoresAndAtomics = has.vertexPipelineStoresAndAtomics;
    features.shaderInt64 = has.shaderInt64;
  }
  auto timeline =
      zeroed<VkPhysicalDeviceTimelineSemaphoreFeatures>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES);
  timeline.timelineSemaphore = VK_TRUE;
  auto info = zeroed<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  info.pNext = &timeline;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  info.pEnabledFeatures = &features;
  if (const VkResult r = vkCreateDevice(physical_, &info, nullptr, &device_); r != VK_SUCCESS)
    return vkError("vkCreateDevice", r);
  vkGetDeviceQueue(device_, family_, 0, &queue_);
  return {};
}

Result<void> VkContext::createOwnObjects() {
  heap_ = std::make_unique<VkHeap>(*this);
  auto pool = zeroed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool.queueFamilyIndex = family_;
  if (const VkResult r = vkCreateCommandPool(device_, &pool, nullptr, &pool_); r != VK_SUCCESS)
    return vkError("vkCreateCommandPool", r);
  auto commands = zeroed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  commands.commandPool = pool_;
  commands.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  commands.commandBufferCount = 1;
  if (const VkResult r = vkAllocateCommandBuffers(device_, &commands, &commands_); r != VK_SUCCESS)
    return vkError("vkAllocateCommandBuffers", r);
  auto type = zeroed<VkSemaphoreTypeCreateInfo>(VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO);
  type.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
  auto semaphore = zeroed<VkSemaphoreCreateInfo>(VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO);
  semaphore.pNext = &type;
  if (const VkResult r = vkCreateSemaphore(device_, &semaphore, nullptr, &timeline_); r != VK_SUCCESS)
    return vkError("vkCreateSemaphore", r);
  if (has_timestamps_) {
    auto queries = zeroed<VkQueryPoolCreateInfo>(VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO);
    queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
    queries.queryCount = 4;
    if (const VkResult r = vkCreateQueryPool(device_, &queries, nullptr, &queries_); r != VK_SUCCESS)
      return vkError("vkCreateQueryPool", r);
  }
  return {};
}

Error VkContext::failed(const char* call, VkResult result) {
  lost_ |= result == VK_ERROR_DEVICE_LOST;
  return vkError(call, result);
}

Result<uint64_t> VkContext::submit(VkCommandBuffer commands) {
  if (submissions_until_lost_ == 0) lost_ = true;
  if (lost_) return failed("vkQueueSubmit", VK_ERROR_DEVICE_LOST);
  if (submissions_until_lost_ != UINT64_MAX) --submissions_until_lost_;
  const uint64_t number = submitted_ + 1;
  auto values = zeroed<VkTimelineSemaphoreSubmitInfo>(VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO);
  values.signalSemaphoreValueCount = 1;
  values.pSignalSemaphoreValues = &number;
  auto info = zeroed<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
  info.pNext = &values;
  info.commandBufferCount = 1;
  info.pCommandBuffers = &commands;
  info.signalSemaphoreCount = 1;
  info.pSignalSemaphores = &timeline_;
  if (const VkResult r = vkQueueSubmit(queue_, 1, &info, VK_NULL_HANDLE); r != VK_SUCCESS)
    return failed("vkQueueSubmit", r);
  submitted_ = number;
  return number;
}

Result<void> VkContext::wait(uint64_t submission) {
  if (lost_) return failed("vkWaitSemaphores", VK_ERROR_DEVICE_LOST);
  constexpr uint64_t kTwoMinutes = 120'000'000'000;
  auto info = zeroed<VkSemaphoreWaitInfo>(VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO);
  info.semaphoreCount = 1;
  info.pSemaphores = &timeline_;
  info.pValues = &submission;
  const VkResult r = vkWaitSemaphores(device_, &info, kTwoMinutes);
  if (r == VK_SUCCESS) return {};
  return failed("vkWaitSemaphores", r == VK_TIMEOUT ? VK_ERROR_DEVICE_LOST : r);
}

Result<void> VkContext::beginRun() {
  if (lost_) return failed("VkContext::run", VK_ERROR_DEVICE_LOST);
  if (const VkResult r = vkResetCommandPool(device_, pool_, 0); r != VK_SUCCESS)
    return vkError("vkResetCommandPool", r);
  auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
  begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  if (const VkResult r = vkBeginCommandBuffer(commands_, &begin); r != VK_SUCCESS)
    return vkError("vkBeginCommandBuffer", r);
  if (queries_) {
    vkCmdResetQueryPool(commands_, queries_, 0, 4);
    vkCmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, queries_, 0);
  }
  // Waiting for a semaphore on the host does not by itself make one submission's writes visible to the next one's
  // commands.
  auto from_before = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  from_before.srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
  from_before.dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
  vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 1,
                       &from_before, 0, nullptr, 0, nullptr);
  timed_ = false;
  return {};
}

Result<double> VkContext::finishRun() {
  // A semaphore makes writes available, not visible to the host: that needs this barrier.
  auto to_host = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  to_host.srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
  to_host.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &to_host, 0,
                       nullptr, 0, nullptr);
  if (queries_) vkCmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_, 1);
  if (const VkResult r = vkEndCommandBuffer(commands_); r != VK_SUCCESS) return vkError("vkEndCommandBuffer", r);

  const auto start = Clock::now();
  auto submission = submit(commands_);
  if (!submission) return submission.error();
  if (auto r = wait(*submission); !r) return r.error();
  double ms = msSince(start);
  if (queries_) {
    uint64_t ticks[4] = {};
    const uint32_t count = timed_ ? 4 : 2;
    if (const VkResult r = vkGetQueryPoolResults(device_, queries_, 0, count, sizeof(ticks), ticks, sizeof(uint64_t),
                                                 VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT);
        r != VK_SUCCESS)
      return failed("vkGetQueryPoolResults", r);
    const double ms_per_tick = static_cast<double>(properties_.limits.timestampPeriod) * 1e-6;
    ms = static_cast<double>(ticks[1] - ticks[0]) * ms_per_tick;
    if (timed_) timed_ms_ = static_cast<double>(ticks[3] - ticks[2]) * ms_per_tick;
  } else if (timed_) {
    timed_ms_ = ms;
  }
  return ms;
}

void VkContext::beginTimed(VkCommandBuffer commands) {
  timed_ = true;
  if (queries_) vkCmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_, 2);
}

void VkContext::endTimed(VkCommandBuffer commands) {
  if (queries_) vkCmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_, 3);
}

}  // namespace ff::runtime
