#include "stream/resident_strip.h"

#include <utility>

namespace ff::stream {

ResidentStrip pack(formats::Strip&& strip, formats::RowWords&& words, const formats::TileRef& tile, std::span<formats::PartnerChunk> chunks) {
  ResidentStrip packed;
  static_cast<formats::RowWords&>(packed) = std::move(words);
  packed.tile = tile;
  packed.id = strip.id;
  packed.first_node = strip.first_node;
  packed.nodes = std::move(strip.nodes);
  packed.lamps = std::move(strip.lamps);
  packed.partners.reserve(strip.blocks.size());
  packed.chunks.reserve(chunks.size());
  for (auto& [chunk, end_block] : chunks) {
    for (size_t b = packed.partners.size(); b < end_block; ++b) packed.partners.push_back({strip.blocks[b].partner_tile, static_cast<uint32_t>(packed.chunks.size())});
    packed.chunks.push_back(std::move(chunk));
  }
  return packed;
}

uint64_t residentBytes(const ResidentStrip& strip) {
  return sizeof(ResidentStrip) + strip.nodes.size() * sizeof(formats::Node) + strip.partners.size() * sizeof(ResidentStrip::Partner) + strip.chunks.size() * sizeof(formats::ChunkPtr) +
         strip.run_start.size() * 4 + strip.row_start.size() * 4 + strip.row_partners.size() * 8 +
         strip.runs.size() * sizeof(ResidentStrip::Run) + strip.words.size() * 2 +
         strip.lamps.size() * sizeof(formats::LampLight);
}

}  // namespace ff::stream
