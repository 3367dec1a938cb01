// Keeps a local matrix up to date as tiles enter and leave the cut. A tile that enters or leaves costs its own rows and
// those of the active tiles that have columns where slots changed; no other row is touched. Within the capacity taken
// at the start an update allocates nothing.
#pragma once
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/cut/packed_rows.h"
#include "runtime/cut/page_table.h"
#include "runtime/cut/range_allocator.h"

namespace ff::runtime {

class MatrixAssembler {
 public:
  // The world must outlive the assembler. max_slots: up to kMaxSlots; memory is taken for so many, or for all of the world.
  explicit MatrixAssembler(const formats::World& world, FarLight far_light = FarLight::kPyramid, uint32_t max_slots = kMaxSlots);
  MatrixAssembler(const MatrixAssembler&) = delete;
  MatrixAssembler& operator=(const MatrixAssembler&) = delete;

  // Brings the matrix to the cut `active` (sorted, as Streamer::active()) and holds its strips. The same cut again
  // changes nothing. fading: tiles of it, sorted, that need not be there: where one that enters finds no consecutive slots, as many as it takes go at once, those that show least first,
  // rather than that all slots are given out anew; and what is not in the matrix does not enter. Errors (kUsage), matrix unchanged: more than max_slots nodes; not a cut (a top-level tile is
  // missing). A tile without its parent tile stands alone (local_matrix.h); where that comes or goes the tile enters anew.
  Result<void> update(std::span<const stream::StripPtr> active, std::span<const FadingTile> fading = {});

  // What the last update() changed, ready for a device: MatrixChange::packed, until the next one.
  void pack();

  // Gives the matrix away for another, and takes it back likewise: in between the assembler is not used. Allocates nothing.
  void swap(LocalMatrix& matrix) { std::swap(matrix_, matrix); }

  // For tests: the next update() gives slots out anew.
  void renumberNext() { renumber_next_ = true; }

  const LocalMatrix& matrix() const { return matrix_; }
  const MatrixChange& change() const { return change_; }  // of the last update
  // By number in LocalMatrix::tiles.
  const stream::ResidentStrip& strip(size_t tile) const { return *tiles_[tile].strip; }

  // The matrix alone, without what only the assembler keeps alive.
  LocalMatrix take() && {
    matrix_.packed.clear();
    matrix_.places.clear();
    matrix_.pages = nullptr;
    return std::move(matrix_);
  }

 private:
  struct Tile {
    SlotRange range;
    stream::StripPtr strip;
    Box bounds{};
    formats::TileName name;
    uint64_t first_entry = 0, room = 0;  // in LocalMatrix::entries
    uint64_t first_partner = 0, first_run = 0;  // in partner_pages_ and run_entries_
    bool entered = false, placed = false, linked = false;  // linked: its parent tile is active, too
  };
  std::span<uint32_t> partnerPages(const Tile& tile) {
    return std::span(partner_pages_).subspan(tile.first_partner, tile.strip->partners.size());
  }
  Result<void> check(std::span<const stream::StripPtr> active) const;
  void chooseKept(std::span<const stream::StripPtr> active);
  void diff(std::span<const stream::StripPtr> active);
  void drop(Tile& tile);
  bool place(Tile& tile);
  bool makeRoom(const Tile& tile);
  const FadingTile* findFading(formats::TileId id) const;  // null: it is not
  bool reserveRanges(Tile& tile);
  void releaseRanges(Tile& tile);
  void renumber();
  void link(Tile& tile);
  void makeLeaf(uint32_t slot);
  uint32_t resolveRuns(const Tile& tile, uint32_t first, uint32_t end, uint32_t word, uint32_t* out);
  void resolveRow(Tile& tile, uint32_t row);
  bool updateRow(Tile& tile, uint32_t row);
  void pad(uint32_t slot);
  void resolveRows();
  void listLeavesAndRefined();

  const formats::World& world_;
  FarLight far_light_;
  const uint32_t max_slots_;
  LocalMatrix matrix_;
  MatrixChange change_;
  PackedChange packed_;
  bool renumber_next_ = false;
  PageTable pages_;
  const uint64_t entry_capacity_;
  RangeAllocator slots_, entries_, partners_, runs_;
  std::vector<Tile> tiles_, next_tiles_;
  std::span<const FadingTile> fading_;  // of the update under way
  std::vector<uint8_t> kept_;            // by number in `active`: the tile was there, and so were the tiles above it
  std::vector<uint32_t> partner_pages_;  // of a tile: by index in strip->partners
  std::vector<uint16_t> run_entries_;    // of a tile: by run, entries that it takes in its row
  std::vector<uint32_t> new_leaves_;  // slots
  struct Column {                     // of a partner tile, for the tile being resolved
    const PageTable::Page* page;
    bool changed;
  };
  std::vector<Column> columns_;
  std::vector<uint32_t> scratch_;
};

}  // namespace ff::runtime
