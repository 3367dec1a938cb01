// The patches that one patch's rays end on.
#pragma once
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/rays/sobol.h"
#include "bake/scene.h"

namespace ff::bake {

// Of the rays of a row, those of the first half.
inline size_t firstHalf(size_t rays) { return (rays + 1) / 2; }

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
    half_ = firstHalf(rays);
    place_.assign(std::bit_ceil(2 * rays), kNone);
    entries_.clear();
  }
  // A ray, by its number, that ends on a patch.
  void add(uint32_t patch, size_t ray) {
    size_t at = mix64(patch) & (place_.size() - 1);
    while (place_[at] != kNone && entries_[place_[at]].patch != patch) at = (at + 1) & (place_.size() - 1);
    uint32_t& place = place_[at];
    if (place == kNone) {
      place = static_cast<uint32_t>(entries_.size());
      entries_.push_back({patch});
    }
    ++entries_[place].hits[ray >= half_];
  }
  std::span<Entry> entries() { return entries_; }  // may be sorted once all are added

 private:
  size_t half_ = 0;              // rays of the first
  std::vector<uint32_t> place_;  // by hash, in entries_
  std::vector<Entry> entries_;
};

}  // namespace ff::bake
