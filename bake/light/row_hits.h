// The patches that one patch's rays end on.
#pragma once
#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/rays/sobol.h"
#include "bake/scene.h"

namespace ff::bake {

class RowHits {
 public:
  struct Entry {
    uint32_t patch;
    std::array<uint32_t, 2> hits{};      // of the first and of the second half of the rays
    std::array<double, 2> stand_for{};   // rays
    double estimate = 0;                 // what all stand for, as geometry tells; 0: it does not, and they stand for themselves
    bool whole = false;                  // HitRows::whole
    uint32_t count() const { return hits[0] + hits[1]; }
  };

  void begin(size_t rays) {
    place_.assign(std::bit_ceil(2 * rays), kNone);
    entries_.clear();
  }
  void add(uint32_t patch, int half) {
    size_t at = mix64(patch) & (place_.size() - 1);
    while (place_[at] != kNone && entries_[place_[at]].patch != patch) at = (at + 1) & (place_.size() - 1);
    uint32_t& place = place_[at];
    if (place == kNone) {
      place = static_cast<uint32_t>(entries_.size());
      entries_.push_back({patch});
    }
    ++entries_[place].hits[static_cast<size_t>(half)];
  }
  std::span<Entry> entries() { return entries_; }  // may be sorted once all are added

 private:
  std::vector<uint32_t> place_;  // by hash, in entries_
  std::vector<Entry> entries_;
};

}  // namespace ff::bake
