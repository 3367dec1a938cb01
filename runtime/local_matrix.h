// The local matrix: form factors among the nodes of the cut, resolved through the page table.
//
// Every node of an active tile has a slot. A slot is a *leaf* (its children are not active: it is a node of the cut,
// and its own level's row lights it) or *refined* (its radiosity is the area-weighted mean of its children's). A column
// node J of a row resolves to J's slot if J's tile is active, else to the slot of its nearest active ancestor. So
// strips are never rewritten when the cut changes, and the matrix is a function of the cut alone.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "formats/reader.h"

namespace ff::runtime {

struct Vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};

inline constexpr uint32_t kNoSlot = 0xffffffffu;
inline constexpr uint32_t kMaxSlots = 65536;  // a packed entry has 16 bits of column

// Tiles in order (level, tile); slots are numbered in that order, without gaps.
struct SlotRange {
  formats::TileId id;
  uint32_t first_slot = 0;
  uint32_t first_node = 0;
  uint32_t nodes = 0;
};

struct LocalMatrix {
  std::vector<SlotRange> tiles;
  // CSR over slots; refined slots have empty rows. entry = column slot << 16 | count; F = count * row_scale[row].
  std::vector<uint32_t> row_start;  // slots + 1
  std::vector<uint32_t> entries;
  std::vector<float> row_scale;  // 1 / Q
  // Refined slots, level by level from the finest up, so that a pass in order finds its children done.
  struct Refined {
    uint32_t slot, first_child, children;  // children are consecutive slots
  };
  std::vector<Refined> refined;
  std::vector<uint32_t> refined_level_start;  // ranges of `refined` that may be done in parallel; last = refined.size()
  std::vector<Vec4> albedo;                   // per slot, rgb and 0
  std::vector<float> area_m2;                 // per slot
  std::vector<uint8_t> leaf;                  // per slot

  uint32_t slots() const { return static_cast<uint32_t>(albedo.size()); }
  // Slot of a node, kNoSlot if its tile is not active. O(log tiles).
  uint32_t slotOf(uint32_t level, uint32_t node) const;
};

// How columns outside the active level-0 tiles are treated.
enum class FarLight {
  kPyramid,   // the coarser levels: the product
  kConstant,  // one ambient slot (the last), the seed paper's choice; only level-0 tiles take part. For comparison.
};

// active: as Streamer::active(). Errors: more than kMaxSlots slots.
Result<LocalMatrix> buildLocalMatrix(const formats::World& world,
                                     std::span<const std::shared_ptr<const formats::Strip>> active,
                                     FarLight far_light = FarLight::kPyramid);

}  // namespace ff::runtime
