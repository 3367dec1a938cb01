// Strips whose checksum is right but whose content breaks a rule of FORMAT.md, as a hostile or faulty writer makes them.
#include <gtest/gtest.h>
#include <zstd.h>

#include <algorithm>
#include <functional>
#include <map>
#include <random>
#include <tuple>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"
#include "formats/codec/records.h"
#include "formats/codec/strip_codec.h"
#include "formats/write/writer.h"
#include "tests/support/random_world.h"

namespace ff::formats {
namespace {

// A strip taken apart: header, raw payload. seal() makes stored bytes of it, with everything else right.
struct OpenStrip {
  TileInfo info;
  StripHeader header;
  std::vector<std::byte> raw;
  uint32_t quanta = 1000;  // the world's

  explicit OpenStrip(const EncodedStrip& encoded) : info(encoded.info) {
    ByteReader r(encoded.bytes);
    StripHeader::fields(r, header);
    raw.resize(header.raw_bytes);
    const size_t n = ZSTD_decompress(raw.data(), raw.size(), encoded.bytes.data() + kStripHeaderBytes,
                                     encoded.bytes.size() - kStripHeaderBytes);
    EXPECT_EQ(n, raw.size());
    info.strip.shard = 3;
    info.strip.offset = 8192;
  }

  StripLayout layout() const { return {header.nodes, header.chunks, header.blocks, 2, 3, 7}; }  // sampleStrip()'s lamps, runs and words

  std::vector<std::byte> seal(bool take_header = true) {
    std::vector<std::byte> payload(ZSTD_compressBound(raw.size()));
    payload.resize(ZSTD_compress(payload.data(), payload.size(), raw.data(), raw.size(), 1));
    header.payload_bytes = static_cast<uint32_t>(payload.size());
    if (take_header) header.raw_bytes = info.strip.raw_bytes = static_cast<uint32_t>(raw.size());
    std::vector<std::byte> bytes = recordBytes(header);
    bytes.insert(bytes.end(), payload.begin(), payload.end());
    info.strip.stored_bytes = static_cast<uint32_t>(bytes.size());
    info.strip.checksum = hashBytes(bytes);
    return bytes;
  }

