// The local matrix: form factors among the nodes of the cut, resolved through the page table.
//
// Every node of an active tile has a slot, and keeps it while the tile is active. A slot is a *leaf* (its children are
// not active: it is a node of the cut, and its own level's row lights it) or *refined* (its radiosity is the
// area-weighted mean of its children's). The nodes of a tile whose parent tile is not active (it could not be read) stand alone: what is theirs
// resolves to them, and what is their parents' to the next ancestor, which stays a leaf. A column node J of a row resolves to J's slot if J's tile is active, else to
// the slot of its nearest active ancestor. So strips are never rewritten when the cut changes; and but for the numbers
// of its slots the matrix is a function of the cut alone.
#pragma once
#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/read/reader.h"
#include "shaders/shared.h"
#include "stream/resident_strip.h"

namespace ff::runtime {

struct Vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};
// The same to a processor that has registers for it.
using Float4 = float __attribute__((vector_size(16), aligned(4), may_alias));
inline Float4& asFloat4(Vec4& v) { return reinterpret_cast<Float4&>(v); }
inline const Float4& asFloat4(const Vec4& v) { return reinterpret_cast<const Float4&>(v); }
// Of three channels; w is 0.
inline Vec4 operator*(const Vec4& a, const Vec4& b) { return {a.x * b.x, a.y * b.y, a.z * b.z, 0}; }
inline Vec4 operator+(const Vec4& a, const Vec4& b) { return {a.x + b.x, a.y + b.y, a.z + b.z, 0}; }

// What a node reflects, W/m2, of the irradiance of which its parent reflects so much; `otherwise`, by channel, where the parent's albedo is 0.
inline Vec4 onAlbedo(const Vec4& parent, const Vec4& parent_albedo, const Vec4& albedo, const Vec4& otherwise) {
  const Float4 from = asFloat4(parent_albedo), one{1, 1, 1, 1};
  const auto reflects = from > 0;
  Vec4 here;
  asFloat4(here) = reflects ? asFloat4(parent) / (reflects ? from : one) * asFloat4(albedo) : asFloat4(otherwise);
  here.w = 0;
  return here;
}

inline constexpr uint32_t kNoSlot = 0xffffffffu;
inline constexpr uint32_t kRowPadding = 8;    // entries: what a vector loop takes at once
inline constexpr uint32_t kPartEntries = 16384;  // of a part handed to a thread: some 10 us, fine enough to share out evenly

// An entry of a row: the slot of its column, and how many of the row's samples fall there.
inline constexpr uint32_t kMaxSlots = 1u << (32 - shaders::kCountBits);
static_assert(formats::kMaxQuanta <= shaders::kCountMask);
constexpr uint32_t packEntry(uint32_t slot, uint32_t count) { return slot << shaders::kCountBits | count; }
constexpr uint32_t slotOfEntry(uint32_t entry) { return entry >> shaders::kCountBits; }
constexpr uint32_t countOfEntry(uint32_t entry) { return entry & shaders::kCountMask; }

struct SlotRange {
  formats::TileId id;
  uint32_t first_slot = 0;
  uint64_t first_node = 0;
  uint32_t nodes = 0;
};

// Slot of a node, kNoSlot if its tile is not among `tiles` (sorted). O(log tiles).
uint32_t slotOf(std::span<const SlotRange> tiles, uint32_t level, uint64_t node);
// The slot that stands for node number `index` of a tile: its own, else its nearest ancestor's; kNoSlot where no tile of these is among `tiles`.
uint32_t slotFor(std::span<const SlotRange> tiles, const formats::TileRef& tile, uint32_t index);

class PageTable;

