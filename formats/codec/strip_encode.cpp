#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <initializer_list>
#include <memory>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"
#include "formats/codec/records.h"
#include "formats/codec/strip_codec.h"
#include "formats/codec/zstd_context.h"
#include "formats/write/writer.h"

namespace ff::formats {
namespace {

// No reader depends on these. Measured on a town of 60k, bytes of a strip an entry and ns an entry to compress: level 3 1.081 and 23,
// level 3 with this strategy 1.050 and 35, with btlazy2 1.047 and 59, level 6 1.066 and 38. Tracing the rays of an entry takes
// microseconds.
constexpr ZSTD_strategy kZstdStrategy = ZSTD_lazy2;

Error unfit(const Strip& strip, const std::string& message) {
  return {ErrorCode::kPhysics, "", "strip " + std::to_string(strip.id.level) + ":" + std::to_string(strip.id.tile),
          message, ""};
}

template <class T>
void putPlanes(std::byte* p, size_t n, size_t i, T value) {
  for (size_t k = 0; k < sizeof(T); ++k) p[k * n + i] = static_cast<std::byte>((value >> (8 * k)) & 0xff);
}

void putFloat(std::byte* p, size_t n, size_t i, float v) { putPlanes(p, n, i, std::bit_cast<uint32_t>(v)); }

bool finite(Vec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

uint16_t unorm16(float v) { return static_cast<uint16_t>(std::lround(std::clamp(v, 0.0f, 1.0f) * 65535.0f)); }

// Position within the tile's bounds, as a fraction of them. A flat extent yields 0.
uint16_t packCoordinate(float v, float lo, float hi) {
  if (!(hi > lo)) return 0;
  return static_cast<uint16_t>(std::lround(
      std::clamp((static_cast<double>(v) - lo) / (static_cast<double>(hi) - lo), 0.0, 1.0) * 65535.0));
}

// Rounds to n/127 per component, and never to more than length 1: a direction of full length is pulled in by the largest
// component, which costs the least.
std::array<int, 3> packDirection(Vec3 d) {
  std::array<int, 3> q{};
  for (int c = 0; c < 3; ++c) q[static_cast<size_t>(c)] = static_cast<int>(std::lround(std::clamp(d[c], -1.0f, 1.0f) * 127.0f));
  while (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] > 127 * 127) {
    size_t largest = 0;
    for (size_t c = 1; c < 3; ++c)
      if (std::abs(q[c]) > std::abs(q[largest])) largest = c;
    q[largest] += q[largest] > 0 ? -1 : 1;
  }
  return q;
}

Result<void> checkNode(const Strip& strip, size_t i, const Box& bounds) {
  const Node& n = strip.nodes[i];
  const auto bad = [&](const char* what) { return unfit(strip, "node " + std::to_string(i) + ": " + what); };
  if (!(n.area_m2 > 0) || !std::isfinite(n.area_m2)) return bad("area is not a positive number");
  if (!finite(n.centroid) || !finite(n.normal) || !finite(n.emission) || !finite(n.sky_direction))
    return bad("a field is not finite");
  for (int c = 0; c < 3; ++c) {
    if (!(n.albedo[c] >= 0) || !(n.albedo[c] <= 1)) return bad("albedo is outside 0..1");
    if (!(n.emission[c] >= 0) || !(n.emission[c] <= kMaxEmission)) return bad("emission is not 0..1e12 W/m2");
    // A mean of positions may leave their bounds by rounding, not by more.
    const float slack = 1e-3f * (bounds.hi[c] - bounds.lo[c]) + 1e-5f * std::abs(n.centroid[c]) + 1e-6f;
    if (n.centroid[c] < bounds.lo[c] - slack || n.centroid[c] > bounds.hi[c] + slack)
      return bad("centroid lies outside the tile's bounds");
  }
  if (length(n.sky_direction) > 1.001f) return bad("sky direction is longer than 1");
  for (const float mean : n.sky_quadratic)
    if (!(std::abs(mean) <= 1.001f)) return bad("a mean of the sky's quadratics is outside -1..1");
  if (!(n.sky_fraction >= 0) || !(n.sky_fraction <= 1)) return bad("sky fraction is outside 0..1");
  if (!(n.row_total >= 0)) return bad("row total is negative");
  if (n.quanta > kMaxQuanta || n.sky > kMaxQuanta || n.absorbed > kMaxQuanta) return bad("more than 16383 quanta");
  return {};
}

// Order, ranges and closure of the entries.
Result<void> checkEntries(const Strip& strip) {
  const size_t entries = strip.rows.size();
  if (strip.blocks.size() > kMaxBlocks) return unfit(strip, "has more than 65535 partner tiles; bake with larger patches");
  if (strip.columns.size() != entries || strip.counts.size() != entries)
    return unfit(strip, "rows, columns and counts differ in number");
  std::array<uint64_t, kTileNodes> sums{};
  size_t e = 0;
  for (size_t b = 0; b < strip.blocks.size(); ++b) {
    const Block& block = strip.blocks[b];
    const auto bad = [&](const char* what) {
      return unfit(strip, "block of partner tile " + std::to_string(block.partner_tile) + ": " + what);
    };
    if (b > 0 && block.partner_tile <= strip.blocks[b - 1].partner_tile) return bad("blocks are not in order");
    if (block.entries < 1 || block.entries > 65536 || block.entries > entries - e) return bad("entry count is wrong");
    for (size_t k = 0; k < block.entries; ++k, ++e) {
      if (strip.rows[e] >= strip.nodes.size()) return bad("a row is outside the tile");
      if (strip.counts[e] == 0) return bad("a count is zero");
      if (k > 0 && (strip.rows[e] < strip.rows[e - 1] ||
                    (strip.rows[e] == strip.rows[e - 1] && strip.columns[e] <= strip.columns[e - 1])))
        return bad("entries are not in order of row and column");
      sums[strip.rows[e]] += strip.counts[e];
    }
  }
  if (e != entries) return unfit(strip, "blocks do not add up to the strip's entries");
  for (size_t i = 0; i < strip.nodes.size(); ++i)
    if (sums[i] + strip.nodes[i].sky + strip.nodes[i].absorbed != strip.nodes[i].quanta)
      return unfit(strip, "row " + std::to_string(i) + " does not close");
  return {};
}

Result<void> checkLamps(const Strip& strip) {
  for (size_t k = 0; k < strip.lamps.size(); ++k) {
    const LampLight& lamp = strip.lamps[k];
    const auto bad = [&](const char* what) { return unfit(strip, "lamp light " + std::to_string(k) + ": " + what); };
    if (lamp.row >= strip.nodes.size()) return bad("its row is outside the tile");
    if (lamp.group == kNoLampGroup) return bad("has no group");
    if (k > 0 && std::pair(lamp.row, lamp.group) <= std::pair(strip.lamps[k - 1].row, strip.lamps[k - 1].group))
      return bad("is not in order of row and group");
    for (int c = 0; c < 3; ++c)
      if (!(lamp.weight[c] >= 0) || !(lamp.weight[c] <= kLampWeightUnit)) return bad("its weight is outside 0..2");
  }
  return {};
}

// Green and blue are told as steps from red, which are zero for lamps of one colour.
void putLamps(std::byte* raw, const StripLayout& layout, const Strip& strip) {
  const size_t n = layout.lamps;
  std::array<uint16_t, kTileNodes> count{};
  for (size_t k = 0; k < n; ++k) {
    const LampLight& lamp = strip.lamps[k];
    ++count[lamp.row];
    putPlanes(raw + layout.lampGroups(), n, k, lamp.group);
    const uint16_t red = packFraction(lamp.weight.x / kLampWeightUnit);
    putPlanes(raw + layout.lampWeights(), n, k, red);
    for (int c = 1; c < 3; ++c)
      putPlanes(raw + layout.lampWeights() + 2 * n * static_cast<size_t>(c), n, k,
                static_cast<uint16_t>(packFraction(lamp.weight[c] / kLampWeightUnit) - red));
  }
  for (size_t i = 0; i < layout.nodes; ++i) putPlanes(raw + layout.lampCount(), layout.nodes, i, count[i]);
}

void putNode(std::byte* raw, const StripLayout& layout, size_t i, const Node& node, const Box& bounds) {
  const size_t n = layout.nodes;
  putFloat(raw + layout.area(), n, i, node.area_m2);
  const OctNormal normal = packNormal(node.normal);
  putPlanes(raw + layout.normal(), n, i, static_cast<uint16_t>(normal.u));
  putPlanes(raw + layout.normal() + 2 * n, n, i, static_cast<uint16_t>(normal.v));
  const std::array<int, 3> direction = packDirection(node.sky_direction);
  for (size_t c = 0; c < 3; ++c) {
    const int k = static_cast<int>(c);
    putPlanes(raw + layout.centroid() + 2 * n * c, n, i, packCoordinate(node.centroid[k], bounds.lo[k], bounds.hi[k]));
    putPlanes(raw + layout.albedo() + 2 * n * c, n, i, unorm16(node.albedo[k]));
    putFloat(raw + layout.emission() + 4 * n * c, n, i, node.emission[k] + 0.0f);  // + 0: no negative zero
    putPlanes(raw + layout.skyDirection() + n * c, n, i, static_cast<uint8_t>(direction[c]));
  }
  putPlanes(raw + layout.quanta(), n, i, static_cast<uint16_t>(node.quanta));
  putPlanes(raw + layout.sky(), n, i, static_cast<uint16_t>(node.sky));
  putPlanes(raw + layout.absorbed(), n, i, static_cast<uint16_t>(node.absorbed));
  for (size_t k = 0; k < node.sky_quadratic.size(); ++k)
    putPlanes(raw + layout.skyQuadratic() + n * k, n, i,
              static_cast<uint8_t>(std::lround(std::clamp(node.sky_quadratic[k], -1.0f, 1.0f) * 127.0f)));
  putPlanes(raw + layout.skyFraction(), n, i, packFraction(node.sky_fraction));
  putPlanes(raw + layout.rowTotal(), n, i, packFraction(node.row_total / kRowTotalUnit));
  putPlanes(raw + layout.lampGroup(), n, i, node.lamp_group);
}

bool sameChunk(std::span<const TileName> names, const Block& a, const Block& b) { return names[a.partner_tile].chunk == names[b.partner_tile].chunk; }

// In how many chunks the partner tiles lie.
uint32_t countChunks(const Strip& strip, std::span<const TileName> names) {
  uint32_t chunks = 0;
  for (size_t b = 0; b < strip.blocks.size(); ++b) chunks += b == 0 || !sameChunk(names, strip.blocks[b - 1], strip.blocks[b]);
  return chunks;
}

void putChunks(std::byte* raw, const StripLayout& layout, const Strip& strip, std::span<const TileName> names) {
  const size_t n = layout.chunks;
  for (size_t b = 0, c = 0; b < strip.blocks.size(); ++c) {
    const size_t first = b;
    while (b < strip.blocks.size() && sameChunk(names, strip.blocks[first], strip.blocks[b])) ++b;
    for (size_t a = 0; a < 3; ++a)
      putPlanes(raw + layout.chunkSteps() + 4 * n * a, n, c,
                static_cast<uint32_t>(names[strip.blocks[first].partner_tile].chunk[a]) - static_cast<uint32_t>(names[strip.id.tile].chunk[a]));
    putPlanes(raw + layout.chunkBlocks(), n, c, static_cast<uint32_t>(b - first));
  }
}

uint32_t wordsOf(uint32_t count) { return (count + kMaxWordCount - 1) / kMaxWordCount; }

// The first entry behind the run that begins with e. end: of its block.
size_t runEnd(const Strip& strip, size_t e, size_t end) {
  const uint8_t row = strip.rows[e];
  while (e < end && strip.rows[e] == row) ++e;
  return e;
}

// Sets runs and words.
void countRuns(const Strip& strip, StripLayout& layout) {
  size_t e = 0;
  for (const Block& block : strip.blocks)
    for (const size_t end = e + block.entries; e < end; ++layout.runs)
      for (const size_t run_end = runEnd(strip, e, end); e < run_end; ++e) layout.words += wordsOf(strip.counts[e]);
}

void putEntries(std::byte* raw, const StripLayout& layout, const Strip& strip, std::span<const TileName> names) {
  std::byte *steps = raw + layout.columnSteps(), *counts = raw + layout.counts();
  size_t e = 0, run = 0;
  for (size_t b = 0; b < strip.blocks.size(); ++b) {
    const Block& block = strip.blocks[b];
    const uint32_t before = b > 0 && sameChunk(names, strip.blocks[b - 1], block) ? names[strip.blocks[b - 1].partner_tile].tile : 0;
    putPlanes(raw + layout.blockSteps(), layout.blocks, b, static_cast<uint16_t>(names[block.partner_tile].tile - before));
    const size_t first_run = run;
    uint32_t row = 0, first_column = 0;  // row: the one behind that of the run before
    for (const size_t end = e + block.entries; e < end; ++run) {
      putPlanes(raw + layout.rowSteps(), layout.runs, run, static_cast<uint8_t>(strip.rows[e] - row));
      row = strip.rows[e] + 1u;
      putPlanes(raw + layout.firstColumns(), layout.runs, run, static_cast<uint8_t>(strip.columns[e] - first_column));
      uint32_t column = first_column = strip.columns[e];
      uint32_t words = 0;
      for (const size_t run_end = runEnd(strip, e, end); e < run_end; ++e)
        for (uint32_t left = strip.counts[e]; left > 0; ++words) {
          if (words > 0) *steps++ = static_cast<std::byte>(strip.columns[e] - column);
          column = strip.columns[e];
          const uint32_t count = std::min(left, kMaxWordCount);
          *counts++ = static_cast<std::byte>(count);
          left -= count;
        }
      putPlanes(raw + layout.runWords(), layout.runs, run, static_cast<uint16_t>(words - 1));
    }
    putPlanes(raw + layout.blockRuns(), layout.blocks, b, static_cast<uint8_t>(run - first_run - 1));
  }
}

// One frame, but a block of its own for each kind of stream: their statistics differ, and zstd has one Huffman table a
// block. Worth 3 % of the size. ends: offsets in `raw` at which blocks end; the last is raw.size().
bool compressStreams(std::span<const std::byte> raw, std::initializer_list<uint64_t> ends, std::vector<std::byte>& out) {
  thread_local std::unique_ptr<ZSTD_CCtx, FreeZstdContext> context(ZSTD_createCCtx());
  ZSTD_CCtx* c = context.get();
  if (c == nullptr || ZSTD_isError(ZSTD_CCtx_reset(c, ZSTD_reset_session_and_parameters)) ||
      ZSTD_isError(ZSTD_CCtx_setParameter(c, ZSTD_c_compressionLevel, kZstdLevel)) ||
      ZSTD_isError(ZSTD_CCtx_setParameter(c, ZSTD_c_strategy, kZstdStrategy)) ||
      ZSTD_isError(ZSTD_CCtx_setPledgedSrcSize(c, raw.size())))
    return false;
  const size_t head = out.size();
  out.resize(head + ZSTD_compressBound(raw.size()) + 64 * ends.size());
  ZSTD_outBuffer to{out.data() + head, out.size() - head, 0};
  size_t begin = 0;
  for (const uint64_t end : ends) {
    ZSTD_inBuffer from{raw.data() + begin, end - begin, 0};
    const size_t left = ZSTD_compressStream2(c, &to, &from, end == raw.size() ? ZSTD_e_end : ZSTD_e_flush);
    if (left != 0) return false;  // an error, or out of room, which compressBound rules out
    begin = end;
    if (end == raw.size()) break;
  }
  out.resize(head + to.pos);
  return true;
}

}  // namespace

uint16_t packFraction(float v) {
  if (!(v > 0)) return 0;
  if (v >= 1) return kFractionOne;
  if (v < 0x1p-30f) return static_cast<uint16_t>(std::nearbyint(v * 0x1p41f));  // 2048 is the code of 2^-30
  const auto bits = std::bit_cast<uint32_t>(v);
  return static_cast<uint16_t>(((bits + 0x7ffu + (bits >> 12 & 1)) >> 12) - (uint32_t{127 - 31} << 11));
}

OctNormal packNormal(Vec3 n) {
  const float sum = std::abs(n.x) + std::abs(n.y) + std::abs(n.z);
  if (!(sum > 0)) return {kZeroNormal, kZeroNormal};
  float x = n.x / sum, y = n.y / sum;
  if (n.z < 0) {
    const float fold_x = std::copysign(1.0f - std::abs(y), x), fold_y = std::copysign(1.0f - std::abs(x), y);
    x = fold_x, y = fold_y;
  }
  const auto pack = [](float v) { return static_cast<int16_t>(std::lround(std::clamp(v, -1.0f, 1.0f) * 32767.0f)); };
  return {pack(x), pack(y)};
}

Result<EncodedStrip> encodeStrip(const Strip& strip, const Box& bounds, std::span<const TileName> names) {
  if (strip.nodes.empty() || strip.nodes.size() > kTileNodes)
    return unfit(strip, "has " + std::to_string(strip.nodes.size()) + " nodes");
  if (strip.id.level >= kMaxLevels) return unfit(strip, "level is too high");
  if (strip.id.tile >= names.size()) return unfit(strip, "has no name");
  if (bounds.empty() || !finite(bounds.lo) || !finite(bounds.hi)) return unfit(strip, "bounds are not a box");
  for (size_t i = 0; i < strip.nodes.size(); ++i)
    if (auto ok = checkNode(strip, i, bounds); !ok) return ok.error();
  if (auto ok = checkEntries(strip); !ok) return ok.error();
  if (auto ok = checkLamps(strip); !ok) return ok.error();
  for (const Block& block : strip.blocks)
    if (block.partner_tile >= names.size()) return unfit(strip, "names partner tile " + std::to_string(block.partner_tile) + " of " + std::to_string(names.size()));

  StripLayout layout{static_cast<uint32_t>(strip.nodes.size()), countChunks(strip, names), static_cast<uint32_t>(strip.blocks.size()),
                     static_cast<uint32_t>(strip.lamps.size())};
  countRuns(strip, layout);
  if (layout.end() > kMaxStripRawBytes) return unfit(strip, "has too many entries");
  std::vector<std::byte> raw(layout.end());
  for (size_t i = 0; i < strip.nodes.size(); ++i) putNode(raw.data(), layout, i, strip.nodes[i], bounds);
  putLamps(raw.data(), layout, strip);
  putChunks(raw.data(), layout, strip, names);
  putEntries(raw.data(), layout, strip, names);
  EncodedStrip out;
  out.bytes.resize(kStripHeaderBytes);
  if (!compressStreams(raw, {layout.rowSteps(), layout.runWords(), layout.runWords() + layout.runs, layout.firstColumns(), layout.columnSteps(), layout.counts(), layout.end()},
                       out.bytes))
    return Error{ErrorCode::kIo, "", "", "out of memory for compression", "close other programs"};

  StripHeader header;
  header.level = static_cast<uint8_t>(strip.id.level);
  header.nodes = static_cast<uint16_t>(layout.nodes);
  header.entries = static_cast<uint32_t>(strip.rows.size());
  header.blocks = layout.blocks;
  header.chunks = layout.chunks;
  header.payload_bytes = static_cast<uint32_t>(out.bytes.size() - kStripHeaderBytes);
  header.raw_bytes = static_cast<uint32_t>(raw.size());
  std::vector<std::byte> head = recordBytes(header);
  std::copy(head.begin(), head.end(), out.bytes.begin());

  out.info.id = strip.id;
  out.info.strip.stored_bytes = static_cast<uint32_t>(out.bytes.size());
  out.info.strip.raw_bytes = header.raw_bytes;
  out.info.strip.checksum = hashBytes(out.bytes);
  out.info.first_node = strip.first_node;
  out.info.nodes = layout.nodes;
  out.info.entries = header.entries;
  out.info.bounds = bounds;
  out.name = names[strip.id.tile];
  for (const Node& node : strip.nodes) out.quanta = std::max(out.quanta, node.quanta);
  return out;
}

}  // namespace ff::formats
