#include "formats/codec/strip_entries.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <string>
#include <utility>

namespace ff::formats {
namespace {

// Sixteen bytes at once: in two integers, where a multiplication adds up, and in the compiler's own vectors. Any processor has both, and none
// needs code of its own.
constexpr uint32_t kLanes = 16;
typedef uint8_t Bytes __attribute__((vector_size(kLanes)));
typedef uint64_t Halves __attribute__((vector_size(kLanes)));
static_assert(std::endian::native == std::endian::little, "lanes are loaded as they lie, and a word's count is its lower byte");

template <class T>
T load(const void* from) {
  T lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}

// Byte k is the sum of the bytes 0 to k, as long as that is 255 at most; the bytes above the first that exceeds it are unspecified.
uint64_t prefixSums(uint64_t bytes) { return bytes * 0x0101010101010101; }
uint32_t lastByte(uint64_t bytes) { return static_cast<uint32_t>(bytes >> 56); }

uint64_t sumOf(std::span<const uint8_t> bytes) {
  uint64_t sum = 0;
  for (size_t i = 0; i < bytes.size();) {
    uint32_t part = 0;
    for (const size_t end = std::min(bytes.size(), i + 65536); i < end; ++i) part += bytes[i];
    sum += part;
  }
  return sum;
}

// The words of a strip, run by run. Up to kLanes - 1 words behind a run's end are overwritten.
class RunDecoder {
 public:
  // column_steps, counts: of the strip's first run, with kEntryReadAhead bytes behind the last.
  RunDecoder(const uint8_t* column_steps, const uint8_t* counts) : column_steps_(column_steps), counts_(counts) {}

  // words: at least 1. to: with room for kLanes words more. Returns the last column, or less if that is past 255.
  uint32_t next(uint32_t first_column, uint32_t words, uint16_t* to) {
    const uint8_t *steps = column_steps_ + kLanes - 1, *counts = counts_;  // steps: of the next lanes, if any
    uint64_t low = load<uint64_t>(column_steps_) << 8 | first_column, high = load<uint64_t>(column_steps_ + kLanes / 2 - 1);
    column_steps_ += words - 1;
    counts_ += words;
    for (;;) {
      low = prefixSums(low);
      high = prefixSums(high + lastByte(low));
      store(load<Bytes>(counts), std::bit_cast<Bytes>(Halves{low, high}), to);
      if (words <= kLanes) return to[words - 1] >> 8;
      words -= kLanes;
      to += kLanes;
      counts += kLanes;
      low = load<uint64_t>(steps) + lastByte(high);
      high = load<uint64_t>(steps + kLanes / 2);
      steps += kLanes;
    }
  }
  const uint8_t* columnSteps() const { return column_steps_; }
  const uint8_t* counts() const { return counts_; }

