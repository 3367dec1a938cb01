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

struct GridPatch {
  Cell cell;
  float square_error;  // PatchSight's
};

// Writes a .vdb file of three grids: `patches` (int32), how many patches lie in each cell of level 0; `error` (float), how far the light that rays bring
// them is off, relative, at most, for 99 of 100 (light/row_error.h); `chunks` (mask), the occupied chunks of level 0, a voxel each. All in
// metres of the source's world space. patches: in any order. Errors: kIo.
Result<void> writeWorldGrids(const std::string& path, std::span<const GridPatch> patches, float cell_m, const std::array<double, 3>& origin);

}  // namespace ff::bake
