#include "stream/resident_strip.h"

#include <algorithm>
#include <string>

namespace ff::stream {
namespace {

constexpr uint32_t kMaxCount = 255;  // of one word
constexpr uint32_t kMost16 = 0xffff;

uint32_t wordsOf(uint32_t count) { return (count + kMaxCount - 1) / kMaxCount; }

// Calls run(row, first entry, end) for the entries of a block that share a row.
template <class Run>
void forEachRun(const formats::Strip& strip, size_t first, size_t end, Run&& run) {
  for (size_t k = first; k < end;) {
    const size_t from = k;
    while (k < end && strip.rows[k] == strip.rows[from]) ++k;
    run(strip.rows[from], from, k);
  }
}

}  // namespace

Result<ResidentStrip> pack(formats::Strip&& strip, const formats::TileRef& tile, std::span<const formats::ChunkPtr> chunks) {
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
  uint32_t longest = 0;
  size_t at = 0;
  for (const formats::Block& block : strip.blocks) {
    const formats::ChunkPtr& chunk = chunks[packed.partners.size()];
    if (packed.chunks.empty() || packed.chunks.back() != chunk) packed.chunks.push_back(chunk);
    packed.partners.push_back({block.partner_tile, static_cast<uint32_t>(packed.chunks.size() - 1)});
    forEachRun(strip, at, at + block.entries, [&](uint8_t row, size_t from, size_t end) {
      uint32_t n = 0;
      for (size_t k = from; k < end; ++k) n += wordsOf(strip.counts[k]);
      packed.row_start[row + 1u] += n;
      packed.run_start[row + 1u] += 1;
      longest = std::max(longest, n);
    });
    at += block.entries;
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
  at = 0;
  for (size_t b = 0; b < strip.blocks.size(); ++b) {
    forEachRun(strip, at, at + strip.blocks[b].entries, [&](uint8_t row, size_t from, size_t end) {
      const uint32_t first = next_word[row];
      uint32_t word = first;
      for (size_t k = from; k < end; ++k)
        for (uint32_t left = strip.counts[k]; left > 0;) {
          const uint32_t count = std::min(left, kMaxCount);
          packed.words[word++] = static_cast<uint16_t>(uint32_t{strip.columns[k]} << 8 | count);
          left -= count;
        }
      packed.row_partners[row] |= uint64_t{1} << b % 64;
      packed.runs[next_run[row]++] = {static_cast<uint16_t>(b), static_cast<uint16_t>(word - first)};
      next_word[row] = word;
    });
    at += strip.blocks[b].entries;
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