 private:
  static void store(Bytes counts, Bytes columns, uint16_t* to) {
    const Bytes low = __builtin_shufflevector(counts, columns, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const Bytes high = __builtin_shufflevector(counts, columns, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    std::memcpy(to, &low, sizeof low);
    std::memcpy(to + kLanes / 2, &high, sizeof high);
  }

  const uint8_t *column_steps_, *counts_;
};

// Copies a row's words, eight at once, and adds their counts up. Up to seven words behind the row are read and written, too.
uint32_t copyRow(const uint16_t* from, size_t words, uint16_t* to) {
  typedef uint32_t Pairs __attribute__((vector_size(16)));
  constexpr size_t kAtOnce = 8;
  static constexpr std::array<uint16_t, 2 * kAtOnce> kFirstWords{0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff};
  Pairs sums{};
  for (;; from += kAtOnce, to += kAtOnce, words -= kAtOnce) {
    const auto pairs = load<Pairs>(from);
    std::memcpy(to, &pairs, sizeof pairs);
    const Pairs counts = pairs & load<Pairs>(kFirstWords.data() + kAtOnce - std::min(words, kAtOnce));
    sums += (counts & 0xffff) + (counts >> 16);
    if (words <= kAtOnce) return sums[0] + sums[1] + sums[2] + sums[3];
  }
}

// The runs of a strip, block by block, in the order of the payload.
class Runs {
 public:
  Runs(const uint8_t* raw, const StripLayout& layout)
      : steps_(raw + layout.rowSteps()), words_low_(raw + layout.runWords()), words_high_(words_low_ + layout.runs), first_columns_(raw + layout.firstColumns()) {}
  void beginBlock() {
    row_ = kBeforeFirst;
    first_column_ = 0;
  }
  void next() {
    row_ += *steps_++ + 1u;
    first_column_ = (first_column_ + *first_columns_++) & 0xff;
    words_ = (uint32_t{*words_low_++} | uint32_t{*words_high_++} << 8) + 1;
  }
  uint32_t row() const { return row_; }
  uint32_t firstColumn() const { return first_column_; }
  uint32_t words() const { return words_; }

 private:
  static constexpr uint32_t kBeforeFirst = ~0u;  // and 1 is 0
  const uint8_t *steps_, *words_low_, *words_high_, *first_columns_;
  uint32_t row_ = kBeforeFirst, first_column_ = 0, words_ = 0;
};

// A strip's arrays in its raw payload, and where the next run is.
class EntryDecoder {
 public:
  EntryDecoder(const TileInfo& info, std::span<const std::byte> raw, const StripLayout& layout, uint32_t max_quanta, RowWords& words)
      : info_(info), payload_bytes_(raw.size() - kEntryReadAhead), at_(reinterpret_cast<const uint8_t*>(raw.data())), layout_(layout), max_quanta_(max_quanta), words_(words), scratch_(scratch()) {}

  // Where each row's runs and words begin.
  Result<void> findRows() {
    const auto contradict = [&] { return brokenStrip(info_, "sizes in the header and the number of runs or words contradict each other"); };
    for (size_t b = 0; b < layout_.blocks; ++b) layout_.runs += runsOf(b);
    if (layout_.columnSteps() > payload_bytes_) return contradict();
    uint64_t words = 0;
    Runs runs(at_, layout_);
    for (size_t b = 0; b < layout_.blocks; ++b) {
      runs.beginBlock();
      for (uint32_t left = runsOf(b); left > 0; --left) {
        runs.next();
        if (runs.row() >= layout_.nodes) return bad(b, "a row is outside the tile");
        words += runs.words();
        next_[runs.row()] += kOneRun + runs.words();
      }
    }
    if (layout_.end() + 2 * words != payload_bytes_) return contradict();  // the end without any
    layout_.words = static_cast<uint32_t>(words);
    words_.run_start.resize(layout_.nodes + size_t{1});
    words_.row_start.resize(layout_.nodes + size_t{1});
    uint64_t start = 0;
    for (size_t r = 0; r <= layout_.nodes; ++r) {
      words_.run_start[r] = runsIn(start);
      words_.row_start[r] = wordsIn(start);
      if (r < layout_.nodes) start += std::exchange(next_[r], start);
    }
    return {};
  }

  Result<void> decode(std::span<Block> blocks, std::span<PartnerName> partners) {
    words_.runs.resize(layout_.runs);
    scratch_.resize(std::max(scratch_.size(), size_t{layout_.words} + size_t{kLanes} * layout_.nodes));  // never smaller: what grows is written twice
    uint16_t* const words = scratch_.data();
    RowWords::Run* const row_runs = words_.runs.data();
    Runs runs(at_, layout_);
    const uint8_t *const all_steps = at_ + layout_.columnSteps(), *const all_counts = at_ + layout_.counts();
    RunDecoder decoder(all_steps, all_counts);
    const uint8_t* next_repeat = firstZero(all_steps, all_counts);
    uint64_t entries = 0, rise = 0;  // rise: from the runs' first columns to their last ones
    for (size_t b = 0; b < layout_.blocks; ++b) {
      Runs first = runs;
      const uint8_t *steps = decoder.columnSteps(), *counts = decoder.counts(), *const first_count = counts;
      uint32_t max_column = 0;
      runs.beginBlock();
      for (uint32_t left = runsOf(b); left > 0; --left) {
        runs.next();
        const uint32_t row = runs.row(), n = runs.words();
        const uint64_t next = next_[row];
        next_[row] = next + kOneRun + n;
        const uint32_t column = decoder.next(runs.firstColumn(), n, words + wordsIn(next) + kLanes * row);
        rise += uint64_t{column} - runs.firstColumn();
        max_column = std::max(max_column, column);
        row_runs[runsIn(next)] = {static_cast<uint16_t>(b), static_cast<uint16_t>(n)};
      }
      uint32_t repeats = 0;
      if (next_repeat < decoder.columnSteps()) {
        if (!countRepeats(first, runsOf(b), steps, counts, repeats)) return firstDisorder();
        next_repeat = firstZero(decoder.columnSteps(), all_counts);
      }
      blocks[b].entries = static_cast<uint32_t>(decoder.counts() - first_count) - repeats;
      partners[b].columns = max_column + 1;
      entries += blocks[b].entries;
    }
    if (rise != sumOf({all_steps, all_counts})) return firstDisorder();  // a column is past 255
    if (entries != info_.entries) return brokenStrip(info_, "blocks do not add up to the strip's entries");
    return {};
  }

  // The rows' words, one behind the other, and whether they add up.
  Result<void> close(std::span<const Node> nodes) {
    words_.words.resize(layout_.words + kLanes);
    const uint8_t *const counts = at_ + layout_.counts(), *const end = at_ + layout_.end();
    const bool any_zero = firstZero(counts, end) != end;
    for (size_t i = 0; i < nodes.size(); ++i) {
      const auto wrong = [&](const std::string& what) { return brokenStrip(info_, "row " + std::to_string(i) + what); };
      const char* const too_many = " has more samples than any in this world";
      const std::span row = std::span(scratch_).subspan(words_.row_start[i] + kLanes * i, words_.row_start[i + 1] - words_.row_start[i]);
      if (row.size() > max_quanta_) return wrong(too_many);  // each is one at least; so the sum fits
      const uint32_t sum = copyRow(row.data(), row.size(), words_.words.data() + words_.row_start[i]);
      if (any_zero && std::ranges::any_of(row, [](uint16_t word) { return (word & kMaxWordCount) == 0; })) return wrong(": a count is zero");
      if (sum > max_quanta_) return wrong(too_many);
      const Node& node = nodes[i];
      if (sum + node.sky + node.absorbed != node.quanta)
        return wrong(": entries " + std::to_string(sum) + " + sky " + std::to_string(node.sky) + " + absorbed " + std::to_string(node.absorbed) + " are not the row's " +
                     std::to_string(node.quanta) + " quanta");
    }
    words_.words.resize(layout_.words);
    return {};
  }

 private:
  // Of runs and of words, how many or which is next, in one number: a run adds to both at once.
  static constexpr uint64_t kOneRun = uint64_t{1} << 32;
  static uint32_t runsIn(uint64_t both) { return static_cast<uint32_t>(both >> 32); }
  static uint32_t wordsIn(uint64_t both) { return static_cast<uint32_t>(both); }
  static const uint8_t* firstZero(const uint8_t* from, const uint8_t* end) {
    const void* const zero = std::memchr(from, 0, static_cast<size_t>(end - from));
    return zero ? static_cast<const uint8_t*>(zero) : end;
  }
  static std::vector<uint16_t>& scratch() {
    thread_local std::vector<uint16_t> words;
    return words;
  }
  Error bad(size_t block, const char* what) const { return brokenStrip(info_, "block " + std::to_string(block) + ": " + what); }
  uint32_t runsOf(size_t block) const { return uint32_t{at_[layout_.blockRuns() + block]} + 1; }
  // The error of the first block that is not in order; there is one.
  Error firstDisorder() const {
    Runs runs(at_, layout_);
    const uint8_t *steps = at_ + layout_.columnSteps(), *counts = at_ + layout_.counts();
    size_t b = 0;
    for (uint32_t repeats = 0; countRepeats(runs, runsOf(b), steps, counts, repeats); ++b) {
    }
    return bad(b, "entries are not in order of row and column");
  }
  // Words with the column of the word before, which go on with its entry. False if one does not, or a column is past 255.
  // Moves on to the next block.
  static bool countRepeats(Runs& runs, uint32_t left, const uint8_t*& steps, const uint8_t*& counts, uint32_t& repeats) {
    for (runs.beginBlock(); left > 0; --left, ++counts) {
      runs.next();
      uint32_t column = runs.firstColumn();
      for (uint32_t n = runs.words(); n > 1; --n, ++steps, ++counts) {
        if (*steps == 0 && *counts != kMaxWordCount) return false;
        repeats += *steps == 0 ? 1 : 0;
        column += *steps;
      }
      if (column >= kTileNodes) return false;
    }
    return true;
  }

  const TileInfo& info_;
  size_t payload_bytes_;
  const uint8_t* at_;
  StripLayout layout_;
  uint32_t max_quanta_;
  RowWords& words_;
  std::vector<uint16_t>& scratch_;  // the rows with kLanes words behind each
  std::array<uint64_t, kTileNodes> next_{};  // of each row; first, how many it has
};

}  // namespace

Error brokenStrip(const TileInfo& info, const std::string& message) {
  return {ErrorCode::kInvalidFile, "", "offset " + std::to_string(info.strip.offset), message, "restore this file from a copy, or bake again"};
}

Result<void> decodeEntries(const TileInfo& info, std::span<const std::byte> raw, StripLayout layout, uint32_t max_quanta, Strip& strip,
                           std::span<PartnerName> partners, RowWords& words) {
  EntryDecoder decoder(info, raw, layout, max_quanta, words);
  if (auto ok = decoder.findRows(); !ok) return ok;
  if (auto ok = decoder.decode(strip.blocks, partners); !ok) return ok;
  return decoder.close(strip.nodes);
}

void toArrays(const RowWords& words, Strip& out) {
  std::vector<size_t> next(out.blocks.size());  // entry of each block
  size_t entries = 0;
  for (size_t b = 0; b < next.size(); ++b) {
    next[b] = entries;
    entries += out.blocks[b].entries;
  }
  out.rows.resize(entries);
  out.columns.resize(entries);
  out.counts.resize(entries);
  const uint16_t* word = words.words.data();
  for (size_t r = 0; r < out.nodes.size(); ++r)
    for (uint32_t run = words.run_start[r]; run < words.run_start[r + 1]; ++run) {
      size_t& e = next[words.runs[run].partner];
      const size_t first = e;
      for (uint32_t left = words.runs[run].words; left > 0; --left, ++word) {
        const auto column = static_cast<uint8_t>(*word >> 8);
        const auto count = static_cast<uint16_t>(*word & kMaxWordCount);
        if (e > first && out.columns[e - 1] == column) {
          out.counts[e - 1] = static_cast<uint16_t>(out.counts[e - 1] + count);
          continue;
        }
        out.rows[e] = static_cast<uint8_t>(r);
        out.columns[e] = column;
        out.counts[e++] = count;
      }
    }
}

}  // namespace ff::formats
