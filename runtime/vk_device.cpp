#include "runtime/vk_device.h"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstring>

#include "runtime/vk_buffer.h"

namespace ff::runtime {
namespace {

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";

const char* resultName(VkResult r) {
  switch (r) {
    case VK_ERROR_OUT_OF_HOST_MEMORY: return "VK_ERROR_OUT_OF_HOST_MEMORY";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
    case VK_ERROR_INITIALIZATION_FAILED: return "VK_ERROR_INITIALIZATION_FAILED";
    case VK_ERROR_DEVICE_LOST: return "VK_ERROR_DEVICE_LOST";
    case VK_ERROR_LAYER_NOT_PRESENT: return "VK_ERROR_LAYER_NOT_PRESENT";
    case VK_ERROR_EXTENSION_NOT_PRESENT: return "VK_ERROR_EXTENSION_NOT_PRESENT";
    case VK_ERROR_FEATURE_NOT_PRESENT: return "VK_ERROR_FEATURE_NOT_PRESENT";
    case VK_ERROR_INCOMPATIBLE_DRIVER: return "VK_ERROR_INCOMPATIBLE_DRIVER";
    case VK_TIMEOUT: return "VK_TIMEOUT";
    default: return nullptr;
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
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return 0;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return 1;
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return 2;
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return 3;
    default: return 4;
  }
}

// Number of the first queue family with compute and graphics; -1: none.
int queueFamily(VkPhysicalDevice physical, bool* has_timestamps) {
  uint32_t n = 0;
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, nullptr);
  std::vector<VkQueueFamilyProperties> families(n);
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, families.data());
  constexpr VkQueueFlags kNeeded = VK_QUEUE_COMPUTE_BIT | VK_QUEUE_GRAPHICS_BIT;
  for (uint32_t i = 0; i < n; ++i) {
    if ((families[i].queueFlags & kNeeded) != kNeeded) continue;
    *has_timestamps = families[i].timestampValidBits > 0;
    return static_cast<int>(i);
  }
  return -1;
}

// What a device lacks for us; empty: nothing.
std::string lacks(VkPhysicalDevice physical) {
  auto subgroup = zeroed<VkPhysicalDeviceSubgroupProperties>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES);
  auto p = zeroed<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  p.pNext = &subgroup;
  vkGetPhysicalDeviceProperties2(physical, &p);
  if (p.properties.apiVersion < VK_API_VERSION_1_2) return "Vulkan 1.2";
  bool unused = false;
  if (queueFamily(physical, &unused) < 0) return "a queue with compute and graphics";
  if (!(subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) ||
      !(subgroup.supportedOperations & VK_SUBGROUP_FEATURE_ARITHMETIC_BIT))
    return "subgroup arithmetic in compute shaders";
  return {};
}

}  // namespace

Error vkError(const char* call, VkResult result) {
  const char* name = resultName(result);
  std::string remedy;
  if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY) remedy = "use a smaller radius or another device";
  return deviceError(std::string(call) + " failed: " + (name ? name : "VkResult " + std::to_string(result)), remedy);
}

Result<std::shared_ptr<VkContext>> openVulkan(const VulkanChoice& choice) { return VkContext::open(choice); }
std::string deviceName(const VkContext& context) { return context.deviceName(); }
std::vector<std::string> validationMessages(const VkContext& context) { return context.messages(); }

Result<std::shared_ptr<VkContext>> VkContext::open(const VulkanChoice& choice) {
  std::shared_ptr<VkContext> c(new VkContext());
  if (auto r = c->createInstance(choice); !r) return r.error();
  if (auto r = c->choosePhysicalDevice(choice.device); !r) return r.error();
  if (auto r = c->createDevice(choice); !r) return r.error();
  c->heap_ = std::make_unique<VkHeap>(*c);
  return c;
}

