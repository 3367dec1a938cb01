// The tiles of the next cut: those that are wanted, and those of the cut before that still show something of their own, which fade out (cut_fade.h).
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

// One thread. Nothing takes memory after the start.
class CutChoice {
 public:
  // max_nodes: of tiles that fade out; past it those that show least leave at once. max_slots: of the matrix.
  CutChoice(uint32_t max_nodes, uint32_t max_slots);

  // active: as Streamer::active(). before: the cut before, sorted likewise; tiles: of its matrix; own: by tile of these, how much of what it shows is its own, or empty: then nothing
  // stays that is not active. The cut, and what of it fades out, both sorted, replace what is in the last two.
  void choose(std::span<const stream::StripPtr> active, std::span<const stream::StripPtr> before, std::span<const SlotRange> tiles, std::span<const float> own,
              std::vector<stream::StripPtr>& cut, std::vector<FadingTile>& fading);

 private:
  struct Leaving {  // a tile of the cut before that is not active
    uint32_t at;    // in `before`
    FadingTile tile;
    formats::TileId parent;
    uint32_t nodes;
    bool kept;
  };
  void listLeaving(std::span<const stream::StripPtr> active, std::span<const stream::StripPtr> before, std::span<const SlotRange> tiles, std::span<const float> own);
  void keepTheMost(std::span<const stream::StripPtr> active);

  const uint32_t max_nodes_, max_slots_;
  std::vector<Leaving> leaving_;
  std::vector<uint32_t> order_;  // of leaving_
};

}  // namespace ff::runtime
