// Which sides of pieces make up a patch together: those of one cell of one grid, orientation class and lamp group that are connected.
#pragma once
#include <cstdint>
#include <span>
#include <tuple>
#include <vector>

#include "bake/paging.h"
#include "bake/surface/fences.h"
#include "bake/surface/sealed.h"
#include "bake/work_count.h"

namespace ff::bake {

struct Side {
  uint64_t key;         // hilbertKey of the base cell
  uint32_t orientation;
  uint16_t lamp_group;
  int16_t fineness;
  uint16_t in_cell;     // placeInBaseCell() of the cell of its own grid
  uint32_t piece;
  uint32_t back;        // 1: the back of a double-sided piece
  // Sides of one place may share a patch: those of one cell of one grid. What emits nothing comes first.
  auto place() const { return std::tuple(key, orientation, static_cast<uint16_t>(lamp_group + 1), fineness, in_cell); }
  friend bool operator<(const Side& a, const Side& b) {
    return std::tuple_cat(a.place(), std::tuple(a.piece, a.back)) < std::tuple_cat(b.place(), std::tuple(b.piece, b.back));
  }
};

struct Labels {
  PagedVector<uint32_t> patch_of;  // per side; kSealed: it has none
  PagedVector<uint32_t> home;      // per patch: a side in its cell
  PagedVector<uint8_t> doublings;  // per patch: how often its cell is doubled, by merging.h; empty: none is
};

inline constexpr uint32_t kSealed = 0xfffffffe;

// Pieces that touch are connected, and those near a fence where they see each other across a border they share. A component under
// crumb_fraction of its cell's face is a crumb: it joins what its surface goes on in across the border of its cell; else the nearest
// patch of its place, unless a fence parts them and it is not small; near a fence, one that it sees, there or nearby; crumbs that come to
// next to nothing, any patch nearby. done: counts sides, if not null. sides: sorted. fences, sealed: null where nothing is parted, nothing sealed.
Labels labelSides(const PieceList& pieces, std::span<const Side> sides, double crumb_fraction, const Fences* fences,
                  const SealedSurface* sealed, WorkCount* done = nullptr);

}  // namespace ff::bake
