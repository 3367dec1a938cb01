/* consumer_vulkan WORLD.ffm: the same on a Vulkan device that the program made itself, as an engine's is. */
#include <formfield_vulkan.h>
#include <stdio.h>
#include <vulkan/vulkan.h>

static int fail(FormfieldDevice device, const char* what) {
  fprintf(stderr, "consumer_vulkan: %s: %s\n", what, formfieldError(device));
  return 2;
}

/* The least of a device that Formfield takes: Vulkan 1.2, timelineSemaphore, a queue that computes. */
static int makeDevice(FormfieldVulkanSettings* s) {
  const VkApplicationInfo application = {VK_STRUCTURE_TYPE_APPLICATION_INFO, NULL, "consumer", 1, NULL, 0,
                                         VK_API_VERSION_1_2};
  const VkInstanceCreateInfo instance = {VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, NULL, 0, &application, 0, NULL, 0, NULL};
  if (vkCreateInstance(&instance, NULL, &s->instance) != VK_SUCCESS) return 0;
  uint32_t count = 1;
  if (vkEnumeratePhysicalDevices(s->instance, &count, &s->physical_device) < 0 || count == 0) return 0;
  VkQueueFamilyProperties families[16];
  uint32_t family_count = 16;
  vkGetPhysicalDeviceQueueFamilyProperties(s->physical_device, &family_count, families);
  for (s->queue_family = 0; s->queue_family < family_count; ++s->queue_family)
    if (families[s->queue_family].queueFlags & VK_QUEUE_COMPUTE_BIT) break;
  const float priority = 1;
  const VkDeviceQueueCreateInfo queue = {VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, NULL, 0, s->queue_family, 1, &priority};
  VkPhysicalDeviceVulkan12Features features = {0};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES;
  features.timelineSemaphore = VK_TRUE;
  VkDeviceCreateInfo device = {0};
  device.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO;
  device.pNext = &features;
  device.queueCreateInfoCount = 1;
  device.pQueueCreateInfos = &queue;
  if (vkCreateDevice(s->physical_device, &device, NULL, &s->device) != VK_SUCCESS) return 0;
  vkGetDeviceQueue(s->device, s->queue_family, 0, &s->queue);
  return 1;
}

static int run(FormfieldDevice device, const char* path) {
  FormfieldWorld world;
  if (formfieldOpenWorld(device, path, NULL, &world) != FORMFIELD_OK) return fail(device, path);
  const FormfieldSky sky = {{1, 1, 1}, {{0}}, {{0}}};
  const double at[3] = {0, 2, 0};
  const float point[3] = {0, 2, 0}, up[3] = {0, 1, 0};
  float irradiance[3] = {0, 0, 0};
  FormfieldStats stats;
  stats.size = sizeof stats;
  int code = 2;
  if (formfieldSetSky(world, &sky) != FORMFIELD_OK || formfieldFrame(world, at, NULL) != FORMFIELD_OK ||
      formfieldSettle(world, 1e-4f, 200) != FORMFIELD_OK || formfieldSample(world, 1, point, up, irradiance) != FORMFIELD_OK ||
      formfieldGetStats(world, &stats) != FORMFIELD_OK) {
    fail(device, "frame");
  } else {
    printf("%s: %u leaves, residual %.1e, irradiance %g W/m2, %u fallbacks\n", formfieldSolverName(world), stats.leaves,
           stats.residual, irradiance[1], stats.fallbacks);
    code = irradiance[1] > 0 && stats.fallbacks == 0 && stats.residual < 1e-3 ? 0 : 3;
  }
  formfieldCloseWorld(world);
  return code;
}

int main(int argc, char** argv) {
  if (argc != 2) return fprintf(stderr, "usage: consumer_vulkan WORLD.ffm\n"), 1;
  FormfieldVulkanSettings settings = {0};
  settings.size = sizeof settings;
  if (!makeDevice(&settings)) return fprintf(stderr, "consumer_vulkan: no Vulkan device\n"), 77;
  FormfieldDevice device;
  if (formfieldCreateVulkanDevice(&settings, &device) != FORMFIELD_OK) return fail(NULL, "device");
  const int code = run(device, argv[1]);
  formfieldDestroyDevice(device);
  vkDestroyDevice(settings.device, NULL);
  vkDestroyInstance(settings.instance, NULL);
  return code;
}
