// Maps and sets over the tiles that are near: nothing is as large as the world. Within what was reserved no call allocates.
#pragma once
#include <tsl/robin_map.h>
#include <tsl/robin_set.h>

#include <cstddef>
#include <cstdint>

#include "formats/model.h"

namespace ff::stream {

struct TileHash {
  // Finalizer of MurmurHash3, Austin Appleby.
  size_t operator()(formats::TileId id) const {
    uint64_t h = (uint64_t{id.level} << 32 | id.tile) + 0x9e3779b97f4a7c15ull;
    h = (h ^ h >> 33) * 0xff51afd7ed558ccdull;
    h = (h ^ h >> 33) * 0xc4ceb9fe1a85ec53ull;
    return static_cast<size_t>(h ^ h >> 33);
  }
};

template <class T>
using TileMap = tsl::robin_map<formats::TileId, T, TileHash>;
using TileSet = tsl::robin_set<formats::TileId, TileHash>;

}  // namespace ff::stream
