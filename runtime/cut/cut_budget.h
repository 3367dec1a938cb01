// At most so many tiles enter the matrix in a frame: what follows a tile that enters, on the frame's thread, is light, source and emission of its nodes and the
// solver's tables.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "formats/read/reader.h"
#include "stream/observers.h"
#include "stream/resident_strip.h"

namespace ff::runtime {

// One thread. Nothing takes memory after the start.
class CutBudget {
 public:
  // tiles: 0: as many as there are. The world outlives it.
  CutBudget(const formats::World& world, uint32_t tiles);

  // Of the tiles of `wanted`, those of `there`, and as many others as may enter: the nearest by distance over the cells of their level, so that parents
  // are first. All lists are cuts, sorted by (level, tile); the result is valid until the next call.
  std::span<const stream::StripPtr> limit(std::span<const stream::StripPtr> wanted, std::span<const stream::StripPtr> there, const stream::Observers& observers);
  // Tiles that the last limit() kept back.
  uint32_t waiting() const { return waiting_; }

 private:
  struct Entering {
    float nearness;
    uint32_t at;  // in `wanted`
  };
  const formats::World& world_;
  const uint32_t tiles_;
  uint32_t waiting_ = 0;
  std::vector<Entering> entering_;
  std::vector<uint8_t> kept_;  // by number in `wanted`
  std::vector<stream::StripPtr> cut_;
};

}  // namespace ff::runtime
