#include "runtime/formfield_vulkan.h"

#include <algorithm>

#include "runtime/fallback_solver.h"
#include "runtime/formfield_handles.h"
#include "runtime/vk_device.h"
#include "runtime/vk_gather.h"
#include "runtime/vk_multibounce.h"
#include "runtime/vk_seed.h"

namespace {

using namespace ff;
using namespace ff::runtime;

struct VulkanDevice final : FormfieldDevice_T {
  Result<WorldSolver> makeSolver(const formats::World& world, const SolverChoice& choice) override {
    if (choice.kind == SolverKind::kGather) {
      auto gather = makeVulkanGather(context, gatherRoomFor(world));
      return gather ? withFallback(std::move(*gather), nullptr) : withoutDevice(gather.error());
    }
    MultibounceSettings dense;
    dense.places = choice.places;
    dense.storage = choice.storage;
    dense.luminance = choice.luminance;
    const bool seed = choice.kind == SolverKind::kSeed;
    auto matrix = seed ? makeVulkanSeed(context, dense) : makeVulkanMultibounce(context, dense);
    if (!matrix) return withoutDevice(matrix.error());
    auto solver = makeDenseSolver(std::move(*matrix), {.correct = !seed});
    const DenseSolver* const known = solver.get();
    return withFallback(std::move(solver), known);
  }
  // A device that is lost or full from the start is no worse than one that gets there.
  static Result<WorldSolver> withoutDevice(const Error& error) {
    if (error.cause == ErrorCause::kOther) return error;
    auto reason = std::make_unique<std::string>(error.line());
    const std::string* const known = reason.get();
    return WorldSolver{makeCpuGather(), known, nullptr, std::move(reason)};
  }
  static Result<WorldSolver> withFallback(std::unique_ptr<Solver> first, const DenseSolver* dense) {
    auto solver = makeFallbackSolver(std::move(first), makeCpuGather());
    const std::string* const reason = &solver->reason();
    return WorldSolver{std::move(solver), reason, dense, nullptr};
  }
  std::shared_ptr<VkContext> context;
  std::string last_message;
};

Result<std::shared_ptr<VkContext>> contextOf(const FormfieldVulkanSettings& s) {
  const int given = (s.instance != VK_NULL_HANDLE) + (s.physical_device != VK_NULL_HANDLE) +
                    (s.device != VK_NULL_HANDLE) + (s.queue != VK_NULL_HANDLE);
  if (given == 4)
    return VkContext::adopt(s.instance, s.physical_device, s.device, s.queue_family, s.queue, s.memory_bytes);
  if (given != 0)
    return usageError("device", "instance, physical_device, device and queue go together", "give all four, or none");
  VulkanChoice choice;
  if (s.device_name) choice.device = s.device_name;
  choice.validate = s.validate != 0;
  choice.memory_bytes = s.memory_bytes;
  return openVulkan(choice);
}

}  // namespace

extern "C" {

FormfieldResult formfieldCreateVulkanDevice(const FormfieldVulkanSettings* settings, FormfieldDevice* device) {
  return guarded(errorOfThisThread(), [&]() -> Result<void> {
    if (!device) return usageError("device", "is NULL");
    *device = nullptr;
    FormfieldVulkanSettings s{};
    if (settings && settings->size != sizeof(s)) return usageError("size", "is not sizeof(FormfieldVulkanSettings)");
    if (settings) s = *settings;
    auto context = contextOf(s);
    if (!context) return context.error();
    auto made = std::make_unique<VulkanDevice>();
    made->context = std::move(*context);
    made->name = "vulkan: " + deviceName(*made->context);
    *device = made.release();
    return {};
  });
}

uint32_t formfieldValidationMessages(FormfieldDevice device, const char** last) {
  if (last) *last = "";
  auto* const vulkan = dynamic_cast<VulkanDevice*>(device);
  if (!vulkan) return 0;
  uint32_t count = 0;
  (void)guarded(vulkan->error, [&]() -> Result<void> {
    const auto messages = validationMessages(*vulkan->context);
    count = static_cast<uint32_t>(messages.size());
    vulkan->last_message = messages.empty() ? "" : messages.back();
    return {};
  });
  if (last) *last = vulkan->last_message.c_str();
  return count;
}

}  // extern "C"
