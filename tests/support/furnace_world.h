// A closed world in balance: every patch sees every other one equally, so that all rows, both directions of every pair
// and the pyramid's sums are known in closed form. For tests of what is physics and what is not.
#pragma once
#include "tests/support/random_world.h"

namespace ff::formats {

// patches: even, 4..512. Level 0: unit areas, Q = patches - 1, one quantum to each other patch. Level 1: pairs of them,
// two quanta to each other pair and one to itself.
inline RandomWorld makeFurnaceWorld(uint32_t patches) {
  RandomWorld w;
  w.strips.resize(2);
  w.bounds.resize(2);
  w.parents.resize(1);
  const Box box{{0, 0, 0}, {8, 8, 8}};
  for (uint32_t level = 0; level < 2; ++level) {
    const uint32_t nodes = level == 0 ? patches : patches / 2;
    for (uint32_t first = 0; first < nodes; first += kTileNodes) {
      Strip s;
      s.id = {level, first / kTileNodes};
      s.first_node = first;
      for (uint32_t i = first; i < nodes && i < first + kTileNodes; ++i) {
        Node n;
        n.area_m2 = level == 0 ? 1.0f : 2.0f;
        const uint32_t k = level == 0 ? i : 2 * i;
        n.centroid = {static_cast<float>(k % 8), static_cast<float>(k / 8 % 8), static_cast<float>(k / 64)};
        n.albedo = {0.5f, 0.5f, 0.5f};
        n.emission = {level == 0 ? static_cast<float>(i % 2) : 0.5f, 0, 0};  // every second patch shines
        n.quanta = patches - 1;
        s.nodes.push_back(n);
        if (level == 0) w.parents[0].push_back(i / 2);
      }
      for (uint32_t column = 0; column < nodes; column += kTileNodes) {
        Block block{column / kTileNodes, 0};
        for (uint32_t i = first; i < first + s.nodes.size(); ++i)
          for (uint32_t j = column; j < nodes && j < column + kTileNodes; ++j) {
            if (level == 0 && i == j) continue;
            s.rows.push_back(static_cast<uint8_t>(i - first));
            s.columns.push_back(static_cast<uint8_t>(j - column));
            s.counts.push_back(level == 0 || i == j ? 1 : 2);
            ++block.entries;
          }
        s.blocks.push_back(block);
      }
      w.strips[level].push_back(std::move(s));
      w.bounds[level].push_back(box);
    }
  }
  w.info.bounds = box;
  w.info.quanta = patches - 1;
  w.info.area_m2 = patches;
  w.info.generator = "furnace_world";
  w.info.scene = "furnace";
  return w;
}

}  // namespace ff::formats