struct LocalMatrix {
  std::vector<SlotRange>
      tiles;  // sorted by (level, tile); their slots are consecutive within a tile, in any order of tiles
  // Per slot; free slots are neither leaf nor refined and have empty rows.
  // A row is entries[row_start[s] .. + row_entries[s]): F = countOfEntry() * row_scale[s]. Its columns
  // are in the order of their nodes; a coarse one may come several times, for other nodes that it stands for.
  // Only leaves have any. A row begins at a multiple of kRowPadding and is filled up to one with entries of count 0.
  std::vector<uint32_t> row_start, row_entries;
  std::vector<float> row_scale;  // 1 / Q
  std::vector<Vec4> albedo;      // rgb and 0
  std::vector<float> area_m2;
  std::vector<uint8_t> leaf;
  std::vector<uint32_t> parent_slot;  // kNoSlot at the top level, and of nodes that stand alone
  // Per slot with a parent: the next child of that, in ascending order; of the last one, the first. So the last is known by its next
  // not being behind it.
  std::vector<uint32_t> next_sibling;
  std::vector<float> child_weight;    // per slot with a parent: its area over that of the parent's children; equal where none has any
  std::vector<uint32_t> entries;      // with gaps between rows
  std::vector<uint32_t> leaves;       // slots, in the order of `tiles`
  std::vector<uint32_t> changed_leaves;  // those whose rows the last update changed or brought; empty: not known
  std::vector<uint32_t> leaf_parts{0};  // where parts of `leaves` begin whose rows have about kPartEntries entries; last = leaves.size()
  // Refined slots, level by level from the finest up, so that a pass in order finds its children done.
  struct Refined {
    uint32_t slot, first_child, last_child;  // from the first to the last by next_sibling
  };
  std::vector<Refined> refined;
  std::vector<uint32_t> refined_level_start;  // ranges of `refined` that may be done in parallel; last = refined.size()
  uint32_t ambient_slot = kNoSlot;            // FarLight::kConstant: the slot of all that is far
  uint64_t used_entries = 0;                  // of all rows together
  uint32_t most_slots = 0;                    // that there will ever be; 0: unknown
  // For devices that resolve rows themselves; by tile. Empty in a matrix made by hand.
  struct PackedRows {
    const stream::ResidentStrip* strip;
    std::span<const uint32_t> partner_pages;  // number of the page (page_table.h) of each of the strip's partners
  };
  std::vector<PackedRows> packed;
  struct Place {
    Box bounds;   // of a tile's patches, m
    formats::TileName name;
    bool linked;  // the tile above is there, too: its nodes have parents
  };
  std::vector<Place> places;  // by tile; likewise
  const PageTable* pages = nullptr;  // the assembler's

  uint32_t slots() const { return static_cast<uint32_t>(albedo.size()); }  // the highest ever used + 1
  // Calls child(slot) for each of a refined slot's, in ascending order.
  template <class Child>
  void forEachChild(const Refined& of, Child&& child) const {
    for (uint32_t c = of.first_child;; c = next_sibling[c]) {
      child(c);
      if (c == of.last_child) return;
    }
  }
  std::span<const uint32_t> row(uint32_t slot) const { return {entries.data() + row_start[slot], row_entries[slot]}; }
  uint32_t slotOf(uint32_t level, uint64_t node) const { return runtime::slotOf(tiles, level, node); }
};

// Slots for cuts of at most so many wanted nodes (stream::StreamSettings::max_nodes): an eighth is for what fades, and so that what enters finds consecutive ones.
constexpr uint32_t slotsFor(uint32_t max_nodes) { return static_cast<uint32_t>(std::min(uint64_t{max_nodes} * 8 / 7, uint64_t{kMaxSlots})); }

// Touches memory for so many values, so that no frame has the system find its pages, some microseconds for each.
template <class T>
void touchMemory(std::vector<T>& values, size_t most) {
  const size_t size = values.size();
  if (most <= size) return;
  values.resize(most);
  values.resize(size);
}

// These fill in child_weight and leaf_parts, from everything else.
void weighChildren(LocalMatrix& matrix);
void divideLeaves(LocalMatrix& matrix);

// A tile that may leave at any time.
struct FadingTile {
  formats::TileId id;
  float weight = 0;  // of what it shows, or its descendants, so much is their own
  float hurry = 0;   // of the fastest pace, that it leaves at least at: to make room
};

class PackedChange;

// What an update of the matrix changed, for those who keep something by slot.
struct MatrixChange {
  bool any = false;
  bool renumbered = false;          // slots were given out anew: nothing kept by slot is worth anything
  std::vector<SlotRange> left{};    // their slots are free now, or taken by tiles that entered
  std::vector<uint32_t> entered{};  // numbers in LocalMatrix::tiles, the coarsest level first
  std::vector<uint32_t> rows{};   // numbers in LocalMatrix::tiles: tiles with rows that changed, entered ones included
  std::vector<uint32_t> pages{};  // numbers of pages that changed (page_table.h)
  const PackedChange* packed = nullptr;  // what entered and these pages, ready for a device (packed_rows.h); null: nobody has written it
};

// How columns outside the active level-0 tiles are treated.
enum class FarLight {
  kPyramid,   // the coarser levels: the product
  kConstant,  // one ambient slot, the seed paper's choice; only level-0 tiles take part. For comparison.
};

// A matrix from nothing; matrix_assembler.h keeps one up to date. active: as Streamer::active(). Errors: as
// MatrixAssembler::update.
Result<LocalMatrix> buildLocalMatrix(const formats::World& world, std::span<const stream::StripPtr> active,
                                     FarLight far_light = FarLight::kPyramid);

}  // namespace ff::runtime
