// Local matrices made by hand for tests of solvers, without a world.
#pragma once
#include "runtime/solver/solver.h"

namespace ff::runtime {

// row_start has one item more than there are slots, rows follow each other, and so do children of one slot; fills in what can be told from that.
inline void finishByHand(LocalMatrix& m) {
  const uint32_t slots = m.slots();
  m.row_entries.resize(slots);
  m.parent_slot.assign(slots, kNoSlot);
  m.leaves.clear();
  m.used_entries = m.entries.size();
  std::vector<uint32_t> padded;
  for (uint32_t s = 0; s < slots; ++s) {
    const uint32_t begin = m.row_start[s], end = m.row_start[s + 1];
    m.row_start[s] = static_cast<uint32_t>(padded.size());
    m.row_entries[s] = end - begin;
    padded.insert(padded.end(), m.entries.begin() + begin, m.entries.begin() + end);
    padded.resize((padded.size() + kRowPadding - 1) / kRowPadding * kRowPadding, 0);
    if (m.leaf[s]) m.leaves.push_back(s);
  }
  m.row_start.pop_back();
  m.entries = std::move(padded);
  m.next_sibling.assign(slots, kNoSlot);
  for (const LocalMatrix::Refined& r : m.refined)
    for (uint32_t c = r.first_child; c <= r.last_child; ++c) {
      m.parent_slot[c] = r.slot;
      m.next_sibling[c] = c < r.last_child ? c + 1 : r.first_child;
    }
  weighChildren(m);
  divideLeaves(m);
}

// A new matrix to a solver, and radiosity to start from (empty: zero).
inline Result<void> setMatrix(Solver& solver, const LocalMatrix& matrix, std::span<const Vec4> warm_start = {}) {
  if (auto taken = solver.update(matrix, {.any = true, .renumbered = true}); !taken) return taken;
  return warm_start.empty() ? Result<void>() : solver.setRadiosity(warm_start);
}

}  // namespace ff::runtime
