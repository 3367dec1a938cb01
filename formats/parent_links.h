// Links to parents that are in the order of their first children, as one bit a child: set where a child is the first of a new parent. So
// the parent's number is the rank of the bit. Used from tiles to the tiles of their nodes' parents, and from nodes to families (siblings).
// Jacobson. Space-efficient Static Trees and Graphs. 1989. 1.5 bits a child in memory.
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

// The parents of one level's nodes. The parents of a tile's nodes lie in one tile.
struct LevelLinks {
  ParentLinks tiles;            // from the level's tiles to those of the level above
  ParentLinks families;         // from its nodes to families, which are as many as the nodes of the level above
  std::vector<uint8_t> places;  // by family: index of the parent in its tile; ascending within a tile of the level
};

}  // namespace ff::formats
