// Damaged, cut off, swapped, stale and hostile files: each is refused with a clear error, none crashes or takes memory
// that its bytes do not back.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <new>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"
#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "formats/write/writer.h"
#include "tests/support/random_world.h"

namespace ff::formats {
namespace {

// Everything a careful user of the file looks at. Ok only if all of it can be read.
Result<void> readEverything(const std::string& path) {
  auto world = WholeWorld::open(path);
  if (!world) return world.error();
  for (uint32_t level = 0; level < world->levels().size(); ++level)
    for (const TileInfo& tile : world->tiles(level))
      if (auto strip = world->strip(tile.id); !strip) return strip.error();
  if (world->hasGeometry())
    for (uint32_t tile = 0; tile < world->tiles(0).size(); ++tile)
      if (auto geometry = world->geometry(tile); !geometry) return geometry.error();
  return {};
}

RandomWorldSettings smallWorld() {
  RandomWorldSettings s;
  s.level0_tiles = 2;
  s.max_tile_nodes = 5;
  s.levels = 2;
  s.quanta = 20;
  return s;
}

class Corruption : public testing::Test {
 protected:
  void SetUp() override {
    const auto written = writeWorld(makeRandomWorld(smallWorld()), manifest(), 1 << 28);
    ASSERT_TRUE(written) << written.error().line();
    ASSERT_TRUE(readEverything(manifest()));
    rows_ = shardOf(manifest());
    geometry_ = shardOf(manifest(), kKindGeometry);
    index_ = shardOf(manifest(), kKindIndex);
  }
  std::string manifest() const { return folder_.file("w.ffm"); }
  const std::string& rows() const { return rows_; }
  const std::string& geometry() const { return geometry_; }
  const std::string& index() const { return index_; }
  void expectRefused(const std::string& what) {
    const auto read = readEverything(manifest());
    ASSERT_FALSE(read) << what;
    EXPECT_EQ(read.error().code, ErrorCode::kInvalidFile) << what << ": " << read.error().line();
    EXPECT_FALSE(read.error().file.empty()) << what << ": " << read.error().line();
    EXPECT_FALSE(read.error().remedy.empty()) << what << ": " << read.error().line();
  }
  TemporaryFolder folder_;
  std::string rows_, geometry_, index_;
};

TEST_F(Corruption, EveryChangedByteIsNoticed) {
  for (const std::string& path : {manifest(), rows(), geometry(), index()}) {
    const std::vector<std::byte> bytes = readFile(path);
    ASSERT_GT(bytes.size(), 100u) << path;
    std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
    const auto put = [&](size_t i, std::byte b) {
      file.seekp(static_cast<std::streamoff>(i)).put(static_cast<char>(b)).flush();
    };
    for (size_t i = 0; i < bytes.size(); ++i) {
      // Every 64th byte of the shards' long zero runs is enough there.
      if (path != manifest() && i > 64 && i < 4032 && i % 64 != 0) continue;
      for (const std::byte flip : {std::byte{0x01}, std::byte{0xff}}) {
        put(i, bytes[i] ^ flip);
        expectRefused(path + " byte " + std::to_string(i));
      }
      put(i, bytes[i]);
    }
  }
  EXPECT_TRUE(readEverything(manifest()));
}

// Also cuts between records: 3 and 61 divide none of their sizes.
TEST_F(Corruption, ATruncatedFileIsNoticed) {
  for (const std::string& path : {manifest(), rows(), geometry(), index()}) {
    const std::vector<std::byte> bytes = readFile(path);
    for (size_t n = 0; n < bytes.size(); n += path == manifest() || n >= 4032 ? 3 : 61) {
      writeFile(path, std::span(bytes).first(n));
      expectRefused(path + " cut to " + std::to_string(n));
    }
    writeFile(path, bytes);
  }
}

TEST_F(Corruption, TrailingBytesAreNoticed) {
  for (const std::string& path : {manifest(), rows(), geometry(), index()}) {
    const std::vector<std::byte> bytes = readFile(path);
    std::vector<std::byte> longer = bytes;
    longer.push_back(std::byte{0});
    writeFile(path, longer);
    expectRefused(path);
    writeFile(path, bytes);
  }
}

// With every checksum right.
TEST_F(Corruption, BoundsThatCannotBeAreRefusedOnEveryAxis) {
  const RandomWorld w = makeRandomWorld(smallWorld());
  const auto openWith = [&](int axis, bool low, float value) -> Result<void> {
    const std::string path = folder_.file("odd.ffm");
    auto writer = WorldWriter::create(path);
    const auto names = nameTiles(w);
    for (size_t level = w.strips.size(); level-- > 0;)
      for (size_t tile = 0; tile < w.strips[level].size(); ++tile) {
        auto strip = encodeStrip(w.strips[level][tile], w.bounds[level][tile], names[level]);
        if (level == 0 && tile == 1) (low ? strip->info.bounds.lo : strip->info.bounds.hi)[axis] = value;
        EXPECT_TRUE(writer->addStrip(std::move(*strip)));
      }
    EXPECT_TRUE(writer->finish(w.info, w.parents));
    const auto world = WholeWorld::open(path);
    return world ? Result<void>{} : world.error();
  };
  const float infinity = std::numeric_limits<float>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_TRUE(openWith(axis, true, w.bounds[0][1].lo[axis]));
    for (const bool low : {false, true})
      for (const float value : {std::numeric_limits<float>::quiet_NaN(), low ? -infinity : infinity, low ? 1e20f : -1e20f}) {
        const auto opened = openWith(axis, low, value);
        ASSERT_FALSE(opened) << "axis " << axis << ", " << value;
        EXPECT_NE(opened.error().line().find("bounds that cannot be"), std::string::npos) << opened.error().line();
      }
  }
}

TEST_F(Corruption, AMissingShardIsAnInputError) {
  std::filesystem::remove(rows());
  const auto read = readEverything(manifest());
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, ErrorCode::kIo);
  EXPECT_EQ(read.error().file, rows());
}

