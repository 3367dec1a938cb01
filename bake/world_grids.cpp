#include "bake/world_grids.h"

#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>

#include <cmath>

#include "bake/light/row_error.h"

namespace ff::bake {
namespace {

// Voxel (i, j, k) is a cell: its corner, not its centre, lies at i, j, k times its edge.
openvdb::math::Transform::Ptr cellsOf(double edge_m, const std::array<double, 3>& origin) {
  auto transform = openvdb::math::Transform::createLinearTransform(edge_m);
  transform->postTranslate(openvdb::Vec3d(origin[0] + edge_m / 2, origin[1] + edge_m / 2, origin[2] + edge_m / 2));
  return transform;
}

}  // namespace

Result<void> writeWorldGrids(const std::string& path, std::span<const GridPatch> patches, float cell_m, const std::array<double, 3>& origin) try {
  openvdb::initialize();
  const auto counts = openvdb::Int32Grid::create(0);
  counts->setName("patches");
  counts->setTransform(cellsOf(static_cast<double>(cell_m), origin));
  const auto errors = openvdb::FloatGrid::create(0);  // sums of squares at first
  errors->setName("error");
  errors->setTransform(cellsOf(static_cast<double>(cell_m), origin));
  const auto chunks = openvdb::MaskGrid::create(false);
  chunks->setName("chunks");
  chunks->setTransform(cellsOf(static_cast<double>(cell_m) * formats::kChunkCells, origin));
  auto count = counts->getAccessor();
  auto error = errors->getAccessor();
  auto occupied = chunks->getAccessor();
  for (const auto& [cell, square_error] : patches) {
    const openvdb::Coord c(cell[0], cell[1], cell[2]);
    count.setValueOn(c, count.getValue(c) + 1);
    error.setValueOn(c, error.getValue(c) + square_error);
    occupied.setValueOn(openvdb::Coord(cell[0] >> formats::kChunkLog, cell[1] >> formats::kChunkLog, cell[2] >> formats::kChunkLog));
  }
  for (auto cell = errors->beginValueOn(); cell; ++cell)
    cell.setValue(kNearlyAll * std::sqrt(*cell / static_cast<float>(count.getValue(cell.getCoord()))));
  openvdb::io::File file(path);
  file.write({counts, errors, chunks});
  file.close();
  return {};
} catch (const std::exception& e) {
  return Error{ErrorCode::kIo, path, "", std::string("cannot be written: ") + e.what(), "name a file in a folder that can be written"};
}

}  // namespace ff::bake
