// A strip as it stays in memory: its nodes, their lamps' light, and its rows in 16-bit words, grouped by row. A third smaller than the
// arrays of formats::Strip, in the order in which a local matrix is put together, and what crosses the bus to a GPU.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "formats/codec/chunk.h"
#include "formats/model.h"
#include "formats/result.h"

namespace ff::stream {

struct ResidentStrip : formats::RowWords {  // a run's partner: index into `partners`
  formats::TileId id;
  uint64_t first_node = 0;  // number of nodes[0] within its level
  formats::TileRef tile;    // where it stands in the world's index
  std::vector<formats::Node> nodes;
  struct Partner {
    uint32_t tile;   // of the strip's own level
    uint32_t chunk;  // that holds it: index into `chunks`
  };
  std::vector<Partner> partners;            // tiles ascending
  std::vector<formats::ChunkPtr> chunks;    // the index of all partners stays as long as the strip
  std::vector<formats::LampLight> lamps;       // what the nodes get of the lamps, by row
};

using StripPtr = std::shared_ptr<const ResidentStrip>;

// Takes the strip apart, but for its entries, which are `words`. chunks: of its partners.
ResidentStrip pack(formats::Strip&& strip, formats::RowWords&& words, const formats::TileRef& tile, std::span<formats::PartnerChunk> chunks);

// Bytes that a strip takes in memory.
uint64_t residentBytes(const ResidentStrip& strip);

}  // namespace ff::stream
