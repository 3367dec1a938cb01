// Which leaves of a cut sit on which places of a dense matrix: the bookkeeping of every solver on one (dense_solver.h,
// vk_dense_step.h). Leaves keep their places while they stay, whatever slots they are given; the finest levels enter
// first.
#pragma once
#include <span>
#include <vector>

#include "runtime/dense/entering_blocks.h"

namespace ff::runtime {

// No call allocates after construction, but for what EnteringBlocks says.
class CutPlaces {
 public:
  explicit CutPlaces(uint32_t capacity);

  // Takes up a change of the cut; afresh: nothing is known of the one before, and all places are free. The matrix stays
  // where it is until the next call. Returns the places that are given up: the caller removes them from its matrix.
  // They live until the next call of giveUp() or update(). Slots that were refused may try again.
  std::span<const uint32_t> update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh);
  // All places are free: the dense matrix was cleared.
  void clear();
  // A leaf leaves its place and, until the cut changes, is left to the sparse rows. Adds to what update() returned.
  void giveUp(uint32_t place);
  std::span<const uint32_t> givenUp() const { return leaving_; }
  void forgetGivenUp() { leaving_.clear(); }

  // The rest reads the matrix again, which must still be that of update().
  // Leaves that may enter now, up to `most` and as many as there are places; numbered from 0 for take().
  uint32_t choose(uint64_t most);
  // Gives places to chosen leaves [first, first + count), in order, and describes them as a block, which lives until
  // the next call.
  EnteringBlock take(uint32_t first, uint32_t count);
  // Takes the places of the last block back: its nodes go on waiting, or the matrix has refused them and they are left
  // to the sparse rows until the cut changes.
  void unseat(uint32_t first, uint32_t count, bool refused);

  uint32_t slotOf(uint32_t place) const { return slot_of_place_[place]; }  // kNoSlot: free
  uint32_t placeOf(uint32_t slot) const { return place_of_slot_[slot]; }   // kNoPlace: none
  std::span<const uint32_t> slots() const { return slot_of_place_; }       // by place
  uint32_t taken() const { return taken_; }
  // Leaves without a place that were not refused.
  uint32_t waiting() const { return waiting_; }

 private:
  void leave(uint32_t slot);
  void renumber();

  EnteringBlocks blocks_;
  const LocalMatrix* matrix_ = nullptr;
  std::vector<SlotRange> tiles_before_;
  std::vector<uint32_t> place_of_slot_, old_place_, slot_of_place_;
  std::vector<uint8_t> refused_;  // per slot
  std::vector<uint32_t> leaving_, entering_;
  uint32_t leaves_ = 0, taken_ = 0, waiting_ = 0, next_free_ = 0;
};

}  // namespace ff::runtime
