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
  uint32_t size; /* sizeof(FormfieldVulkanSettings); what a smaller, older structure does not have is 0 */
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
  uint32_t frames_in_flight; /* for formfieldRecord; 0: 2 */
} FormfieldVulkanSettings;

/* settings: NULL for a device of our own. Errors go to formfieldError(NULL). When the device is lost or full later on,
 * its worlds go on with the CPU: FormfieldStats::fallbacks. */
FormfieldResult formfieldCreateVulkanDevice(const FormfieldVulkanSettings* settings, FormfieldDevice* device);
/* Messages of the validation layers so far; the last of them as a line (may be NULL; valid until the next call). A
 * correct program has none. */
uint32_t formfieldValidationMessages(FormfieldDevice device, const char** last);

/* formfieldFrame, but the device's part goes into the caller's command buffer, outside of a render pass, and nothing waits
 * for the device. Command buffers run once, in the order of their recording, on the queue of the device; before a world's
 * next call here the one recorded frames_in_flight calls ago has finished. What they write is visible to all later
 * commands. formfieldRadiosity, and with it formfieldSample, then lag by frames_in_flight frames
 * in what surfaces reflect.
 * gather and multibounce record. Leaves enter multibounce's dense matrix 256 a frame; those that wait are lit all the
 * same, as quickly as by gather. Its FormfieldStats lag by frames_in_flight frames. The matrix is watched by its residual
 * and, where the cut stands for frames_in_flight frames, by random vectors: it is built anew where they find it wrong.
 * FORMFIELD_ERROR_UNSUPPORTED: seed, which is a baseline, or the CPU has taken over; formfieldFrame works. */
FormfieldResult formfieldRecord(FormfieldWorld world, VkCommandBuffer commands, const double observer[3],
                                const float velocity[3]);
/* The same for several observers: formfieldFrameFor. */
FormfieldResult formfieldRecordFor(FormfieldWorld world, VkCommandBuffer commands, uint32_t count, const FormfieldObserver* observers);
/* Radiosity by slot, reflected and emitted, a vec4 each, W/m2 (w is 0), as the last recorded frame leaves it: a storage
 * buffer, always the same.
 * Null where formfieldRecord is unsupported. */
VkBuffer formfieldRadiosityBuffer(FormfieldWorld world);
/* What each slot reflects of light that arrives without a bounce, likewise: albedo * irradiance from direct light, the sky and
 * lamps (what a slot emits is not in it), from formfield.h's setters. A caller whose shaders know the direct light may write
 * it instead after each formfieldRecord: slots of tiles that enter come with their own, all slots where the light changes. */
VkBuffer formfieldSourceBuffer(FormfieldWorld world);

#ifdef __cplusplus
}
#endif
#endif
