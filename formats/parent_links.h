// Parent links of one level as one bit per node: set where a node is the first child of a new parent. Siblings are
// consecutive and parents are in the order of their first children, so the parent's number is the rank of the bit.
// Jacobson. Space-efficient Static Trees and Graphs. 1989. 1.5 bits a node in memory.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

namespace ff::formats {

class ParentLinks {
 public:
  ParentLinks() = default;
  // words: bit i of word i / 64, lowest first; bits past `nodes` are zero; bit 0 is set.
  ParentLinks(std::vector<uint64_t> words, uint32_t nodes);

  uint32_t nodes() const { return nodes_; }
  uint32_t parents() const { return ranks_.empty() ? 0 : ranks_.back(); }
  bool startsParent(uint32_t node) const { return (words_[node / 64] >> (node % 64) & 1) != 0; }
  // Constant time. node < nodes().
  uint32_t parent(uint32_t node) const;
  // First and last + 1 child; logarithmic in the number of nodes. parent < parents().
  std::pair<uint32_t, uint32_t> children(uint32_t parent) const;

 private:
  uint32_t select(uint32_t rank) const;  // position of the set bit number `rank`, counted from 0

  std::vector<uint64_t> words_;
  std::vector<uint32_t> ranks_;  // set bits before word w; one more entry for all of them
  uint32_t nodes_ = 0;
};

}  // namespace ff::formats