  Result<void> decode(std::span<const std::byte> bytes) const {
    Strip out;
    std::vector<PartnerName> partners;
    return decodeStripBytes(info, quanta, bytes, out, partners);
  }
};

// Two nodes, two blocks; row 0 has three entries (one of them large: four words), row 1 one.
Strip sampleStrip() {
  Strip s;
  s.id = {1, 7};
  s.first_node = 100;
  s.nodes.resize(2);
  for (Node& n : s.nodes) {
    n.area_m2 = 1;
    n.centroid = {0.5f, 0.5f, 0.5f};
    n.normal = {0, 1, 0};
    n.quanta = 1000;
    n.sky = 100;
  }
  s.nodes[1].absorbed = 895;
  s.blocks = {{0, 3}, {2, 1}};
  s.rows = {0, 0, 1, 0};
  s.columns = {3, 9, 4, 0};
  s.counts = {1, 7, 5, 892};
  s.lamps = {{1, 4, {0.25f, 0.25f, 0.5f}}, {1, 9, {2, 2, 2}}};
  return s;
}

// Tiles 0 to 2 in one chunk, 3 to 7 in the next.
std::vector<TileName> sampleNames() {
  std::vector<TileName> names;
  for (uint32_t t = 0; t < 3; ++t) names.push_back({{-1, 0, 4}, t});
  for (uint32_t t = 0; t < 5; ++t) names.push_back({{0, 0, 4}, t});
  return names;
}

OpenStrip sample() {
  auto encoded = encodeStrip(sampleStrip(), Box{{0, 0, 0}, {1, 1, 1}}, sampleNames());
  EXPECT_TRUE(encoded) << encoded.error().line();
  return OpenStrip(*encoded);
}

void expectRefused(const std::string& message, const std::function<void(OpenStrip&)>& damage) {
  SCOPED_TRACE(message);
  OpenStrip strip = sample();
  damage(strip);
  const auto read = strip.decode(strip.seal());
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, ErrorCode::kInvalidFile);
  EXPECT_EQ(read.error().place, "offset 8192");
  EXPECT_NE(read.error().message.find(message), std::string::npos) << read.error().line();
}

void setByte(OpenStrip& s, uint64_t at, int value) { s.raw[at] = static_cast<std::byte>(value); }

TEST(StripRules, TheUntouchedStripPasses) {
  OpenStrip strip = sample();
  const auto read = strip.decode(strip.seal());
  EXPECT_TRUE(read) << read.error().line();
}

TEST(StripRules, NodesHoldPossibleValues) {
  const auto f32 = [](OpenStrip& s, uint64_t at, float v) {  // of node 0
    for (uint64_t k = 0; k < 4; ++k) setByte(s, at + k * s.header.nodes, std::bit_cast<uint32_t>(v) >> (8 * k) & 255);
  };
  for (const float area : {0.0f, -1.0f, INFINITY, NAN})
    expectRefused("area", [&](OpenStrip& s) { f32(s, s.layout().area(), area); });
  for (const float emission : {-1.0f, 1.1e12f, 3e38f, INFINITY, NAN})
    expectRefused("emission", [&](OpenStrip& s) { f32(s, s.layout().emission() + 8, emission); });
  expectRefused("sky direction", [](OpenStrip& s) {
    setByte(s, s.layout().skyDirection(), 100);
    setByte(s, s.layout().skyDirection() + 2, 100);
  });
  expectRefused("sky direction", [](OpenStrip& s) { setByte(s, s.layout().skyDirection(), 128); });
  expectRefused("normal", [](OpenStrip& s) {
    setByte(s, s.layout().normal(), 0);
    setByte(s, s.layout().normal() + 2, 0x80);
  });
}

TEST(StripRules, LampsAndSkyHoldPossibleValues) {
  const auto u16 = [](OpenStrip& s, uint64_t at, uint64_t n, uint64_t i, uint32_t v) {
    setByte(s, at + i, v & 255);
    setByte(s, at + n + i, v >> 8);
  };
  expectRefused("sky fraction", [&](OpenStrip& s) { u16(s, s.layout().skyFraction(), 2, 0, kFractionOne + 1); });
  expectRefused("sky quadratic", [&](OpenStrip& s) { setByte(s, s.layout().skyQuadratic() + 2 * 4, 128); });
  expectRefused("row total", [&](OpenStrip& s) { u16(s, s.layout().rowTotal(), 2, 1, 0xffff); });
  expectRefused("weight", [&](OpenStrip& s) { u16(s, s.layout().lampWeights(), 2, 0, kFractionOne + 1); });
  expectRefused("weight", [&](OpenStrip& s) { u16(s, s.layout().lampWeights() + 8, 2, 1, 1); });  // 2 and a step in blue
  expectRefused("not in order", [&](OpenStrip& s) { u16(s, s.layout().lampGroups(), 2, 1, 4); });
  expectRefused("not in order", [&](OpenStrip& s) { u16(s, s.layout().lampGroups(), 2, 1, kNoLampGroup); });
  expectRefused("contradict", [&](OpenStrip& s) { u16(s, s.layout().lampCount(), 2, 1, 9); });
  expectRefused("contradict", [&](OpenStrip& s) { u16(s, s.layout().lampCount(), 2, 0, 0xffff); });
}

TEST(StripRules, RowsCloseExactly) {
  expectRefused("quanta", [](OpenStrip& s) { setByte(s, s.layout().sky(), 101); });
  expectRefused("quanta", [](OpenStrip& s) { setByte(s, s.layout().quanta() + 1, 0xe9); });
  expectRefused("quanta", [](OpenStrip& s) { setByte(s, s.layout().counts(), 2); });
}

// What the streamer holds ready for a strip rests on this (residentBytesBound).
TEST(StripRules, ARowHasAFewTimesTheWorldsSamplesAtMost) {
  OpenStrip strip = sample();
  strip.quanta = (1000 + kMaxRowFactor - 1) / kMaxRowFactor;
  EXPECT_TRUE(strip.decode(strip.seal()));
  expectRefused("node 0: its row has 1000 samples, in this world a row has 992 at most", [&](OpenStrip& s) { s.quanta = strip.quanta - 1; });
  EXPECT_EQ(maxRowQuanta(8192), kMaxQuanta);
  EXPECT_EQ(maxRowQuanta(kMaxQuanta), kMaxQuanta);
}

TEST(StripRules, BlocksAreInOrderAndComplete) {
  expectRefused("repeats its partner", [](OpenStrip& s) { setByte(s, s.layout().blockSteps() + 1, 0); });
  expectRefused("number of runs or words contradict", [](OpenStrip& s) { setByte(s, s.layout().blockRuns(), 0); });
  expectRefused("number of runs or words contradict", [](OpenStrip& s) { setByte(s, s.layout().blockRuns() + 1, 0xff); });
  expectRefused("do not add up to the strip's entries", [](OpenStrip& s) { s.info.entries = s.header.entries = 3; });
  expectRefused("do not add up to the strip's blocks", [](OpenStrip& s) { setByte(s, s.layout().chunkBlocks(), 1); });
  expectRefused("do not add up to the strip's blocks", [](OpenStrip& s) { setByte(s, s.layout().chunkBlocks(), 3); });
  expectRefused("do not add up to the strip's blocks", [](OpenStrip& s) { setByte(s, s.layout().chunkBlocks() + 3, 0xff); });
}

// The same strip decoded into words is refused where it is refused as arrays, and else has the entries of `arrays`.
void expectSameAsWords(const TileInfo& info, uint32_t quanta, std::span<const std::byte> bytes, bool accepted, const Strip& arrays) {
  static RowWords words;  // as between strips
  Strip out;
  std::vector<PartnerName> partners;
  ASSERT_EQ(decodeStripBytes(info, quanta, bytes, out, partners, &words).has_value(), accepted);
  if (!accepted) return;
  EXPECT_TRUE(out.rows.empty() && out.columns.empty() && out.counts.empty());
  ASSERT_EQ(words.run_start.size(), arrays.nodes.size() + 1);
  ASSERT_EQ(words.row_start.size(), arrays.nodes.size() + 1);
  std::map<std::tuple<uint32_t, uint32_t, uint32_t>, uint32_t> expected, found;  // count by row, block and column
  size_t e = 0;
  for (uint32_t b = 0; b < arrays.blocks.size(); ++b)
    for (const size_t end = e + arrays.blocks[b].entries; e < end; ++e) expected[{arrays.rows[e], b, arrays.columns[e]}] = arrays.counts[e];
  size_t word = 0, runs = 0;
  for (uint32_t r = 0; r < arrays.nodes.size(); ++r) {
    ASSERT_EQ(words.row_start[r], word);
    ASSERT_EQ(words.run_start[r], runs);
    uint64_t partners_of_row = 0;
    for (; runs < words.run_start[r + 1]; ++runs) {
      const RowWords::Run& run = words.runs[runs];
      ASSERT_TRUE(runs == words.run_start[r] || run.partner > words.runs[runs - 1].partner);
      partners_of_row |= uint64_t{1} << run.partner % 64;
      for (const size_t end = word + run.words; word < end; ++word) found[{r, run.partner, words.words[word] >> 8}] += words.words[word] & kMaxWordCount;
    }
    ASSERT_EQ(words.row_partners[r], partners_of_row);
  }
  EXPECT_EQ(word, words.words.size());
  EXPECT_EQ(runs, words.runs.size());
  EXPECT_EQ(found, expected);
}

TEST(StripRules, PartnersAreNamedFromTheStripsOwnChunk) {
  Strip strip = sampleStrip();
  strip.blocks = {{1, 2}, {2, 1}, {6, 1}};
  strip.rows = {0, 1, 0, 0};
  strip.columns = {3, 4, 9, 0};
  strip.counts = {1, 5, 7, 892};
  const auto encoded = encodeStrip(strip, Box{{0, 0, 0}, {1, 1, 1}}, sampleNames());
  ASSERT_TRUE(encoded) << encoded.error().line();
  EXPECT_EQ(encoded->name, (TileName{{0, 0, 4}, 4}));
  Strip out;
  std::vector<PartnerName> partners;
  ASSERT_TRUE(decodeStripBytes(encoded->info, 1000, encoded->bytes, out, partners));
  expectSameAsWords(encoded->info, 1000, encoded->bytes, true, out);  // a count of 892 is four words
  ASSERT_EQ(partners.size(), 3u);
  for (const auto& [k, step, tile, columns] : std::vector<std::tuple<size_t, int, uint32_t, uint32_t>>{{0, -1, 1, 5}, {1, -1, 2, 10}, {2, 0, 3, 1}}) {
    EXPECT_EQ(partners[k].step, (ChunkCell{step, 0, 0}));
    EXPECT_EQ(partners[k].tile, tile);
    EXPECT_EQ(partners[k].columns, columns);
  }
  // The bytes are the same where the whole world is moved by chunks.
  std::vector<TileName> moved = sampleNames();
  for (TileName& name : moved) name.chunk[0] += 1000, name.chunk[1] -= 7;
  const auto again = encodeStrip(strip, Box{{0, 0, 0}, {1, 1, 1}}, moved);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->bytes, encoded->bytes);
}

