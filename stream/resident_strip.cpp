#include "stream/resident_strip.h"

#include <algorithm>
#include <string>

namespace ff::stream {
namespace {

constexpr uint32_t kMost16 = 0xffff;

}  // namespace

Result<ResidentStrip> pack(formats::Strip&& strip, const formats::EntryWords& words, const formats::TileRef& tile, std::span<const formats::ChunkPtr> chunks) {
  ResidentStrip packed;
  packed.tile = tile;
  packed.id = strip.id;
  packed.first_node = strip.first_node;
  packed.nodes = std::move(strip.nodes);
  packed.lamps = std::move(strip.lamps);
  const size_t rows = packed.nodes.size();
  packed.partners.reserve(strip.blocks.size());
  packed.run_start.assign(rows + 1, 0);
  packed.row_start.assign(rows + 1, 0);
  for (const formats::Block& block : strip.blocks) {
    const formats::ChunkPtr& chunk = chunks[packed.partners.size()];
    if (packed.chunks.empty() || packed.chunks.back() != chunk) packed.chunks.push_back(chunk);
    packed.partners.push_back({block.partner_tile, static_cast<uint32_t>(packed.chunks.size() - 1)});
  }
  uint32_t longest = 0;
  for (const auto& run : words.runs) {
    packed.row_start[run.row + 1u] += run.words;
    packed.run_start[run.row + 1u] += 1;
    longest = std::max(longest, run.words);
  }
  if (packed.partners.size() > kMost16 || longest > kMost16)
    return Error{
        ErrorCode::kInvalidFile, "", "tile " + std::to_string(packed.id.level) + ":" + std::to_string(packed.id.tile),
        "a strip with more than 65535 partner tiles or words in a run cannot be streamed", "bake with larger patches"};
  for (size_t r = 0; r < rows; ++r) {
    packed.run_start[r + 1] += packed.run_start[r];
    packed.row_start[r + 1] += packed.row_start[r];
  }
  packed.runs.resize(packed.run_start[rows]);
  packed.words.resize(packed.row_start[rows]);
  packed.row_partners.assign(rows, 0);

  std::vector<uint32_t> next_run(packed.run_start), next_word(packed.row_start);
  const auto* run = words.runs.data();
  const uint16_t* from = words.words.data();
  for (size_t b = 0; b < strip.blocks.size(); ++b)
    for (uint32_t left = words.block_runs[b]; left > 0; --left, ++run) {
      uint16_t* to = packed.words.data() + next_word[run->row];
      for (uint32_t k = 0; k < run->words; ++k) to[k] = from[k];
      from += run->words;
      packed.row_partners[run->row] |= uint64_t{1} << b % 64;
      packed.runs[next_run[run->row]++] = {static_cast<uint16_t>(b), static_cast<uint16_t>(run->words)};
      next_word[run->row] += run->words;
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
