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
#include "formats/codec/strip_codec.h"

namespace ff::formats {
namespace {

struct ContextFree {
  void operator()(ZSTD_DCtx* c) const { ZSTD_freeDCtx(c); }
};

Error broken(const TileInfo& info, const std::string& message) {
  return {ErrorCode::kInvalidFile, "", "offset " + std::to_string(info.strip.offset), message, "restore this file from a copy, or bake again"};
}

// One plane-split array of `n` elements of sizeof(T) bytes, beginning at p.
template <class T>
T planeValue(const std::byte* p, size_t n, size_t i) {
  T v = 0;
  for (size_t k = 0; k < sizeof(T); ++k)
    v = static_cast<T>(v | static_cast<T>(static_cast<T>(std::to_integer<uint8_t>(p[k * n + i])) << (8 * k)));
  return v;
}

float planeFloat(const std::byte* p, size_t n, size_t i) { return std::bit_cast<float>(planeValue<uint32_t>(p, n, i)); }

Result<void> checkHeader(const TileInfo& info, std::span<const std::byte> stored, StripHeader& h) {
  if (stored.size() != info.strip.stored_bytes || stored.size() < kStripHeaderBytes)
    return broken(info, "has " + std::to_string(stored.size()) + " bytes instead of " +
                            std::to_string(info.strip.stored_bytes));
  ByteReader r(stored.first(kStripHeaderBytes));
  StripHeader::fields(r, h);
  if (h.magic != kStripMagic) return broken(info, "does not begin with FFST");
  if (hashBytes(stored) != info.strip.checksum)
    return broken(info, "checksum mismatch: bytes were changed, swapped or left over from another bake");
  if (r.reservedUsed()) return broken(info, "uses a reserved byte of the header");
  if (h.level != info.id.level || h.nodes != info.nodes || h.entries != info.entries || h.raw_bytes != info.strip.raw_bytes ||
      h.payload_bytes != stored.size() - kStripHeaderBytes)
    return broken(info, "header and index disagree");
  const StripLayout layout{h.nodes, h.chunks, h.blocks, h.entries};
  if (h.nodes < 1 || h.nodes > kTileNodes || h.blocks > h.entries || h.chunks > h.blocks || h.raw_bytes > kMaxStripRawBytes ||
      h.raw_bytes < layout.escapes())
    return broken(info, "sizes in the header contradict each other");
  return {};
}

Result<void> inflate(const TileInfo& info, std::span<const std::byte> payload, std::span<std::byte> raw) {
  thread_local std::unique_ptr<ZSTD_DCtx, ContextFree> context(ZSTD_createDCtx());
  if (!context) return Error{ErrorCode::kIo, "", "", "out of memory for decompression", ""};
  const size_t frame = ZSTD_findFrameCompressedSize(payload.data(), payload.size());
  if (ZSTD_isError(frame) || frame != payload.size()) return broken(info, "payload is not one zstd frame");
  const size_t n = ZSTD_decompressDCtx(context.get(), raw.data(), raw.size(), payload.data(), payload.size());
  if (ZSTD_isError(n)) return broken(info, std::string("zstd: ") + ZSTD_getErrorName(n));
  if (n != raw.size()) return broken(info, "payload is shorter than the header says");
  return {};
}

bool validDirection(int x, int y, int z) {
  return x != -128 && y != -128 && z != -128 && x * x + y * y + z * z <= 127 * 127;
}

// Sets what the header does not tell, layout.lamps, and checks what follows from it.
Result<void> countLamps(const TileInfo& info, std::span<const std::byte> raw, StripLayout& layout) {
  uint64_t lamps = 0;
  for (size_t i = 0; i < layout.nodes; ++i) lamps += planeValue<uint16_t>(raw.data() + layout.lampCount(), layout.nodes, i);
  layout.lamps = static_cast<uint32_t>(lamps);  // at most 256 * 65535
  if (raw.size() < layout.escapes() || raw.size() - layout.escapes() > uint64_t{kMaxEscapeBytes} * layout.entries)
    return broken(info, "sizes in the header and the lamps' number contradict each other");
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
      const auto bad = [&](const char* what) { return broken(info, "row " + std::to_string(i) + ": " + what); };
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

Result<void> decodeNodes(const TileInfo& info, const std::byte* raw, const StripLayout& layout, uint32_t max_quanta, Strip& out) {
  const size_t n = layout.nodes;
  const Vec3 lo = info.bounds.lo, extent = info.bounds.hi - info.bounds.lo;
  out.nodes.resize(n);
  for (size_t i = 0; i < n; ++i) {
    Node& node = out.nodes[i];
    node = Node{};
    node.area_m2 = planeFloat(raw + layout.area(), n, i);
    OctNormal normal;
    normal.u = planeValue<int16_t>(raw + layout.normal(), n, i);
    normal.v = planeValue<int16_t>(raw + layout.normal() + 2 * n, n, i);
    std::array<int, 3> direction{};
    for (size_t c = 0; c < 3; ++c) {
      const int k = static_cast<int>(c);
      const auto centroid = planeValue<uint16_t>(raw + layout.centroid() + 2 * n * c, n, i);
      node.centroid[k] = lo[k] + extent[k] * (static_cast<float>(centroid) / 65535.0f);
      node.albedo[k] = static_cast<float>(planeValue<uint16_t>(raw + layout.albedo() + 2 * n * c, n, i)) / 65535.0f;
      node.emission[k] = planeFloat(raw + layout.emission() + 4 * n * c, n, i);
      direction[c] = planeValue<int8_t>(raw + layout.skyDirection() + n * c, n, i);
      node.sky_direction[k] = static_cast<float>(direction[c]) / 127.0f;
    }
    node.quanta = planeValue<uint16_t>(raw + layout.quanta(), n, i);
    node.sky = planeValue<uint16_t>(raw + layout.sky(), n, i);
    node.absorbed = planeValue<uint16_t>(raw + layout.absorbed(), n, i);
    for (size_t k = 0; k < node.sky_quadratic.size(); ++k) {
      const int mean = planeValue<int8_t>(raw + layout.skyQuadratic() + n * k, n, i);
      if (mean == -128) return broken(info, "node " + std::to_string(i) + ": sky quadratic is below -1");
      node.sky_quadratic[k] = static_cast<float>(mean) / 127.0f;
    }
    const auto fraction = planeValue<uint16_t>(raw + layout.skyFraction(), n, i);
    const auto total = planeValue<uint16_t>(raw + layout.rowTotal(), n, i);
    node.sky_fraction = unpackFraction(fraction);
    node.row_total = kRowTotalUnit * unpackFraction(total);
    node.lamp_group = planeValue<uint16_t>(raw + layout.lampGroup(), n, i);
    const auto bad = [&](const std::string& what) { return broken(info, "node " + std::to_string(i) + ": " + what); };
    if (node.quanta > max_quanta)
      return bad("its row has " + std::to_string(node.quanta) + " samples, in this world a row has " + std::to_string(max_quanta) + " at most");
    if (fraction > kFractionOne) return bad("sky fraction is above 1");
    if (total > kFractionOne) return bad("row total is above 16");
    if (!(node.area_m2 > 0) || !std::isfinite(node.area_m2)) return bad("area is not a positive number");
    if ((normal.u == kZeroNormal) != (normal.v == kZeroNormal)) return bad("normal is not a direction");
    node.normal = unpackNormal(normal);
    for (int k = 0; k < 3; ++k)
      if (!(node.emission[k] >= 0) || !(node.emission[k] <= kMaxEmission)) return bad("emission is not 0..1e12 W/m2");
    if (!validDirection(direction[0], direction[1], direction[2])) return bad("sky direction is longer than 1");
  }
  return {};
}

Result<void> decodeBlocks(const TileInfo& info, const std::byte* raw, const StripLayout& layout, Strip& out,
                          std::vector<PartnerName>& partners) {
  const size_t n = layout.blocks, chunks = layout.chunks;
  out.blocks.resize(n);
  partners.resize(n);
  uint64_t total = 0;
  size_t i = 0;
  for (size_t c = 0; c < chunks; ++c) {
    PartnerName partner;
    for (size_t a = 0; a < 3; ++a)
      partner.step[a] = static_cast<int32_t>(planeValue<uint32_t>(raw + layout.chunkSteps() + 4 * chunks * a, chunks, c));
    const auto blocks = planeValue<uint32_t>(raw + layout.chunkBlocks(), chunks, c);
    if (blocks < 1 || blocks > n - i) return broken(info, "chunks of partners do not add up to the strip's blocks");
    for (const size_t first = i; i < first + blocks; ++i) {
      const auto step = planeValue<uint16_t>(raw + layout.blockSteps(), n, i);
      if (i > first && step == 0) return broken(info, "block " + std::to_string(i) + " repeats its partner tile");
      partner.tile += step;
      partners[i] = partner;
      out.blocks[i].entries = uint32_t{planeValue<uint16_t>(raw + layout.blockEntries(), n, i)} + 1;
      total += out.blocks[i].entries;
    }
  }
  if (i != n) return broken(info, "chunks of partners do not add up to the strip's blocks");
  if (total != layout.entries) return broken(info, "blocks do not add up to the strip's entries");
  return {};
}

// Takes what a mark could not hold. `at` moves past it; false if the bytes end or the value had room in the mark.
bool takeEscape(const uint8_t*& at, const uint8_t* end, uint32_t& step, uint32_t& count) {
  if (step == kMarkLargeStep) {
    if (at == end) return false;
    step += *at++;
  }
  if (count != 0) return true;
  for (uint32_t shift = 0; shift < 21; shift += 7) {
    if (at == end) return false;
    const uint32_t byte = *at++;
    count |= (byte & 0x7f) << shift;
    if (byte < 0x80) {
      count += kMarkCountMask + 1;
      return (byte != 0 || shift == 0) && count <= kMaxQuanta;
    }
  }
  return false;
}

uint32_t countRuns(const uint8_t* marks, size_t entries) {
  uint32_t runs = 0;
  for (size_t e = 0; e < entries; ++e) runs += marks[e] > kMarkCountMask ? 1 : 0;
  return runs;
}

// Where decoded entries go. Plain pointers, because a store through uint8_t* may alias any vector.
class ToArrays {
 public:
  ToArrays(Strip& out, size_t entries) {
    out.rows.resize(entries);
    out.columns.resize(entries);
    out.counts.resize(entries);
    rows_ = out.rows.data();
    columns_ = out.columns.data();
    counts_ = out.counts.data();
  }
  void beginRun(uint32_t row) { row_ = static_cast<uint8_t>(row); }
  void add(uint32_t column, uint32_t count) {
    *rows_++ = row_;
    *columns_++ = static_cast<uint8_t>(column);
    *counts_++ = static_cast<uint16_t>(count);
  }
  void addLarge(uint32_t column, uint32_t count, size_t) { add(column, count); }
  void endRun() {}
  void endBlock() {}

 private:
  uint8_t row_ = 0, *rows_, *columns_;
  uint16_t* counts_;
};

class ToWords {
 public:
  ToWords(EntryWords& out, size_t entries) : out_(out) {
    out.runs.clear();
    out.block_runs.clear();
    if (out.words.size() < entries) out.words.resize(entries);
    begin_ = at_ = out.words.data();
  }
  void beginRun(uint32_t row) {
    row_ = static_cast<uint8_t>(row);
    run_ = at_;
  }
  void add(uint32_t column, uint32_t count) { *at_++ = static_cast<uint16_t>(column << 8 | count); }
  // left: entries from this one on.
  void addLarge(uint32_t column, uint32_t count, size_t left) {
    const auto used = static_cast<size_t>(at_ - begin_), run = static_cast<size_t>(run_ - begin_);
    if (const size_t needed = used + left + count / kMaxWordCount; out_.words.size() < needed) {
      out_.words.resize(needed + needed / 8);
      begin_ = out_.words.data();
      at_ = begin_ + used;
      run_ = begin_ + run;
    }
    for (; count > kMaxWordCount; count -= kMaxWordCount) add(column, kMaxWordCount);
    add(column, count);
  }
  void endRun() { out_.runs.push_back({static_cast<uint32_t>(at_ - run_), row_}); }
  void endBlock() {
    out_.block_runs.push_back(static_cast<uint32_t>(out_.runs.size() - runs_));
    runs_ = out_.runs.size();
  }

 private:
  EntryWords& out_;
  uint16_t *begin_, *at_, *run_ = nullptr;
  size_t runs_ = 0;  // of the blocks before
  uint8_t row_ = 0;
};

// Rows, columns and counts, run by run. Within a run the row is one and the columns rise, so that most checks and the row's
// sum are made once a run.
template <class To>
Result<void> decodeEntries(const TileInfo& info, std::span<const std::byte> bytes, const StripLayout& layout, uint32_t max_quanta,
                           std::vector<PartnerName>& partners, const Strip& out, To to) {
  const auto* raw = reinterpret_cast<const uint8_t*>(bytes.data());
  const uint8_t* const marks = raw + layout.marks();
  const uint8_t* first_columns = raw + layout.columns();
  const uint8_t* column_steps = first_columns + countRuns(marks, layout.entries);
  const uint8_t* escapes = raw + layout.escapes();
  const uint8_t* const escapes_end = raw + bytes.size();
  std::array<uint64_t, kTileNodes> sums{};
  size_t e = 0;
  for (size_t b = 0; b < out.blocks.size(); ++b) {
    const Block& block = out.blocks[b];
    const auto bad = [&](const char* what) { return broken(info, "block " + std::to_string(b) + ": " + what); };
    uint32_t max_column = 0;
    const size_t end = e + block.entries;
    uint32_t row = 0, first_column = 0;  // row: one more than the row's number, so that a block's first step is > 0
    while (e < end) {
      uint32_t mark = marks[e], step = mark >> kMarkCountBits, count = mark & kMarkCountMask;
      if (step == 0) return bad("does not begin with a row");
      if ((step == kMarkLargeStep || count == 0) && !takeEscape(escapes, escapes_end, step, count))
        return bad("an escape is malformed");
      row += step;
      if (row > layout.nodes) return bad("a row is outside the tile");
      first_column = (first_column + *first_columns++) & 0xff;
      uint32_t column = first_column, unordered = 0;
      uint64_t sum = 0;
      to.beginRun(row - 1);
      for (;;) {
        if (count > kMaxWordCount) to.addLarge(column, count, layout.entries - e);
        else to.add(column, count);
        sum += count;
        if (++e == end || (mark = marks[e]) > kMarkCountMask) break;
        step = 0;
        count = mark;
        if (count == 0 && !takeEscape(escapes, escapes_end, step, count)) return bad("an escape is malformed");
        unordered |= static_cast<uint32_t>(*column_steps == 0);
        column += *column_steps++;
      }
      to.endRun();
      if (unordered != 0) return bad("entries are not in order of row and column");
      if (column >= kTileNodes) return bad("a column is outside any tile");
      max_column = std::max(max_column, column);
      if ((sums[row - 1] += sum) > max_quanta) return bad("a row has more samples than any in this world");  // which bounds the words
    }
    to.endBlock();
    partners[b].columns = max_column + 1;
  }
  if (escapes != escapes_end) return broken(info, "escapes are left over");
  for (size_t i = 0; i < layout.nodes; ++i) {
    const Node& node = out.nodes[i];
    if (sums[i] + node.sky + node.absorbed != node.quanta)
      return broken(info, "row " + std::to_string(i) + ": entries " + std::to_string(sums[i]) + " + sky " +
                              std::to_string(node.sky) + " + absorbed " + std::to_string(node.absorbed) +
                              " are not the row's " + std::to_string(node.quanta) + " quanta");
  }
  return {};
}

}  // namespace

float unpackFraction(uint16_t code) {
  if (code >> 11 == 0) return static_cast<float>(code) * 0x1p-41f;
  return std::bit_cast<float>((uint32_t{code} + (uint32_t{127 - 31} << 11)) << 12);
}

Vec3 unpackNormal(OctNormal n) {
  if (n.u == kZeroNormal || n.v == kZeroNormal) return {};
  const float x = static_cast<float>(n.u) / 32767.0f, y = static_cast<float>(n.v) / 32767.0f;
  const float z = 1.0f - std::abs(x) - std::abs(y);
  if (z >= 0) return normalized({x, y, z});
  return normalized({std::copysign(1.0f - std::abs(y), x), std::copysign(1.0f - std::abs(x), y), z});
}

Result<void> decodeStripBytes(const TileInfo& info, uint32_t quanta, std::span<const std::byte> stored, Strip& out,
                              std::vector<PartnerName>& partners, EntryWords* words) try {
  StripHeader header;
  if (auto ok = checkHeader(info, stored, header); !ok) return ok;
  StripLayout layout{header.nodes, header.chunks, header.blocks, header.entries};
  thread_local std::vector<std::byte> scratch;  // bounded by kMaxStripRawBytes
  scratch.resize(header.raw_bytes);
  if (auto ok = inflate(info, stored.subspan(kStripHeaderBytes), scratch); !ok) return ok;
  if (auto ok = countLamps(info, scratch, layout); !ok) return ok;
  out.id = info.id;
  out.first_node = info.first_node;
  if (auto ok = decodeNodes(info, scratch.data(), layout, maxRowQuanta(quanta), out); !ok) return ok;
  if (auto ok = decodeLamps(info, scratch.data(), layout, out); !ok) return ok;
  if (auto ok = decodeBlocks(info, scratch.data(), layout, out, partners); !ok) return ok;
  if (!words) return decodeEntries(info, scratch, layout, maxRowQuanta(quanta), partners, out, ToArrays(out, layout.entries));
  out.rows.clear();
  out.columns.clear();
  out.counts.clear();
  return decodeEntries(info, scratch, layout, maxRowQuanta(quanta), partners, out, ToWords(*words, layout.entries));
} catch (const std::bad_alloc&) {
  return Error{ErrorCode::kIo, "", "", "out of memory while decoding a strip", "close other programs"};
}

}  // namespace ff::formats