TEST_F(Corruption, TheErrorNamesStripAndOffset) {
  auto world = WholeWorld::open(manifest());
  ASSERT_TRUE(world);
  const TileInfo tile = world->tiles(0)[1];
  std::vector<std::byte> bytes = readFile(rows());
  bytes[tile.strip.offset + 70] ^= std::byte{4};
  writeFile(rows(), bytes);
  const auto strip = world->strip(TileId{0, 1});
  ASSERT_FALSE(strip);
  EXPECT_EQ(strip.error().file, rows());
  EXPECT_EQ(strip.error().place, tileText(world->ref({0, 1})) + ", strip at offset " + std::to_string(tile.strip.offset));
  EXPECT_TRUE(world->strip(TileId{0, 0}));
  EXPECT_EQ(world->strip(TileId{0, 2}).error().code, ErrorCode::kUsage);
  EXPECT_EQ(world->strip(TileId{7, 0}).error().code, ErrorCode::kUsage);
}

TEST_F(Corruption, AStripIsNotTakenForAnother) {
  auto world = WholeWorld::open(manifest());
  ASSERT_TRUE(world);
  const std::vector<std::byte> bytes = readFile(rows());
  Strip out;
  for (const TileInfo& a : world->tiles(0)) {
    const auto stored = std::span(bytes).subspan(a.strip.offset, a.strip.stored_bytes);
    EXPECT_TRUE(world->decodeStrip(world->ref(a.id), stored, out));
    for (uint32_t level = 0; level < 2; ++level)
      for (const TileInfo& b : world->tiles(level))
        EXPECT_EQ(world->decodeStrip(world->ref(b.id), stored, out).has_value(), a.id == b.id);
  }
}

TEST_F(Corruption, DecodingFailsAtEveryLengthButTheRightOne) {
  auto world = WholeWorld::open(manifest());
  ASSERT_TRUE(world);
  const std::vector<std::byte> bytes = readFile(rows());
  const TileInfo tile = world->tiles(0)[0];
  Strip out;
  for (size_t n = 0; n < tile.strip.stored_bytes; ++n) {
    // A buffer of exactly n bytes, so that address sanitizers see a read past its end.
    const std::vector<std::byte> stored(bytes.begin() + static_cast<std::ptrdiff_t>(tile.strip.offset),
                                        bytes.begin() + static_cast<std::ptrdiff_t>(tile.strip.offset + n));
    ASSERT_FALSE(world->decodeStrip(world->ref(tile.id), stored, out)) << n;
  }
}

