// The rows of a level, tile by tile: put aside as they are made, and got back by whoever gathers or samples them.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/matrix/pool.h"
#include "bake/matrix/row_samples.h"
#include "bake/spill.h"
#include "formats/model.h"

namespace ff::bake {

struct NodeRow {
  formats::Node node;  // area, centroid, normal, albedo, emission, lamp group, parent
  Box bounds;
  LightValues direct{};
  ExchangeRow row;
};

class LevelRows {
 public:
  // density: HitPool's, of patches, whose rows are kept exactly: as hits; empty: of clusters, whose exchange areas are kept as floats.
  // Both outlive it.
  LevelRows(size_t tiles, std::span<const double> density, Spill& spill) : density_(density), spill_(spill), tile_(tiles) {}
  // Rows of all nodes of a tile. Thread-safe for different tiles.
  void put(uint32_t tile, uint32_t first_node, std::span<const NodeRow> rows);
  // Thread-safe.
  std::vector<NodeRow> get(uint32_t tile) const;

 private:
  struct Tile {
    uint32_t first_node = 0;
    Spill::Block block;
  };
  const std::span<const double> density_;
  Spill& spill_;
  std::vector<Tile> tile_;
};

}  // namespace ff::bake
