#include "formats/codec/strip_entries.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

namespace ff::formats {
namespace {

// Sixteen bytes at once, in the compiler's own vectors: no processor needs code of its own.
constexpr uint32_t kLanes = 16;
typedef uint8_t Bytes __attribute__((vector_size(kLanes)));
static_assert(std::endian::native == std::endian::little, "lanes are loaded as they lie, and a word's count is its lower byte");

template <class T>
T load(const void* from) {
  T lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}

Bytes everyLane(uint8_t byte) { return Bytes{} + byte; }

template <size_t n>
Bytes movedUp(Bytes bytes) {
  return [&]<size_t... k>(std::index_sequence<k...>) { return __builtin_shufflevector(Bytes{}, bytes, (kLanes - n + k)...); }(std::make_index_sequence<kLanes>());
}

// Of each byte and those before it, modulo 256.
Bytes runningSums(Bytes bytes) {
  bytes += movedUp<1>(bytes);
  bytes += movedUp<2>(bytes);
  bytes += movedUp<4>(bytes);
  return bytes + movedUp<8>(bytes);
}

// to[k]: the sum of the first k steps, modulo 256. Returns the sum of all. Reads and writes up to kLanes bytes behind the end.
uint64_t sumSteps(std::span<const uint8_t> steps, uint8_t* to) {
  typedef uint16_t Pairs __attribute__((vector_size(kLanes)));
  constexpr size_t kPairsHold = 65535 / (2 * 255) * kLanes;  // steps whose sum in pairs of lanes fits
  *to++ = 0;
  uint64_t sum = 0;
  Bytes before{};
  for (size_t i = 0; i < steps.size();) {
    Pairs pairs{};
    for (const size_t end = std::min(steps.size(), i + kPairsHold); i < end; i += kLanes) {
      auto here = load<Bytes>(steps.data() + i);
      for (size_t k = std::min<size_t>(steps.size() - i, kLanes); k < kLanes; ++k) here[k] = 0;
      pairs += (std::bit_cast<Pairs>(here) & 0xff) + (std::bit_cast<Pairs>(here) >> 8);
      const Bytes sums = runningSums(here) + before;
      before = everyLane(sums[kLanes - 1]);
      std::memcpy(to + i, &sums, sizeof sums);
    }
    for (size_t k = 0; k < kLanes / 2; ++k) sum += pairs[k];
  }
  return sum;
}

// The words of one run: counts, and columns, which are sums of steps and `more` (modulo 256). Up to kLanes - 1 words behind its end are overwritten.
void putRun(const uint8_t* counts, const uint8_t* sums, uint8_t more, size_t words, uint16_t* to) {
  const Bytes add = everyLane(more);
  for (size_t i = 0;; i += kLanes) {
    const auto count = load<Bytes>(counts + i);
    const Bytes column = load<Bytes>(sums + i) + add;
    const Bytes low = __builtin_shufflevector(count, column, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const Bytes high = __builtin_shufflevector(count, column, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    std::memcpy(to + i, &low, sizeof low);
    std::memcpy(to + i + kLanes / 2, &high, sizeof high);
    if (i + kLanes >= words) return;
  }
}

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

// A run as the payload tells it.
struct StoredRun {
  uint8_t row, first_column;
  uint16_t words_less_one;
  uint32_t words() const { return words_less_one + 1u; }
};

// What decoding a strip needs besides the result.
struct Scratch {
  UnsetVector<StoredRun> runs;
  UnsetVector<uint8_t> sums;    // of the column steps, as sumSteps() puts them
  UnsetVector<uint16_t> words;  // by row, with kLanes words behind each
  static Scratch& ofThread() {
    thread_local Scratch scratch;
    return scratch;
  }
};

// A strip's arrays in its raw payload, and where the next run of each row goes.
class EntryDecoder {
 public:
  EntryDecoder(const TileInfo& info, std::span<const std::byte> raw, const StripLayout& layout, uint32_t max_quanta, RowWords& words)
      : info_(info), payload_bytes_(raw.size() - kEntryReadAhead), at_(reinterpret_cast<const uint8_t*>(raw.data())), layout_(layout), max_quanta_(max_quanta), words_(words), scratch_(Scratch::ofThread()) {}

  // The runs, and where each row's runs and words begin.
  Result<void> readRuns() {
    const auto contradict = [&] { return brokenStrip(info_, "sizes in the header and the number of runs or words contradict each other"); };
    for (size_t b = 0; b < layout_.blocks; ++b) layout_.runs += runsOf(b);
    if (layout_.columnSteps() > payload_bytes_) return contradict();
    const uint8_t *steps = at_ + layout_.rowSteps(), *words_low = at_ + layout_.runWords(), *words_high = words_low + layout_.runs, *column_steps = at_ + layout_.firstColumns();
    scratch_.runs.resize(layout_.runs);
    StoredRun* run = scratch_.runs.data();
    for (size_t b = 0; b < layout_.blocks; ++b) {
      uint32_t row = kBeforeFirst;
      uint8_t first_column = 0;
      for (const StoredRun* const end = run + runsOf(b); run < end; ++run) {
        row += *steps++ + 1u;
        first_column = static_cast<uint8_t>(first_column + *column_steps++);
        *run = {static_cast<uint8_t>(row), first_column, static_cast<uint16_t>(*words_low++ | *words_high++ << 8)};
        Row& of = rows_[row % kTileNodes];
        of.next += kOneRun + run->words();
        of.partners |= uint64_t{1} << b % 64;
      }
      if (row >= layout_.nodes) return bad(b, "a row is outside the tile");
    }
    words_.run_start.resize(layout_.nodes + size_t{1});
    words_.row_start.resize(layout_.nodes + size_t{1});
    words_.row_partners.resize(layout_.nodes);
    uint64_t start = 0;
    for (size_t r = 0; r < layout_.nodes; ++r) {
      words_.run_start[r] = runsIn(start);
      words_.row_start[r] = wordsIn(start);
      words_.row_partners[r] = rows_[r].partners;
      start += std::exchange(rows_[r].next, start);
    }
    const uint64_t words = start - layout_.runs * kOneRun;
    if (layout_.end() + 2 * words != payload_bytes_) return contradict();  // the end without any
    layout_.words = static_cast<uint32_t>(words);
    words_.run_start.back() = layout_.runs;
    words_.row_start.back() = layout_.words;
    return {};
  }

  Result<void> decode(std::span<Block> blocks, std::span<PartnerName> partners) {
    words_.runs.resize(layout_.runs);
    scratch_.words.resize(layout_.words + size_t{kLanes} * layout_.nodes);
    const std::span steps(at_ + layout_.columnSteps(), at_ + layout_.counts());
    scratch_.sums.resize(1 + steps.size() + kLanes);
    const uint64_t rises = sumSteps(steps, scratch_.sums.data());
    const uint8_t *const all_sums = scratch_.sums.data(), *sums = all_sums, *counts = at_ + layout_.counts();
    const StoredRun* run = scratch_.runs.data();
    uint16_t* const words = scratch_.words.data();
    RowWords::Run* const row_runs = words_.runs.data();
    size_t next_repeat = zeroFrom(steps, 0);
    uint64_t entries = 0, seen_rises = 0;  // from the runs' first columns to their last ones
    for (size_t b = 0; b < layout_.blocks; ++b) {
      const std::span runs(run, runsOf(b));
      const size_t first_step = static_cast<size_t>(sums - all_sums);
      const uint8_t* const first_count = counts;
      uint8_t max_column = 0;
      for (; run < runs.data() + runs.size(); ++run) {
        const uint32_t n = run->words();
        const uint64_t next = rows_[run->row].next;
        rows_[run->row].next = next + kOneRun + n;
        const auto more = static_cast<uint8_t>(run->first_column - *sums);
        putRun(counts, sums, more, n, words + wordsIn(next) + kLanes * run->row);
        counts += n;
        sums += n - 1;
        const auto last_column = static_cast<uint8_t>(*sums + more);
        seen_rises += uint64_t{last_column} - run->first_column;
        max_column = std::max(max_column, last_column);
        row_runs[runsIn(next)] = {static_cast<uint16_t>(b), static_cast<uint16_t>(n)};
      }
      blocks[b].entries = static_cast<uint32_t>(counts - first_count);
      if (next_repeat < static_cast<size_t>(sums - all_sums)) {
        const auto repeats = countRepeats(runs, steps.subspan(first_step), first_count, next_repeat - first_step);
        if (!repeats) return firstDisorder();
        blocks[b].entries -= *repeats;
        next_repeat = zeroFrom(steps, static_cast<size_t>(sums - all_sums));
      }
      partners[b].columns = uint32_t{max_column} + 1;
      entries += blocks[b].entries;
    }
    if (seen_rises != rises) return firstDisorder();  // a column is past 255
    if (entries != info_.entries) return brokenStrip(info_, "blocks do not add up to the strip's entries");
    return {};
  }

  // The rows' words, one behind the other, and whether they add up.
  Result<void> close(std::span<const Node> nodes) {
    words_.words.resize(layout_.words + kLanes);
    const std::span counts(at_ + layout_.counts(), layout_.words);
    const bool any_zero = zeroFrom(counts, 0) < counts.size();
    for (size_t i = 0; i < nodes.size(); ++i) {
      const auto wrong = [&](const std::string& what) { return brokenStrip(info_, "row " + std::to_string(i) + what); };
      const char* const too_many = " has more samples than any in this world";
      const std::span row = std::span<const uint16_t>(scratch_.words).subspan(words_.row_start[i] + kLanes * i, words_.row_start[i + 1] - words_.row_start[i]);
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
  struct Row {
    uint64_t next = 0;  // first, how many it has
    uint64_t partners = 0;
  };
  static constexpr uint32_t kBeforeFirst = ~0u;  // and 1 is 0

  // Where the first zero is from there on; the size if there is none.
  static size_t zeroFrom(std::span<const uint8_t> bytes, size_t from) {
    const void* const zero = std::memchr(bytes.data() + from, 0, bytes.size() - from);
    return zero ? static_cast<size_t>(static_cast<const uint8_t*>(zero) - bytes.data()) : bytes.size();
  }
  Error bad(size_t block, const char* what) const { return brokenStrip(info_, "block " + std::to_string(block) + ": " + what); }
  uint32_t runsOf(size_t block) const { return uint32_t{at_[layout_.blockRuns() + block]} + 1; }
  // Of a block: words with the column of the word before, which go on with its entry. steps, counts: from its first on; zero: the first step of 0. None: one of
  // them does not.
  static std::optional<uint32_t> countRepeats(std::span<const StoredRun> runs, std::span<const uint8_t> steps, const uint8_t* counts, size_t zero) {
    uint32_t repeats = 0;
    size_t runs_before = 0, step = 0;
    for (const StoredRun& run : runs) {
      for (step += run.words_less_one; zero < step; zero = zeroFrom(steps, zero + 1), ++repeats)
        if (counts[zero + runs_before] != kMaxWordCount) return std::nullopt;
      ++runs_before;
    }
    return repeats;
  }
  // The error of the first block that is not in order; there is one.
  Error firstDisorder() const {
    const uint8_t *step = at_ + layout_.columnSteps(), *count = at_ + layout_.counts();
    const StoredRun* run = scratch_.runs.data();
    for (size_t b = 0;; ++b)
      for (uint32_t left = runsOf(b); left > 0; --left, ++run, ++count) {
        uint32_t column = run->first_column;
        for (uint32_t n = run->words_less_one; n > 0; --n, ++count) {
          if (*step == 0 && *count != kMaxWordCount) return bad(b, kDisorder);
          column += *step++;
        }
        if (column >= kTileNodes) return bad(b, kDisorder);
      }
  }
  static constexpr const char* kDisorder = "entries are not in order of row and column";

  const TileInfo& info_;
  size_t payload_bytes_;
  const uint8_t* at_;
  StripLayout layout_;
  uint32_t max_quanta_;
  RowWords& words_;
  Scratch& scratch_;
  std::array<Row, kTileNodes> rows_{};
};

}  // namespace

Error brokenStrip(const TileInfo& info, const std::string& message) {
  return {ErrorCode::kInvalidFile, "", "offset " + std::to_string(info.strip.offset), message, "restore this file from a copy, or bake again"};
}

Result<void> decodeEntries(const TileInfo& info, std::span<const std::byte> raw, StripLayout layout, uint32_t max_quanta, Strip& strip,
                           std::span<PartnerName> partners, RowWords& words) {
  EntryDecoder decoder(info, raw, layout, max_quanta, words);
  if (auto ok = decoder.readRuns(); !ok) return ok;
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
