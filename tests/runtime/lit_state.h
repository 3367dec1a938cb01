// The state of an updater as something to compare.
#pragma once
#include <gtest/gtest.h>

#include <map>
#include <utility>
#include <vector>

#include "runtime/updater.h"

namespace ff::runtime {

using LitState = std::map<std::pair<uint32_t, uint64_t>, std::vector<float>>;  // by level and node

// Of every node of the cut, from its row and its light to the bits that twenty steps from darkness come to.
inline LitState stateOf(Updater& updater, Solver& solver) {
  const LocalMatrix& m = updater.matrix();
  std::vector<Vec4> radiosity(m.slots());
  EXPECT_TRUE(solver.setRadiosity(radiosity));
  EXPECT_TRUE(solver.iterate(20));
  EXPECT_TRUE(solver.radiosity(radiosity));
  LitState state;
  for (const SlotRange& range : m.tiles)
    for (uint32_t i = 0; i < range.nodes; ++i) {
      const uint32_t slot = range.first_slot + i;
      const Vec4 b = radiosity[slot], s = updater.source()[slot], e = updater.emission()[slot];
      state[{range.id.level, range.first_node + i}] = {b.x, b.y, b.z, s.x, s.y, s.z, e.x, e.y, e.z, static_cast<float>(m.leaf[slot]), static_cast<float>(m.row(slot).size())};
    }
  return state;
}

}  // namespace ff::runtime