TEST(StripRules, EntriesAreInOrderAndInRange) {
  expectRefused("row is outside", [](OpenStrip& s) { setByte(s, s.layout().rowSteps(), 2); });
  expectRefused("row is outside", [](OpenStrip& s) { setByte(s, s.layout().rowSteps() + 1, 1); });
  expectRefused("order", [](OpenStrip& s) { setByte(s, s.layout().columnSteps(), 0); });     // two entries of one column
  expectRefused("order", [](OpenStrip& s) { setByte(s, s.layout().firstColumns(), 251); });  // and a step of 6 past 255
  expectRefused("order", [](OpenStrip& s) {
    for (const uint64_t word : {2, 3}) setByte(s, s.layout().columnSteps() + word, 200);
  });
  expectRefused("count is zero", [](OpenStrip& s) { setByte(s, s.layout().counts() + 1, 0); });
}

// A count of 892 is 255 + 255 + 255 + 127.
TEST(StripRules, OnlyFullWordsGoOn) {
  const auto counts = [](OpenStrip& s) { return s.layout().counts() + 3; };
  const OpenStrip whole = sample();
  EXPECT_EQ(std::to_integer<int>(whole.raw[whole.layout().counts() + 3]), 255);
  EXPECT_EQ(std::to_integer<int>(whole.raw[whole.layout().counts() + 6]), 127);
  expectRefused("order", [&](OpenStrip& s) {
    setByte(s, counts(s), 254);
    setByte(s, counts(s) + 3, 128);
  });
  expectRefused("entries", [](OpenStrip& s) { setByte(s, s.layout().columnSteps() + 1, 1); });  // then there is one entry more
}

