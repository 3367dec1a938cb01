#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <memory>
#include <new>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"
#include "formats/codec/records.h"
#include "formats/codec/strip_entries.h"
#include "formats/codec/zstd_context.h"

namespace ff::formats {
namespace {

// One plane-split array of `n` elements of sizeof(T) bytes, beginning at p.
template <class T>
T planeValue(const std::byte* p, size_t n, size_t i) {
  T v = 0;
  for (size_t k = 0; k < sizeof(T); ++k)
    v = static_cast<T>(v | static_cast<T>(static_cast<T>(std::to_integer<uint8_t>(p[k * n + i])) << (8 * k)));
  return v;
}

Result<void> checkHeader(const TileInfo& info, std::span<const std::byte> stored, StripHeader& h) {
  if (stored.size() != info.strip.stored_bytes || stored.size() < kStripHeaderBytes)
    return brokenStrip(info, "has " + std::to_string(stored.size()) + " bytes instead of " +
                            std::to_string(info.strip.stored_bytes));
  ByteReader r(stored.first(kStripHeaderBytes));
  StripHeader::fields(r, h);
  if (h.magic != kStripMagic) return brokenStrip(info, "does not begin with FFST");
  if (hashBytes(stored) != info.strip.checksum)
    return brokenStrip(info, "checksum mismatch: bytes were changed, swapped or left over from another bake");
  if (r.reservedUsed()) return brokenStrip(info, "uses a reserved byte of the header");
  if (h.level != info.id.level || h.nodes != info.nodes || h.entries != info.entries || h.raw_bytes != info.strip.raw_bytes ||
      h.payload_bytes != stored.size() - kStripHeaderBytes)
    return brokenStrip(info, "header and index disagree");
  const StripLayout least{h.nodes, h.chunks, h.blocks, 0, h.blocks, h.entries};
  if (h.nodes < 1 || h.nodes > kTileNodes || h.blocks > kMaxBlocks || h.blocks > h.entries || h.chunks > h.blocks || h.raw_bytes > kMaxStripRawBytes ||
      h.raw_bytes < least.end())
    return brokenStrip(info, "sizes in the header contradict each other");
  return {};
}

Result<void> inflate(const TileInfo& info, std::span<const std::byte> payload, std::span<std::byte> raw) {
  thread_local std::unique_ptr<ZSTD_DCtx, FreeZstdContext> context(ZSTD_createDCtx());
  if (!context) return Error{ErrorCode::kIo, "", "", "out of memory for decompression", ""};
  const size_t frame = ZSTD_findFrameCompressedSize(payload.data(), payload.size());
  if (ZSTD_isError(frame) || frame != payload.size()) return brokenStrip(info, "payload is not one zstd frame");
  const size_t n = ZSTD_decompressDCtx(context.get(), raw.data(), raw.size(), payload.data(), payload.size());
  if (ZSTD_isError(n)) return brokenStrip(info, std::string("zstd: ") + ZSTD_getErrorName(n));
  if (n != raw.size()) return brokenStrip(info, "payload is shorter than the header says");
  return {};
}

bool validDirection(int x, int y, int z) {
  return x != -128 && y != -128 && z != -128 && x * x + y * y + z * z <= 127 * 127;
}

// Sets layout.lamps, which the header does not tell, and checks what follows from it.
Result<void> countLamps(const TileInfo& info, std::span<const std::byte> raw, StripLayout& layout) {
  uint64_t lamps = 0;
  for (size_t i = 0; i < layout.nodes; ++i) lamps += planeValue<uint16_t>(raw.data() + layout.lampCount(), layout.nodes, i);
  layout.lamps = static_cast<uint32_t>(lamps);  // at most 256 * 65535
  if (raw.size() < layout.rowSteps())
    return brokenStrip(info, "sizes in the header and the lamps' number contradict each other");
  return {};
}

Result<void> decodeLamps(const TileInfo& info, const std::byte* raw, const StripLayout& layout, Strip& out) {
  const size_t n = layout.lamps;
  out.lamps.resize(n);
  size_t k = 0;
  for (size_t i = 0; i < layout.nodes; ++i) {
    const size_t end = k + planeValue<uint16_t>(raw + layout.lampCount(), layout.nodes, i);
    for (const size_t first = k; k < end; ++k) {
      LampLight& lamp = out.lamps[k];
      const auto bad = [&](const char* what) { return brokenStrip(info, "row " + std::to_string(i) + ": " + what); };
      lamp.row = static_cast<uint8_t>(i);
      lamp.group = planeValue<uint16_t>(raw + layout.lampGroups(), n, k);
      if (lamp.group == kNoLampGroup || (k > first && lamp.group <= out.lamps[k - 1].group)) return bad("lamp groups are not in order");
      const auto red = planeValue<uint16_t>(raw + layout.lampWeights(), n, k);
      for (size_t c = 0; c < 3; ++c) {
        const auto step = planeValue<uint16_t>(raw + layout.lampWeights() + 2 * n * c, n, k);
        const auto code = static_cast<uint16_t>(c == 0 ? red : red + step);
        if (code > kFractionOne) return bad("a lamp's weight is above 2");
        lamp.weight[static_cast<int>(c)] = kLampWeightUnit * unpackFraction(code);
      }
    }
  }
  return {};
}

// put(node, convert(value)) for each node, of one plane-split array. Sixteen values are converted at a time, which the compiler does several at
// once; the last time with values that no node has.
template <class T, class Convert, class Put>
void forEachNode(const std::byte* array, Strip& out, Convert convert, Put put) {
  constexpr size_t kAtOnce = 16;
  static_assert(kAtOnce <= kEntryReadAhead);
  const size_t n = out.nodes.size();
  for (size_t first = 0; first < n; first += kAtOnce) {
    std::array<decltype(convert(T{})), kAtOnce> values;
    for (size_t k = 0; k < kAtOnce; ++k) values[k] = convert(planeValue<T>(array, n, first + k));
    for (size_t i = first; i < std::min(n, first + kAtOnce); ++i) put(out.nodes[i], values[i - first]);
  }
}

float unitFraction(uint16_t v) { return static_cast<float>(v) / 65535.0f; }
float signedFraction(int8_t v) { return static_cast<float>(v) / 127.0f; }
float asFloat(uint32_t v) { return std::bit_cast<float>(v); }
uint16_t asIs(uint16_t v) { return v; }

// What is wrong with a node, or null.
const char* flawOf(const Node& node) {
  if (node.sky_fraction > 1) return "sky fraction is above 1";
  if (node.row_total > kRowTotalUnit) return "row total is above 16";
  if (!(node.area_m2 > 0) || !std::isfinite(node.area_m2)) return "area is not a positive number";
  for (int k = 0; k < 3; ++k)
    if (!(node.emission[k] >= 0) || !(node.emission[k] <= kMaxEmission)) return "emission is not 0..1e12 W/m2";
  return nullptr;
}

// Array by array, so that one value's steps do not wait for another's.
Result<void> decodeNodes(const TileInfo& info, const std::byte* raw, const StripLayout& layout, uint32_t max_quanta, Strip& out) {
  const size_t n = layout.nodes;
  out.nodes.assign(n, Node{});
  forEachNode<uint32_t>(raw + layout.area(), out, asFloat, [](Node& node, float v) { node.area_m2 = v; });
  for (int k = 0; k < 3; ++k) {
    const auto c = static_cast<size_t>(k);
    const float lo = info.bounds.lo[k], extent = info.bounds.hi[k] - lo;
    forEachNode<uint16_t>(raw + layout.centroid() + 2 * n * c, out, [&](uint16_t v) { return lo + extent * unitFraction(v); }, [&](Node& node, float v) { node.centroid[k] = v; });
    forEachNode<uint16_t>(raw + layout.albedo() + 2 * n * c, out, unitFraction, [&](Node& node, float v) { node.albedo[k] = v; });
    forEachNode<uint32_t>(raw + layout.emission() + 4 * n * c, out, asFloat, [&](Node& node, float v) { node.emission[k] = v; });
    forEachNode<int8_t>(raw + layout.skyDirection() + n * c, out, signedFraction, [&](Node& node, float v) { node.sky_direction[k] = v; });
  }
  for (size_t k = 0; k < Node{}.sky_quadratic.size(); ++k)
    forEachNode<int8_t>(raw + layout.skyQuadratic() + n * k, out, signedFraction, [&](Node& node, float v) { node.sky_quadratic[k] = v; });
  forEachNode<uint16_t>(raw + layout.quanta(), out, asIs, [](Node& node, uint16_t v) { node.quanta = v; });
  forEachNode<uint16_t>(raw + layout.sky(), out, asIs, [](Node& node, uint16_t v) { node.sky = v; });
  forEachNode<uint16_t>(raw + layout.absorbed(), out, asIs, [](Node& node, uint16_t v) { node.absorbed = v; });
  forEachNode<uint16_t>(raw + layout.skyFraction(), out, unpackFraction, [](Node& node, float v) { node.sky_fraction = v; });
  forEachNode<uint16_t>(raw + layout.rowTotal(), out, unpackFraction, [](Node& node, float v) { node.row_total = kRowTotalUnit * v; });
  forEachNode<uint16_t>(raw + layout.lampGroup(), out, asIs, [](Node& node, uint16_t v) { node.lamp_group = v; });
  for (size_t i = 0; i < n; ++i) {
    Node& node = out.nodes[i];
    const auto bad = [&](const std::string& what) { return brokenStrip(info, "node " + std::to_string(i) + ": " + what); };
    const OctNormal normal{planeValue<int16_t>(raw + layout.normal(), n, i), planeValue<int16_t>(raw + layout.normal() + 2 * n, n, i)};
    if ((normal.u == kZeroNormal) != (normal.v == kZeroNormal)) return bad("normal is not a direction");
    node.normal = unpackNormal(normal);
    const std::byte* const direction = raw + layout.skyDirection() + i;
    if (!validDirection(planeValue<int8_t>(direction, n, 0), planeValue<int8_t>(direction + n, n, 0), planeValue<int8_t>(direction + 2 * n, n, 0)))
      return bad("sky direction is longer than 1");
    for (size_t k = 0; k < node.sky_quadratic.size(); ++k)
      if (raw[layout.skyQuadratic() + n * k + i] == std::byte{0x80}) return bad("sky quadratic is below -1");
    if (node.quanta > max_quanta)
      return bad("its row has " + std::to_string(node.quanta) + " samples, in this world a row has " + std::to_string(max_quanta) + " at most");
    if (const char* const flaw = flawOf(node)) return bad(flaw);
  }
  return {};
}

Result<void> decodeBlocks(const TileInfo& info, const std::byte* raw, const StripLayout& layout, Strip& out,
                          std::vector<PartnerName>& partners) {
  const size_t n = layout.blocks, chunks = layout.chunks;
  out.blocks.resize(n);
  partners.resize(n);
  size_t i = 0;
  for (size_t c = 0; c < chunks; ++c) {
    ChunkCell to;
    for (size_t a = 0; a < 3; ++a) to[a] = static_cast<int32_t>(planeValue<uint32_t>(raw + layout.chunkSteps() + 4 * chunks * a, chunks, c));
    uint32_t tile = 0;
    const auto blocks = planeValue<uint32_t>(raw + layout.chunkBlocks(), chunks, c);
    if (blocks < 1 || blocks > n - i) return brokenStrip(info, "chunks of partners do not add up to the strip's blocks");
    for (const size_t first = i; i < first + blocks; ++i) {
      const auto step = planeValue<uint16_t>(raw + layout.blockSteps(), n, i);
      if (i > first && step == 0) return brokenStrip(info, "block " + std::to_string(i) + " repeats its partner tile");
      tile += step;
      partners[i] = {to, tile};
    }
  }
  if (i != n) return brokenStrip(info, "chunks of partners do not add up to the strip's blocks");
  return {};
}

}  // namespace

Result<void> decodeStripBytes(const TileInfo& info, uint32_t quanta, std::span<const std::byte> stored, Strip& out,
                              std::vector<PartnerName>& partners, RowWords* words) try {
  StripHeader header;
  if (auto ok = checkHeader(info, stored, header); !ok) return ok;
  StripLayout layout{header.nodes, header.chunks, header.blocks};
  thread_local UnsetVector<std::byte> payload;  // bounded by kMaxStripRawBytes
  payload.resize(header.raw_bytes + kEntryReadAhead);
  const std::span raw = std::span(payload).first(header.raw_bytes);
  if (auto ok = inflate(info, stored.subspan(kStripHeaderBytes), raw); !ok) return ok;
  if (auto ok = countLamps(info, raw, layout); !ok) return ok;
  out.id = info.id;
  out.first_node = info.first_node;
  if (auto ok = decodeNodes(info, raw.data(), layout, maxRowQuanta(quanta), out); !ok) return ok;
  if (auto ok = decodeLamps(info, raw.data(), layout, out); !ok) return ok;
  if (auto ok = decodeBlocks(info, raw.data(), layout, out, partners); !ok) return ok;
  thread_local RowWords for_arrays;
  RowWords& rows = words ? *words : for_arrays;
  if (auto ok = decodeEntries(info, payload, layout, maxRowQuanta(quanta), out, partners, rows); !ok) return ok;
  out.rows.clear();
  out.columns.clear();
  out.counts.clear();
  if (!words) toArrays(rows, out);
  return {};
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, "", "", "out of memory while decoding a strip", "close other programs"};
}

}  // namespace ff::formats
