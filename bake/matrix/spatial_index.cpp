#include "bake/matrix/spatial_index.h"

#include <nanovdb/util/OpenToNanoVDB.h>
#include <openvdb/openvdb.h>

#include <cstring>

namespace ff::bake {

std::vector<std::byte> buildSpatialIndex(std::span<const std::pair<Cell, uint32_t>> cell_tiles, float cell_m) {
  openvdb::initialize();
  openvdb::Int32Grid::Ptr grid = openvdb::Int32Grid::create(0);
  grid->setName("tile_of_cell");
  // Voxel (i, j, k) is cell (i, j, k): its corner, not its centre, lies at cell * cell_m.
  auto transform = openvdb::math::Transform::createLinearTransform(static_cast<double>(cell_m));
  transform->postTranslate(openvdb::Vec3d(static_cast<double>(cell_m) / 2));
  grid->setTransform(transform);
  auto accessor = grid->getAccessor();
  for (const auto& [cell, tile] : cell_tiles) {
    const openvdb::Coord c(cell[0], cell[1], cell[2]);
    if (!accessor.isValueOn(c)) accessor.setValueOn(c, static_cast<int32_t>(tile) + 1);
  }
  // No statistics (they would be min and max of tile numbers) and a full checksum.
  auto handle = nanovdb::openToNanoVDB(*grid, nanovdb::StatsMode::BBox, nanovdb::ChecksumMode::Full);
  std::vector<std::byte> bytes(handle.size());
  std::memcpy(bytes.data(), handle.data(), bytes.size());
  return bytes;
}

}  // namespace ff::bake