TEST(StripRules, RunsHaveTheirWords) {
  expectRefused("contradict", [](OpenStrip& s) { s.raw.pop_back(); });
  expectRefused("contradict", [](OpenStrip& s) { s.raw.push_back(std::byte{1}); });
  expectRefused("contradict", [](OpenStrip& s) { setByte(s, s.layout().runWords(), 0); });
  expectRefused("contradict", [](OpenStrip& s) { setByte(s, s.layout().runWords() + s.layout().runs, 255); });
}

// Runs of every length around those that are decoded at once, entries of several words in all places.
TEST(StripRules, RunsOfAllLengths) {
  Strip s;
  s.id = {0, 0};
  s.nodes.resize(256);
  for (uint32_t block = 0; block < 2; ++block) {
    s.blocks.push_back({block, 0});
    for (uint32_t row = 0; row < 256; ++row) {
      const uint32_t length = block == 0 ? row + 1 : 1 + row * 7 % 50;
      for (uint32_t k = 0; k < length; ++k) {
        s.rows.push_back(static_cast<uint8_t>(row));
        s.columns.push_back(static_cast<uint8_t>(256 - length + k));
        s.counts.push_back(static_cast<uint16_t>((row + k) % 17 == 0 ? 255 + (row + k) % 3 : (row + k) % 41 == 0 ? 700 : 1 + k % 5));
        ++s.blocks.back().entries;
        s.nodes[row].quanta += s.counts.back();
      }
    }
  }
  for (Node& n : s.nodes) {
    n.area_m2 = 1;
    n.normal = {0, 1, 0};
  }
  const std::vector<TileName> names{{{0, 0, 0}, 0}, {{0, 0, 0}, 1}};
  const auto encoded = encodeStrip(s, Box{{0, 0, 0}, {1, 1, 1}}, names);
  ASSERT_TRUE(encoded) << encoded.error().line();
  Strip out;
  std::vector<PartnerName> partners;
  const auto decoded = decodeStripBytes(encoded->info, kMaxQuanta, encoded->bytes, out, partners);
  ASSERT_TRUE(decoded) << decoded.error().line();
  EXPECT_EQ(out.rows, s.rows);
  EXPECT_EQ(out.columns, s.columns);
  EXPECT_EQ(out.counts, s.counts);
  EXPECT_EQ(partners[0].columns, 256u);
  expectSameAsWords(encoded->info, kMaxQuanta, encoded->bytes, true, out);
}

