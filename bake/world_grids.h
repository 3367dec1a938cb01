// What a bake knows of the world's cells as OpenVDB grids, for other tools (ffbake --write-vdb; vdb_print, Houdini, Blender). The only file that
// sees OpenVDB.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "bake/surface/hilbert.h"
#include "formats/model.h"
#include "formats/result.h"

namespace ff::bake {

// Writes a .vdb file of two grids: `patches` (int32), how many patches lie in each cell of level 0; `chunks` (mask), the occupied chunks of level 0,
// a voxel each. Both in metres of the source's world space. cells: of each patch, in any order. Errors: kIo.
Result<void> writeWorldGrids(const std::string& path, std::span<const Cell> cells, float cell_m, const std::array<double, 3>& origin);

}  // namespace ff::bake