VkContext::~VkContext() {
  if (device_) {
    vkDeviceWaitIdle(device_);
    heap_.reset();
    vkDestroyQueryPool(device_, queries_, nullptr);
    vkDestroyFence(device_, fence_, nullptr);
    vkDestroyCommandPool(device_, pool_, nullptr);
    vkDestroyDevice(device_, nullptr);
  }
  if (messenger_) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance_, "vkDestroyDebugUtilsMessengerEXT"));
    destroy(instance_, messenger_, nullptr);
  }
  if (instance_) vkDestroyInstance(instance_, nullptr);
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
  messenger.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
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
    const std::string missing = lacks(d);
    seen += (seen.empty() ? "" : ", ") + std::string(p.deviceName) + (missing.empty() ? "" : " (lacks " + missing + ")");
    const bool named = wanted == "auto" || (wanted == "cpu" && p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU) ||
                       (wanted != "cpu" && lower(p.deviceName).find(lower(wanted)) != std::string::npos);
    if (!named || !missing.empty() || rank(p.deviceType) >= best) continue;
    best = rank(p.deviceType);
    physical_ = d;
  }
  if (!physical_)
    return deviceError("no usable device matches '" + wanted + "'",
                       seen.empty() ? "install a Vulkan driver, such as mesa-vulkan-drivers" : "there is: " + seen);
  auto subgroup = zeroed<VkPhysicalDeviceSubgroupProperties>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES);
  auto p2 = zeroed<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  p2.pNext = &subgroup;
  vkGetPhysicalDeviceProperties2(physical_, &p2);
  properties_ = p2.properties;
  subgroup_size_ = subgroup.subgroupSize;
  family_ = static_cast<uint32_t>(queueFamily(physical_, &has_timestamps_));
  return {};
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
  auto info = zeroed<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  info.pEnabledFeatures = &features;
  if (const VkResult r = vkCreateDevice(physical_, &info, nullptr, &device_); r != VK_SUCCESS)
    return vkError("vkCreateDevice", r);
  vkGetDeviceQueue(device_, family_, 0, &queue_);

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
  auto fence = zeroed<VkFenceCreateInfo>(VK_STRUCTURE_TYPE_FENCE_CREATE_INFO);
  if (const VkResult r = vkCreateFence(device_, &fence, nullptr, &fence_); r != VK_SUCCESS)
    return vkError("vkCreateFence", r);
  if (has_timestamps_) {
    auto queries = zeroed<VkQueryPoolCreateInfo>(VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO);
    queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
    queries.queryCount = 2;
    if (const VkResult r = vkCreateQueryPool(device_, &queries, nullptr, &queries_); r != VK_SUCCESS)
      return vkError("vkCreateQueryPool", r);
  }
  return {};
}

Result<double> VkContext::run(const std::function<void(VkCommandBuffer)>& record) {
  if (const VkResult r = vkResetCommandPool(device_, pool_, 0); r != VK_SUCCESS) return vkError("vkResetCommandPool", r);
  auto begin = zeroed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
  begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  if (const VkResult r = vkBeginCommandBuffer(commands_, &begin); r != VK_SUCCESS)
    return vkError("vkBeginCommandBuffer", r);
  if (queries_) {
    vkCmdResetQueryPool(commands_, queries_, 0, 2);
    vkCmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, queries_, 0);
  }
  // Waiting for a fence does not by itself make one submission's writes visible to the next one's commands.
  auto from_before = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  from_before.srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
  from_before.dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
  vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 1,
                       &from_before, 0, nullptr, 0, nullptr);
  record(commands_);
  // A fence makes writes available, not visible to the host: that needs this barrier.
  auto to_host = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  to_host.srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
  to_host.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &to_host, 0,
                       nullptr, 0, nullptr);
  if (queries_) vkCmdWriteTimestamp(commands_, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_, 1);
  if (const VkResult r = vkEndCommandBuffer(commands_); r != VK_SUCCESS) return vkError("vkEndCommandBuffer", r);

  auto submit = zeroed<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
  submit.commandBufferCount = 1;
  submit.pCommandBuffers = &commands_;
  const auto start = std::chrono::steady_clock::now();
  if (const VkResult r = vkQueueSubmit(queue_, 1, &submit, fence_); r != VK_SUCCESS) return vkError("vkQueueSubmit", r);
  constexpr uint64_t kTwoMinutes = 120'000'000'000;
  if (const VkResult r = vkWaitForFences(device_, 1, &fence_, VK_TRUE, kTwoMinutes); r != VK_SUCCESS)
    return vkError("vkWaitForFences", r);
  if (const VkResult r = vkResetFences(device_, 1, &fence_); r != VK_SUCCESS) return vkError("vkResetFences", r);
  double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  if (queries_) {
    uint64_t ticks[2] = {};
    if (const VkResult r = vkGetQueryPoolResults(device_, queries_, 0, 2, sizeof(ticks), ticks, sizeof(uint64_t),
                                                 VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT);
        r != VK_SUCCESS)
      return vkError("vkGetQueryPoolResults", r);
    ms = static_cast<double>(ticks[1] - ticks[0]) * static_cast<double>(properties_.limits.timestampPeriod) * 1e-6;
  }
  return ms;
}

}  // namespace ff::runtime
