#include "formats/codec/strip_entries.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <string>
#include <tuple>
#include <utility>

namespace ff::formats {
namespace {

// Sixteen bytes at once, in the compiler's own vectors: any processor has them, and none needs code of its own.
constexpr uint32_t kLanes = 16;
typedef uint8_t Bytes __attribute__((vector_size(kLanes)));
typedef uint64_t Halves __attribute__((vector_size(kLanes)));
static_assert(std::endian::native == std::endian::little, "a word's count is its lower byte");

Bytes load(const void* from) {
  Bytes v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

// Never through memory, where what has just been stored a byte at a time is slow to load as a whole.
Bytes inFirstLane(uint32_t byte) { return std::bit_cast<Bytes>(Halves{byte, 0}); }
uint32_t lastLane(Bytes v) { return static_cast<uint32_t>(std::bit_cast<Halves>(v)[1] >> 56); }
bool anyOf(Bytes v) {
  const auto halves = std::bit_cast<Halves>(v);
  return (halves[0] | halves[1]) != 0;
}

// Lane k is lane k - N of v; the first N are 0.
template <int N, int... Lane>
Bytes movedUp(Bytes v, std::integer_sequence<int, Lane...>) {
  return __builtin_shufflevector(Bytes{}, v, (static_cast<int>(kLanes) - N + Lane)...);
}
template <int N>
Bytes movedUp(Bytes v) {
  return movedUp<N>(v, std::make_integer_sequence<int, kLanes>{});
}

// Lane k is the sum of the lanes 0 to k, modulo 256.
Bytes prefixSums(Bytes v) {
  v += movedUp<1>(v);
  v += movedUp<2>(v);
  v += movedUp<4>(v);
  return v + movedUp<8>(v);
}

// Of its 16 lanes from kLanes - n on, the first n are all ones and the others zero.
constexpr std::array<uint8_t, size_t{2} * kLanes> kFirstLanes = [] {
  std::array<uint8_t, size_t{2} * kLanes> lanes{};
  std::fill_n(lanes.begin(), kLanes, uint8_t{0xff});
  return lanes;
}();

// The words of a block, run by run. Up to kLanes - 1 words behind a run's end are overwritten.
class BlockDecoder {
 public:
  // column_steps, counts: of the strip's first run, with kEntryReadAhead bytes behind the last.
  BlockDecoder(const uint8_t* column_steps, const uint8_t* counts) : column_steps_(column_steps), counts_(counts) {}

  void begin() {
    max_column_ = 0;
    disorder_ = Bytes{};
  }
  // words: at least 1. to: with room for kLanes words more.
  void decodeRun(uint32_t first_column, uint32_t words, uint16_t* to) {
    const uint8_t* steps = column_steps_ + kLanes - 1;  // of the next lanes, if any
    Bytes columns = movedUp<1>(load(column_steps_)) | inFirstLane(first_column), before_first = inFirstLane(0);
    Bytes ordered = load(kBehindFirst.data());
    column_steps_ += words - 1;
    for (;;) {
      const uint32_t n = std::min(words, kLanes);
      const Bytes lanes = load(kFirstLanes.data() + kLanes - n);
      columns = prefixSums(columns & lanes);
      disorder_ |= std::bit_cast<Bytes>(columns <= (movedUp<1>(columns) | before_first)) & lanes & ordered;
      store(load(counts_), columns, to);
      counts_ += n;
      words -= n;
      if (words == 0) break;
      to += kLanes;
      ordered = ~Bytes{};
      before_first = inFirstLane(lastLane(columns));
      columns = load(steps) + before_first;
      steps += kLanes;
    }
    max_column_ = std::max(max_column_, lastLane(columns));
  }
  uint32_t maxColumn() const { return max_column_; }
  // Some columns do not rise: those of entries of several words, or of a damaged strip.
  bool hasRepeats() const { return anyOf(disorder_); }
  const uint8_t* columnSteps() const { return column_steps_; }
  const uint8_t* counts() const { return counts_; }

 private:
  static constexpr std::array<uint8_t, kLanes> kBehindFirst = [] {
    std::array<uint8_t, kLanes> lanes{};
    std::fill(lanes.begin() + 1, lanes.end(), uint8_t{0xff});
    return lanes;
  }();

  static void store(Bytes counts, Bytes columns, uint16_t* to) {
    const Bytes low = __builtin_shufflevector(counts, columns, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const Bytes high = __builtin_shufflevector(counts, columns, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    std::memcpy(to, &low, sizeof low);
    std::memcpy(to + kLanes / 2, &high, sizeof high);
  }

  const uint8_t *column_steps_, *counts_;
  uint32_t max_column_ = 0;
  Bytes disorder_{};
};

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
    std::array<uint32_t, kTileNodes> row_runs{}, row_words{};
    uint64_t words = 0;
    Runs runs(at_, layout_);
    for (size_t b = 0; b < layout_.blocks; ++b) {
      runs.beginBlock();
      for (uint32_t left = runsOf(b); left > 0; --left) {
        runs.next();
        if (runs.row() >= layout_.nodes) return bad(b, "a row is outside the tile");
        words += runs.words();
        row_words[runs.row()] += runs.words();
        row_runs[runs.row()] += 1;
      }
    }
    if (layout_.end() + 2 * words != payload_bytes_) return contradict();  // the end without any
    layout_.words = static_cast<uint32_t>(words);
    for (auto [starts, numbers, next] : {std::tuple(&words_.run_start, &row_runs, &next_run_), std::tuple(&words_.row_start, &row_words, &next_word_)}) {
      starts->resize(layout_.nodes + size_t{1});
      uint32_t sum = 0;
      for (size_t r = 0; r < layout_.nodes; ++r) {
        (*starts)[r] = (*next)[r] = sum;
        sum += (*numbers)[r];
      }
      starts->back() = sum;
    }
    return {};
  }

  Result<void> decode(std::span<Block> blocks, std::span<PartnerName> partners) {
    words_.runs.resize(layout_.runs);
    scratch_.resize(size_t{layout_.words} + size_t{kLanes} * layout_.nodes);
    uint16_t* const words = scratch_.data();
    RowWords::Run* const row_runs = words_.runs.data();
    Runs runs(at_, layout_);
    BlockDecoder decoder(at_ + layout_.columnSteps(), at_ + layout_.counts());
    uint64_t entries = 0;
    for (size_t b = 0; b < layout_.blocks; ++b) {
      const Runs first = runs;
      const uint8_t *steps = decoder.columnSteps(), *counts = decoder.counts();
      decoder.begin();
      runs.beginBlock();
      for (uint32_t left = runsOf(b); left > 0; --left) {
        runs.next();
        const uint32_t row = runs.row(), n = runs.words(), word = next_word_[row];
        decoder.decodeRun(runs.firstColumn(), n, words + word + kLanes * row);
        next_word_[row] = word + n;
        row_runs[next_run_[row]++] = {static_cast<uint16_t>(b), static_cast<uint16_t>(n)};
      }
      const auto block_words = static_cast<size_t>(decoder.counts() - counts);
      uint32_t repeats = 0;
      if (decoder.hasRepeats() && !countRepeats(first, runsOf(b), steps, counts, repeats)) return bad(b, "entries are not in order of row and column");
      blocks[b].entries = static_cast<uint32_t>(block_words) - repeats;
      partners[b].columns = decoder.maxColumn() + 1;
      entries += blocks[b].entries;
    }
    if (entries != info_.entries) return brokenStrip(info_, "blocks do not add up to the strip's entries");
    return {};
  }

  // The rows' words, one behind the other, and whether they add up.
  Result<void> close(std::span<const Node> nodes) {
    words_.words.clear();
    words_.words.reserve(layout_.words);
    for (size_t i = 0; i < nodes.size(); ++i) {
      const auto wrong = [&](const std::string& what) { return brokenStrip(info_, "row " + std::to_string(i) + what); };
      const char* const too_many = " has more samples than any in this world";
      const std::span row = std::span(scratch_).subspan(words_.row_start[i] + kLanes * i, words_.row_start[i + 1] - words_.row_start[i]);
      if (row.size() > max_quanta_) return wrong(too_many);  // each is one at least; so the sum fits
      uint32_t sum = 0;
      int16_t least = kMaxWordCount;
      for (const uint16_t word : row) {
        const auto count = static_cast<int16_t>(word & kMaxWordCount);
        sum += static_cast<uint32_t>(count);
        least = std::min(least, count);
      }
      words_.words.insert(words_.words.end(), row.begin(), row.end());
      if (least == 0) return wrong(": a count is zero");
      if (sum > max_quanta_) return wrong(too_many);
      const Node& node = nodes[i];
      if (sum + node.sky + node.absorbed != node.quanta)
        return wrong(": entries " + std::to_string(sum) + " + sky " + std::to_string(node.sky) + " + absorbed " + std::to_string(node.absorbed) + " are not the row's " +
                     std::to_string(node.quanta) + " quanta");
    }
    return {};
  }

 private:
  static std::vector<uint16_t>& scratch() {
    thread_local std::vector<uint16_t> words;
    return words;
  }
  Error bad(size_t block, const char* what) const { return brokenStrip(info_, "block " + std::to_string(block) + ": " + what); }
  uint32_t runsOf(size_t block) const { return uint32_t{at_[layout_.blockRuns() + block]} + 1; }
  // Words with the column of the word before, which go on with its entry. False if one does not, or a column is past 255.
  static bool countRepeats(Runs runs, uint32_t left, const uint8_t* steps, const uint8_t* counts, uint32_t& repeats) {
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
  std::array<uint32_t, kTileNodes> next_word_{}, next_run_{};
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
