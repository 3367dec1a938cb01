// A strip's bytes: header (records.h) and one zstd frame whose content is described by StripLayout. The decoder is part
// of the reading library, the encoder (encodeStrip, writer.h) of the writing one.
#pragma once
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"

namespace ff::formats {

// Offsets of the arrays in a strip's raw payload. Multi-byte values are stored as byte planes: the lowest bytes of all
// elements, then the next ones, so that equal high bytes form runs.
struct StripLayout {
  // Bytes per node, in this order: area f32, centroid 3 x u16, normal 2 x i16, albedo 3 x u16, emission 3 x f32,
  // quanta u16, sky u16, absorbed u16, sky direction 3 x i8, sky quadratic 5 x i8, sky fraction u16, row total u16,
  // lamp group u16, lamps u16.
  static constexpr uint32_t kNodeBytes = 54;
  // step to a chunk of partner tiles 3 x i32, blocks in it u32
  static constexpr uint32_t kChunkBytes = 16;
  // partner tile step u16, runs - 1 u8
  static constexpr uint32_t kBlockBytes = 3;
  // row step - 1 u8, words - 1 u16
  static constexpr uint32_t kRunBytes = 3;
  // group u16, weights 3 x u16
  static constexpr uint32_t kLampBytes = 8;

  uint32_t nodes = 0, chunks = 0, blocks = 0;
  // What the header does not tell: the sums of the nodes' lamps, of the blocks' runs and of the runs' words. A run is the entries of one
  // row in one block, an entry a word or more (RowWords).
  uint32_t lamps = 0, runs = 0, words = 0;
  uint64_t area() const { return 0; }
  uint64_t centroid() const { return uint64_t{4} * nodes; }
  uint64_t normal() const { return uint64_t{10} * nodes; }
  uint64_t albedo() const { return uint64_t{14} * nodes; }
  uint64_t emission() const { return uint64_t{20} * nodes; }
  uint64_t quanta() const { return uint64_t{32} * nodes; }
  uint64_t sky() const { return uint64_t{34} * nodes; }
  uint64_t absorbed() const { return uint64_t{36} * nodes; }
  uint64_t skyDirection() const { return uint64_t{38} * nodes; }
  uint64_t skyQuadratic() const { return uint64_t{41} * nodes; }
  uint64_t skyFraction() const { return uint64_t{46} * nodes; }
  uint64_t rowTotal() const { return uint64_t{48} * nodes; }
  uint64_t lampGroup() const { return uint64_t{50} * nodes; }
  uint64_t lampCount() const { return uint64_t{52} * nodes; }
  uint64_t lampGroups() const { return uint64_t{kNodeBytes} * nodes; }
  uint64_t lampWeights() const { return lampGroups() + uint64_t{2} * lamps; }
  uint64_t chunkSteps() const { return lampGroups() + uint64_t{kLampBytes} * lamps; }
  uint64_t chunkBlocks() const { return chunkSteps() + uint64_t{12} * chunks; }
  uint64_t blockSteps() const { return chunkSteps() + uint64_t{kChunkBytes} * chunks; }
  uint64_t blockRuns() const { return blockSteps() + uint64_t{2} * blocks; }
  uint64_t rowSteps() const { return blockSteps() + uint64_t{kBlockBytes} * blocks; }
  uint64_t runWords() const { return rowSteps() + runs; }
  // A column byte for each word: those of the runs' first words before all others. Then a count for each word.
  uint64_t firstColumns() const { return rowSteps() + uint64_t{kRunBytes} * runs; }
  uint64_t columnSteps() const { return firstColumns() + runs; }
  uint64_t counts() const { return firstColumns() + words; }
  uint64_t end() const { return counts() + words; }
};

// Fractions of 0..1 with a relative precision of 2^-12 in 16 bits: 5 bits of exponent, 11 of mantissa. Codes above that of 1
// are invalid. What a row's total is stored as: its sixteenth.
inline constexpr uint16_t kFractionOne = 31 << 11;
inline constexpr float kRowTotalUnit = 16;
inline constexpr float kLampWeightUnit = 2;  // of a lamp's weights, likewise: an estimate of 1 may lie above
uint16_t packFraction(float v);  // clamps; nearest, ties to even
inline float unpackFraction(uint16_t code) {
  if (code >> 11 == 0) return static_cast<float>(code) * 0x1p-41f;
  return std::bit_cast<float>((uint32_t{code} + (uint32_t{127 - 31} << 11)) << 12);
}

// A cut of the unit sphere into 65535^2 directions: the octahedral map (Meyer et al. On Floating-Point Normal Vectors.
// 2010) with both coordinates as signed 16-bit fixed point. The zero vector is kZeroNormal in both.
inline constexpr int16_t kZeroNormal = -32768;
struct OctNormal {
  int16_t u = 0, v = 0;
};
OctNormal packNormal(Vec3 n);
inline Vec3 unpackNormal(OctNormal n) {
  if (n.u == kZeroNormal || n.v == kZeroNormal) return {};
  const float x = static_cast<float>(n.u) / 32767.0f, y = static_cast<float>(n.v) / 32767.0f;
  const float z = 1.0f - std::abs(x) - std::abs(y);
  if (z >= 0) return normalized({x, y, z});
  return normalized({std::copysign(1.0f - std::abs(y), x), std::copysign(1.0f - std::abs(x), y), z});
}

// A partner tile as a strip names it.
struct PartnerName {
  ChunkCell step{};       // from the strip's own chunk
  uint32_t tile = 0;      // number within that
  uint32_t columns = 0;   // the largest column of its block, + 1
};

// Decodes one strip. `info` is the index's; `quanta` is the world's. Fills everything but Node::parent and Block::partner_tile;
// partners: by block. words: takes the entries instead of out.rows, columns and counts, which are left empty then; or null. `out`'s vectors and those of words are reused; after an error its content is unspecified. Memory taken is
// bounded by the sizes in `info`, which are checked against the header first. Thread-safe.
// Errors carry no file name: the caller knows it.
Result<void> decodeStripBytes(const TileInfo& info, uint32_t quanta, std::span<const std::byte> stored, Strip& out,
                              std::vector<PartnerName>& partners, RowWords* words = nullptr);

}  // namespace ff::formats