TEST(StripRules, SizesAgree) {
  expectRefused("disagree", [](OpenStrip& s) { s.info.nodes = 3; });
  expectRefused("disagree", [](OpenStrip& s) { ++s.info.entries; });
  expectRefused("contradict", [](OpenStrip& s) { s.header.chunks = 3; });
  expectRefused("contradict", [](OpenStrip& s) { s.header.blocks = 5; });
  expectRefused("contradict", [](OpenStrip& s) { s.info.nodes = s.header.nodes = 0; });
  expectRefused("contradict", [](OpenStrip& s) { s.info.nodes = s.header.nodes = 257; });
  // Sizes that would take gigabytes: refused before memory is taken, for the payload is a few hundred bytes.
  expectRefused("contradict", [](OpenStrip& s) { s.info.entries = s.header.entries = 0xffffffff; });
  OpenStrip strip = sample();
  strip.header.raw_bytes = strip.info.strip.raw_bytes = 0xfffffff0;
  EXPECT_FALSE(strip.decode(strip.seal(false)));
  strip.header.raw_bytes = strip.info.strip.raw_bytes = static_cast<uint32_t>(strip.raw.size()) + 4;
  EXPECT_FALSE(strip.decode(strip.seal(false)));
}

TEST(StripRules, ThePayloadIsOneFrame) {
  OpenStrip strip = sample();
  std::vector<std::byte> bytes = strip.seal();
  const auto sealAgain = [&] {
    ++strip.header.payload_bytes;
    std::vector<std::byte> head = recordBytes(strip.header);
    std::copy(head.begin(), head.end(), bytes.begin());
    strip.info.strip.stored_bytes = static_cast<uint32_t>(bytes.size());
    strip.info.strip.checksum = hashBytes(bytes);
  };
  bytes.push_back(std::byte{0});
  sealAgain();
  const auto read = strip.decode(bytes);
  ASSERT_FALSE(read);
  EXPECT_NE(read.error().message.find("one zstd frame"), std::string::npos) << read.error().line();
}

