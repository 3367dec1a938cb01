// Cost on the device of nodes that enter and leave the dense matrices, and of a tile that enters the cut.
#pragma once
#include <string>

namespace ff::bench {

// Prints update.block_speedup_over_single and update.tile_apply_ms for backend vulkan, by the device's own clock; a line
// on standard error where there is no device. Software devices get small matrices: they are no measure of a GPU.
// world_path: as printTileApply.
void printVulkanUpdates(const std::string& world_path, bool quick);

}  // namespace ff::bench