// Another bake of the same scene has strips with the same names at the same offsets; only the numbers differ.
TEST_F(Corruption, AStripLeftOverFromAnotherBakeIsNoticed) {
  RandomWorld other = makeRandomWorld(smallWorld());
  other.strips[0][1].nodes[0].area_m2 += 1;
  other.info.seed = 99;
  ASSERT_TRUE(writeWorld(other, folder_.file("other.ffm"), 1 << 28));
  const std::vector<std::byte> old_rows = readFile(shardOf(folder_.file("other.ffm")));
  ASSERT_EQ(old_rows.size(), readFile(rows()).size());
  writeFile(rows(), old_rows);
  expectRefused("shard of another bake");
}

// The same with a valid index: a single strip is replaced, with a checksum that is right for its place.
TEST_F(Corruption, ASingleStaleStripIsNoticed) {
  RandomWorld other = makeRandomWorld(smallWorld());
  other.strips[0][1].nodes[0].area_m2 += 1;
  ASSERT_TRUE(writeWorld(other, folder_.file("other.ffm"), 1 << 28));
  auto world = WholeWorld::open(manifest());
  auto other_world = WholeWorld::open(folder_.file("other.ffm"));
  ASSERT_TRUE(world && other_world);
  const TileInfo a = world->tiles(0)[1], b = other_world->tiles(0)[1];
  ASSERT_EQ(a.strip.offset, b.strip.offset);
  ASSERT_EQ(a.strip.stored_bytes, b.strip.stored_bytes);
  std::vector<std::byte> bytes = readFile(rows());
  const std::vector<std::byte> stale = readFile(shardOf(folder_.file("other.ffm")));
  const auto begin = stale.begin() + static_cast<std::ptrdiff_t>(b.strip.offset);
  std::copy_n(begin, b.strip.stored_bytes, bytes.begin() + static_cast<std::ptrdiff_t>(a.strip.offset));
  writeFile(rows(), bytes);
  EXPECT_FALSE(world->strip(a.id));
}

TEST_F(Corruption, NewerFilesAreRefusedByName) {
  for (const std::string& path : {manifest(), rows()}) {
    const std::vector<std::byte> good = readFile(path);
    std::vector<std::byte> bytes = good;
    bytes[10] = std::byte{kFormatVersion + 1};  // reader version
    writeFile(path, bytes);
    const auto read = readEverything(manifest());
    ASSERT_FALSE(read);
    EXPECT_NE(read.error().line().find("version " + std::to_string(kFormatVersion + 1)), std::string::npos) << read.error().line();
    writeFile(path, good);
  }
}

TEST_F(Corruption, UnusedBytesAreIgnoredAndReservedOnesRefused) {
  const std::vector<std::byte> good = readFile(rows());
  const auto withByte = [&](size_t at) {
    std::vector<std::byte> bytes = good;
    bytes[at] = std::byte{1};
    storeLittle(bytes.data() + kShardHeaderBytes - 8, hashBytes(std::span(bytes).first(kShardHeaderBytes - 8)));
    writeFile(rows(), bytes);
    return readEverything(manifest());
  };
  for (const size_t unused : {2048, 3000, 4087}) EXPECT_TRUE(withByte(unused)) << unused;
  for (const size_t reserved : {16, 1000, 2047}) {
    const auto read = withByte(reserved);
    ASSERT_FALSE(read) << reserved;
    EXPECT_NE(read.error().message.find("reserved"), std::string::npos) << read.error().line();
  }
}

TEST(Manifest, IsNotTakenFromOtherFiles) {
  TemporaryFolder folder;
  writeFile(folder.file("empty.ffm"), {});
  EXPECT_EQ(WholeWorld::open(folder.file("empty.ffm")).error().code, ErrorCode::kInvalidFile);
  EXPECT_EQ(WholeWorld::open(folder.file("absent.ffm")).error().code, ErrorCode::kIo);
  EXPECT_EQ(WholeWorld::open(folder.path()).error().code, ErrorCode::kIo);
  writeFile(folder.file("zeros.ffm"), std::vector<std::byte>(10000));
  EXPECT_EQ(WholeWorld::open(folder.file("zeros.ffm")).error().code, ErrorCode::kInvalidFile);
}

}  // namespace
}  // namespace ff::formats
