// The form factors that nodes bring along when they enter a dense matrix, from the sparse rows of the local matrix.
//
// Among leaves F_ij is the sum over the columns J of row i of F_iJ times the share of leaf j in J: 1 where J is j, and
// the product of area fractions down the tree where j is below a refined J. An entry between two leaves never changes
// while both stay leaves: J resolves to its nearest active ancestor-or-self, which is either j itself (then j being a
// leaf means that nothing below j is active), or an ancestor of j (active as long as j is), and the shares depend on
// the tree alone, not on the cut. So a change of the cut only ever adds and drops rows and columns.
#pragma once
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

inline constexpr uint32_t kNoPlace = 0xffffffffu;

class EnteringBlocks {
 public:
  EnteringBlocks();
  // Call after every change of the matrix. It must stay where it is until the next call.
  void takeUp(const LocalMatrix& matrix);

  // One scan of the rows for all nodes that are to enter, in the order of matrix.leaves. place_of_slot: kNoPlace for
  // those that are not in yet.
  void collect(std::span<const uint32_t> entering, std::span<const uint32_t> place_of_slot);
  // Entering nodes [first, first + count), which place_of_slot now gives places, among those that are in. The block
  // lives until the next call.
  EnteringBlock block(uint32_t first, uint32_t count, std::span<const uint32_t> place_of_slot);

 private:
  struct Entry {
    uint32_t slot;
    float value;
  };
  void spread(uint32_t slot, float value, bool all);

  const LocalMatrix* matrix_ = nullptr;
  std::span<const uint32_t> place_of_slot_;
  std::vector<uint32_t> refined_of_;  // per slot: number in matrix.refined, or none
  std::vector<uint32_t> entering_;    // slots
  std::vector<uint32_t> number_;      // per slot: in entering_, or none
  std::vector<uint8_t> leads_;        // per slot: itself or something below it enters
  std::vector<float> sum_;            // per slot: of the row at hand
  std::vector<uint32_t> met_;         // slots with a sum
  std::vector<uint32_t> row_start_;   // per entering node
  std::vector<Entry> rows_;           // by row: columns that are in or enter
  struct Met {
    uint32_t number, receiver;
    float value;
  };
  std::vector<Met> columns_met_;
  std::vector<uint32_t> column_start_;
  std::vector<Entry> columns_;  // by entering node: receivers that are in or enter
  // The block.
  std::vector<uint32_t> places_, block_row_start_, block_columns_, block_column_start_, receivers_;
  std::vector<float> row_values_, column_values_;
  std::vector<Vec4> albedo_;
};

}  // namespace ff::runtime
