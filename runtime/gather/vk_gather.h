// The gather solver on Vulkan: sparse Jacobi iterations, one row per subgroup. No vulkan.h is needed to use it;
// vk_recorder.h is for those who record it into their own command buffers.
//
// What crosses the bus for a tile that enters are its packed rows (stream::ResidentStrip) and the pages that changed; rows
// are resolved on the device, where warm start, leaves and refined slots are found, too.
#pragma once
#include <cstdint>
#include <memory>

#include "runtime/solver/solver.h"
#include "runtime/vulkan/context.h"

namespace ff::runtime {

// Room taken at the start; nothing is allocated afterwards. What does not fit is an error with cause kOutOfDeviceMemory
// (a FallbackSolver then goes on with the CPU).
struct VulkanGatherSettings {
  uint32_t slots = 65536;
  uint32_t tiles = 4096;                      // active at once
  uint32_t pages = 16384;                     // of the page table: tiles that active rows have columns in
  uint64_t packed_bytes = uint64_t{32} << 20;
  uint64_t entry_bytes = uint64_t{64} << 20;
  uint32_t frames_in_flight = 2;              // vk_recorder.h
  // Entries are bound in ranges of at most so many bytes; 0: the device's maxStorageBufferRange (128 MiB on lavapipe).
  uint64_t max_binding_bytes = 0;
};

// Room for cuts of a world of at most so many slots, half as much again for fragmentation.
VulkanGatherSettings gatherRoomFor(const formats::World& world, uint32_t max_slots);

// Every call waits for the device. The context lives as long as the solver. Errors: shaders refused, out of memory.
Result<std::unique_ptr<Solver>> makeVulkanGather(std::shared_ptr<VkContext> context,
                                                 const VulkanGatherSettings& settings = {});

}  // namespace ff::runtime
