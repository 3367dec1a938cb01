// What the light of lamps depends on, as digests: for each branch of the tree of lamps of all that emits in it (R. C. Merkle. A digital signature based on a
// conventional encryption function. 1987), for a patch of the branches that its rays are aimed at. Equal digests: the same rays towards lamps, with the same weights.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "bake/light/lamp_tree.h"
#include "bake/plan/contents.h"

namespace ff::bake {

class LampDigests {
 public:
  // All outlive it. Memory: some 16 bytes a patch that emits.
  LampDigests(const LampTree& lamps, const PatchSet& set, const Contents& contents);

  // Of all lamps; 0: there are none.
  uint64_t all() const { return of_node_.empty() ? 0 : of_node_[0]; }
  // Of those that light a patch, and of those that rays of its row end on, as columns of its row, whether they still emit or not. Thread-safe.
  uint64_t of(uint32_t patch, std::span<const uint32_t> met) const;

 private:
  const LampTree& lamps_;
  const PatchSet& set_;
  PagedVector<uint64_t> of_node_;
};

}  // namespace ff::bake