// Whatever the decoder accepts keeps the rules: the encoder, which checks them on its own, takes it back.
TEST(StripRules, RandomDamageIsRefusedOrHarmless) {
  std::mt19937_64 random(5);
  RandomWorldSettings settings;
  settings.level0_tiles = 3;
  settings.levels = 1;
  settings.max_tile_nodes = 40;
  settings.quanta = 300;
  const RandomWorld w = makeRandomWorld(settings);
  const auto names = nameTiles(w)[0];
  const auto encoded = encodeStrip(w.strips[0][0], w.bounds[0][0], names);
  ASSERT_TRUE(encoded);
  const OpenStrip whole(*encoded);
  int accepted = 0;
  for (int i = 0; i < 4000; ++i) {
    OpenStrip strip = whole;
    // Half of the damage in the entries, where the decoder has most to get wrong.
    const uint64_t from = i % 2 == 0 ? 0 : strip.layout().blockSteps();
    for (uint64_t n = 1 + random() % 3; n > 0; --n)
      setByte(strip, from + random() % (strip.raw.size() - from), static_cast<int>(random() & 255));
    if (random() % 8 == 0) strip.raw.resize(random() % strip.raw.size());
    const std::vector<std::byte> bytes = strip.seal();
    Strip out;
    std::vector<PartnerName> partners;
    const bool decoded = decodeStripBytes(strip.info, strip.quanta, bytes, out, partners).has_value();
    expectSameAsWords(strip.info, strip.quanta, bytes, decoded, out);
    if (!decoded) continue;
    // As World::decodeStrip resolves them; a name that is not there is refused by it.
    bool known = true;
    for (size_t b = 0; b < partners.size(); ++b) {
      TileName name{names[0].chunk, partners[b].tile};
      for (size_t a = 0; a < 3; ++a) name.chunk[a] = static_cast<int32_t>(static_cast<uint32_t>(name.chunk[a]) + static_cast<uint32_t>(partners[b].step[a]));
      const auto at = std::ranges::find(names, name);
      known = known && at != names.end();
      out.blocks[b].partner_tile = static_cast<uint32_t>(at - names.begin());
      known = known && (b == 0 || out.blocks[b].partner_tile > out.blocks[b - 1].partner_tile);
    }
    if (!known) continue;
    ++accepted;
    const auto again = encodeStrip(out, strip.info.bounds, names);
    ASSERT_TRUE(again) << again.error().line();
  }
  EXPECT_GT(accepted, 100);  // or the damage was never subtle
  EXPECT_LT(accepted, 3900);
}

TEST(Encoder, RefusesWhatTheFormatCannotHold) {
  const Box box{{0, 0, 0}, {1, 1, 1}};
  const auto refused = [&](const std::function<void(Strip&)>& damage) {
    Strip s = sampleStrip();
    damage(s);
    return !encodeStrip(s, box, sampleNames()).has_value();
  };
  EXPECT_FALSE(refused([](Strip&) {}));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes.clear(); }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].area_m2 = 0; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].albedo.y = 1.5f; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].albedo.y = NAN; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].normal.x = NAN; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].emission.z = -1; }));
  EXPECT_FALSE(refused([](Strip& s) { s.nodes[0].emission.z = kMaxEmission; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].emission.z = 1.1e12f; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].centroid.x = 2; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].sky_direction.x = 2; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].sky += 1; }));
  EXPECT_TRUE(refused([](Strip& s) { s.nodes[0].quanta = 1 << 16; }));
  EXPECT_TRUE(refused([](Strip& s) { s.counts[0] = 0; }));
  EXPECT_TRUE(refused([](Strip& s) { s.rows[0] = 1; }));
  EXPECT_TRUE(refused([](Strip& s) { s.rows[2] = 2; }));
  EXPECT_TRUE(refused([](Strip& s) { s.columns[1] = 3; }));
  EXPECT_TRUE(refused([](Strip& s) { s.columns.pop_back(); }));
  EXPECT_TRUE(refused([](Strip& s) { s.blocks.pop_back(); }));
  EXPECT_TRUE(refused([](Strip& s) { s.blocks[1].partner_tile = 0; }));
  EXPECT_TRUE(refused([](Strip& s) { s.blocks[1].partner_tile = 8; }));
  EXPECT_TRUE(refused([](Strip& s) { s.id.tile = 8; }));
}

}  // namespace
}  // namespace ff::formats
