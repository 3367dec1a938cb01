// From a grid cell to the tile of its first patch, as a NanoVDB grid. The only file that sees OpenVDB.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "bake/surface/hilbert.h"

namespace ff::bake {

// Bytes of a NanoVDB Int32 grid: the value at a cell is its tile's number + 1; 0 (inactive) where there is no patch. Of
// several entries for one cell the first counts.
std::vector<std::byte> buildSpatialIndex(std::span<const std::pair<Cell, uint32_t>> cell_tiles, float cell_m);

}  // namespace ff::bake
