// One number per tile of a world, level by level: what turns a map over tiles into an array.
#pragma once
#include <cstdint>
#include <vector>

#include "formats/reader.h"

namespace ff::stream {

class TileNumbers {
 public:
  explicit TileNumbers(const formats::World& world) {
    for (const formats::LevelInfo& level : world.levels()) {
      first_.push_back(tiles_);
      tiles_ += level.tiles;
    }
  }
  uint32_t of(formats::TileId id) const { return first_[id.level] + id.tile; }
  uint32_t tiles() const { return tiles_; }

 private:
  std::vector<uint32_t> first_;  // of each level
  uint32_t tiles_ = 0;
};

}  // namespace ff::stream
