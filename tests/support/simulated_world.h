// A world of any size in a few megabytes: flat, and alike everywhere. The records of chunks and strips depend on nothing outside
// themselves, so one of each level stands for all chunks of it; everything goes through the real codecs and the real index.
#pragma once
#include <cstdint>
#include <string>

#include "formats/result.h"

namespace ff::formats {

// levels: 1..15; a chunk has 16 tiles of 248 nodes at every level, four chunks lie in one of the next level, and one is at the top: of 10
// levels, 1.04e9 patches of 1 m, 16 km wide; of 12, 1.7e10; of 15, 2^32 tiles, which are too many. Writes PATH and its shards.
Result<void> writeSimulatedWorld(const std::string& path, uint32_t levels);

}  // namespace ff::formats
