/* Formfield on Vulkan: the companion of formfield.h for those who have a device. Core Vulkan 1.2 with timelineSemaphore and
 * subgroup arithmetic in compute shaders is all that is needed; what a device lacks is an error that says so. */
#ifndef FORMFIELD_VULKAN_H
#define FORMFIELD_VULKAN_H

#include <vulkan/vulkan_core.h>

#include "formfield.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct FormfieldVulkanSettings {
  uint32_t size; /* sizeof(FormfieldVulkanSettings) */
  /* The caller's device, all four and queue_family; or all null: one of our own. Instance and device of version 1.2 or
   * newer, timelineSemaphore enabled, the queue able to compute. The caller does not use the queue while formfieldFrame,
   * formfieldSettle, formfieldOpenWorld or formfieldCloseWorld run, and destroys the device after ours. */
  VkInstance instance;
  VkPhysicalDevice physical_device;
  VkDevice device;
  VkQueue queue;
  uint32_t queue_family;
  /* Our own: "auto" (or NULL), "cpu" for a software device, or part of a name. */
  const char* device_name;
  uint32_t validate;     /* 1: under the Khronos layers; see formfieldValidationMessages */
  uint64_t memory_bytes; /* device memory to take at most; 0: no limit of our own */
} FormfieldVulkanSettings;

/* settings: NULL for a device of our own. Errors go to formfieldError(NULL). When the device is lost or full later on,
 * its worlds go on with the CPU: FormfieldStats::fallbacks. */
FormfieldResult formfieldCreateVulkanDevice(const FormfieldVulkanSettings* settings, FormfieldDevice* device);
/* Messages of the validation layers so far; the last of them as a line (may be NULL; valid until the next call). A
 * correct program has none. */
uint32_t formfieldValidationMessages(FormfieldDevice device, const char** last);

#ifdef __cplusplus
}
#endif
#endif
