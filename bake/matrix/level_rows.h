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
  // Exchange areas are kept as floats. spill: outlives it.
  LevelRows(size_t tiles, Spill& spill) : spill_(spill), tile_(tiles) {}
  // Rows of all nodes of a tile. Thread-safe for different tiles.
  void put(uint32_t tile, std::span<const NodeRow> rows);
  // Fills `rows`, reusing its memory. Thread-safe.
  void get(uint32_t tile, std::vector<NodeRow>& rows) const;

 private:
  Spill& spill_;
  std::vector<Spill::Block> tile_;
};

}  // namespace ff::bake
