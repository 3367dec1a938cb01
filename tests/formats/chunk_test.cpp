// The index: chunks' records read back, found by number and by name, shared while someone holds them; records whose checksum would be
// right but whose content is not.
#include "formats/codec/chunk.h"

#include <gtest/gtest.h>

#include <functional>
#include <random>

#include "formats/codec/bytes.h"
#include "formats/codec/checksum.h"
#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "tests/support/random_world.h"

namespace ff::formats {
namespace {

class ChunkTest : public testing::Test {
 protected:
  ChunkTest() : made_(makeRandomWorld({.level0_tiles = 40, .max_tile_nodes = 30, .levels = 4, .quanta = 8})) {
    EXPECT_TRUE(writeWorld(made_, folder_.file("w.ffm"), 1 << 28));
    auto opened = WholeWorld::open(folder_.file("w.ffm"));
    EXPECT_TRUE(opened) << opened.error().line();
    world_ = std::make_unique<WholeWorld>(std::move(*opened));
  }
  static uint32_t numberOf(const Chunk& chunk) {
    uint32_t child = 0;
    while (chunk.parent->firstTileOf(child) != chunk.firstTile()) ++child;
    return child;
  }
  Result<ChunkPtr> decode(const Chunk& chunk, std::span<const std::byte> raw) const {
    return decodeChunk(world_->info(), chunk.parent, numberOf(chunk), raw);
  }

  TemporaryFolder folder_;
  RandomWorld made_;
  std::unique_ptr<WholeWorld> world_;
};

TEST_F(ChunkTest, RecordsAreReadBackAsTheyWereWritten) {
  size_t chunks = 0;
  for (uint32_t level = 0; level < 4; ++level)
    for (const ChunkPtr& chunk : world_->chunks(level)) {
      const std::vector<std::byte> raw = encodeChunk(world_->info(), *chunk);
      const auto read = decode(*chunk, raw);
      ASSERT_TRUE(read) << read.error().line();
      EXPECT_EQ((*read)->cell, chunk->cell);
      EXPECT_EQ((*read)->parent_index, chunk->parent_index);
      EXPECT_EQ((*read)->tiles.size(), chunk->tiles.size());
      EXPECT_EQ(encodeChunk(world_->info(), **read), raw);
      ++chunks;
    }
  EXPECT_GT(chunks, 12u);
  EXPECT_GT(world_->root()->children.size(), 1u);
}

// Where a coarse cell has more nodes than a tile, what lies beneath it comes twice in the order of tiles.
TEST_F(ChunkTest, ACellMayHaveSeveralRecordsWhoseTilesAreNumberedOn) {
  size_t again = 0;
  for (uint32_t level = 0; level < 4; ++level)
    for (const ChunkPtr& chunk : world_->chunks(level)) {
      again += chunk->first_number > 0;
      for (uint32_t t = 0; t < chunk->tiles.size(); ++t) {
        const TileRef tile{chunk, t};
        const auto found = world_->tile(level, tile.name());
        ASSERT_TRUE(found) << found.error().line();
        EXPECT_EQ(found->id(), tile.id());
      }
    }
  EXPECT_GT(again, 0u);
}

TEST_F(ChunkTest, AWorldReadsOnlyTheWayToWhatIsAskedForAndForgetsItAgain) {
  auto world = World::open(folder_.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  std::weak_ptr<const Chunk> seen;
  {
    const auto tile = world->tile(TileId{0, 17}), again = world->tile(0, world_->ref({0, 17}).name());
    ASSERT_TRUE(tile && again);
    EXPECT_EQ(tile->id(), (TileId{0, 17}));
    EXPECT_EQ(tile->chunk, again->chunk);  // one object for all who hold it
    EXPECT_EQ(tile->info().first_node, world_->tiles(0)[17].first_node);
    seen = tile->chunk;
  }
  EXPECT_TRUE(seen.expired());
  const uint64_t node = world_->tiles(0)[17].first_node + world_->tiles(0)[17].nodes - 1;
  const auto by_node = world->tileOfNode(0, node);
  ASSERT_TRUE(by_node);
  EXPECT_EQ(by_node->id().tile, 17u);
  EXPECT_EQ(world->tile(TileId{0, 40}).error().code, ErrorCode::kUsage);
  EXPECT_EQ(world->tile(9, {}).error().code, ErrorCode::kUsage);
  EXPECT_EQ(world->tile(0, {{77, 0, 0}, 0}).error().code, ErrorCode::kUsage);
  EXPECT_EQ(world->tile(0, {by_node->chunk->cell, 5000}).error().code, ErrorCode::kUsage);
  EXPECT_EQ(world->tileOfNode(0, world_->levels()[0].nodes).error().code, ErrorCode::kUsage);
}

// Bit for bit: whether all of the index is in memory, or only what is on the way.
TEST_F(ChunkTest, StripsAreTheSameWhateverIsHeld) {
  const auto world = World::open(folder_.file("w.ffm"));
  ASSERT_TRUE(world);
  for (const TileInfo& tile : world_->tiles(0)) {
    const auto a = world->strip(tile.id), b = world_->strip(tile.id);
    ASSERT_TRUE(a && b);
    for (size_t k = 0; k < a->blocks.size(); ++k) ASSERT_EQ(a->blocks[k].partner_tile, b->blocks[k].partner_tile);
  }
}

TEST_F(ChunkTest, RecordsThatContradictThemselvesOrTheirParentAreRefused) {
  // The first chunk of level 1 that has several tiles.
  const ChunkPtr chunk = *std::ranges::find_if(world_->chunks(1), [](const ChunkPtr& c) { return c->tiles.size() > 2; });
  const size_t tiles = chunk->tiles.size(), children = kChunkHeaderBytes + tiles * kTileRecordBytes + chunk->parent_index.size();
  const auto refused = [&](const char* message, const std::function<void(std::vector<std::byte>&)>& damage) {
    std::vector<std::byte> raw = encodeChunk(world_->info(), *chunk);
    damage(raw);
    const auto read = decode(*chunk, raw);
    ASSERT_FALSE(read) << message;
    EXPECT_EQ(read.error().code, ErrorCode::kInvalidFile);
    EXPECT_EQ(read.error().place, chunkText(1, chunk->cell));
    EXPECT_NE(read.error().message.find(message), std::string::npos) << read.error().line() << "; expected: " << message;
  };
  const auto tile = [](size_t t, size_t field) { return kChunkHeaderBytes + t * kTileRecordBytes + field; };
  const auto u16 = [](size_t at, uint16_t v) { return [=](auto& raw) { storeLittle(raw.data() + at, v); }; };
  const auto u32 = [](size_t at, uint32_t v) { return [=](auto& raw) { storeLittle(raw.data() + at, v); }; };
  const auto u8 = [](size_t at, int v) { return [=](auto& raw) { raw[at] = static_cast<std::byte>(v); }; };
  refused("another chunk", u8(0, 'X'));
  refused("another chunk", u8(4, 2));
  refused("cannot be", u8(5, 1));  // geometry, above level 0
  refused("cannot be", u16(6, 0));
  refused("instead of", u16(6, 9));
  refused("cannot be", u32(8, 0));
  refused("cannot be", u32(8, 0xffffffff));
  refused("cannot be", u32(12, 0xffffffff));
  refused("instead of", [](auto& raw) { raw.pop_back(); });
  refused("instead of", [](auto& raw) { raw.push_back(std::byte{0}); });
  refused("cannot be", u32(16, 0xffffffff));
  refused("holds a value", u16(tile(0, 0), 0));
  refused("holds a value", u16(tile(0, 0), 257));
  refused("other nodes than its tiles", u16(tile(0, 0), static_cast<uint16_t>(chunk->tiles[0].nodes + 1)));
  refused("order of these", u16(tile(0, 2), 0xffff));
  refused("reserved", u32(tile(0, 10), 1));
  refused("bounds", u32(tile(1, 46), 0x7fc00000u));
  refused("bounds", u32(tile(1, 58), 0xff800000u));
  refused("holds a value", u32(tile(1, 18 + 12), 31));        // shorter than a header
  refused("holds a value", u32(tile(1, 18 + 16), 0xffffffff));
  refused("follow those of the tile before", u16(tile(1, 8), 0));
  refused("follow those of the tile before", u16(tile(1, 8), 0xffff));
  refused("follow those of the tile before", u16(tile(1, 6), 0xfff0));
  refused("follow those of the tile before", u16(tile(0, 4), 1));
  refused("parent is not there", u8(kChunkHeaderBytes + tiles * kTileRecordBytes, 255));
  uint32_t second = 1;  // a tile with the same parent tile as the one before
  while (chunk->tiles[second].parent_tile != chunk->tiles[second - 1].parent_tile) ++second;
  const auto withParent = [&](uint32_t t, uint8_t parent) {
    return [=, this](auto& raw) {
      Chunk c = *chunk;
      std::ranges::fill(std::span(c.parent_index).subspan(c.tiles[t].first_node - c.firstNode(), c.tiles[t].nodes), parent);
      raw = encodeChunk(world_->info(), c);
    };
  };
  refused("siblings in two tiles", withParent(second, chunk->parentIndexOf(second - 1)[0]));
  refused("without children", withParent(second, chunk->parentIndexOf(second)[0]));
  refused("a child outside it", u8(children, 8));
  refused("bounds that cannot be", u32(children + 32, 0x7fc00000u));
  refused("impossible size", u32(children + 4 + 12, 0));
  refused("impossible size", u32(children + 4 + 16, 0xffffffff));
  refused("numbers of tiles and nodes", [&](auto& raw) { storeLittle(raw.data() + children + kChildRecordBytes, uint64_t{0}); });
  refused("than its parent says", [&](auto& raw) {
    storeLittle(raw.data() + children + kChildRecordBytes + 8, chunk->children[0].counts[0].nodes + 1);
  });
}

// Whatever is accepted keeps the rules, and nothing crashes: damage of a few bytes in every record.
TEST_F(ChunkTest, RandomDamageIsRefusedOrHarmless) {
  std::mt19937_64 random(3);
  size_t refused = 0, all = 0;
  for (uint32_t level = 0; level < 4; ++level)
    for (const ChunkPtr& chunk : world_->chunks(level)) {
      const std::vector<std::byte> whole = encodeChunk(world_->info(), *chunk);
      for (int i = 0; i < 300; ++i, ++all) {
        std::vector<std::byte> raw = whole;
        for (uint64_t n = 1 + random() % 3; n > 0; --n) raw[random() % raw.size()] = static_cast<std::byte>(random() & 255);
        const auto read = decode(*chunk, raw);
        if (!read) {
          ++refused;
          continue;
        }
        for (uint32_t t = 0; t < (*read)->tiles.size(); ++t) {
          ASSERT_LE((*read)->tiles[t].nodes, kTileNodes);
          if (level > 0) {
            ASSERT_LT((*read)->childWith((*read)->tiles[t].first_child), (*read)->children.size());
          }
        }
        ASSERT_EQ(encodeChunk(world_->info(), **read).size(), raw.size());
      }
    }
  EXPECT_GT(refused, all / 4);
  EXPECT_LT(refused, all);
}

TEST_F(ChunkTest, ExtentsOutsideTheShardsAreRefusedBeforeMemoryIsTaken) {
  for (const auto& [field, value] : std::vector<std::pair<size_t, uint32_t>>{{0, 77}, {4, 0}, {12, 0xfffffff0u}}) {  // shard, offset, stored bytes
    RandomWorld made = made_;
    TemporaryFolder folder;
    ASSERT_TRUE(writeWorld(made, folder.file("w.ffm"), 1 << 28));
    std::vector<std::byte> manifest = readFile(folder.file("w.ffm"));
    // The root's section: kind 4; its first record's extent.
    const uint32_t sections = loadLittle<uint32_t>(manifest.data() + 12);
    for (uint32_t k = 0; k < sections; ++k) {
      std::byte* record = manifest.data() + kManifestHeaderBytes + k * kSectionRecordBytes;
      if (loadLittle<uint32_t>(record) != kSectionRoot) continue;
      const auto offset = loadLittle<uint64_t>(record + 8), stored = loadLittle<uint64_t>(record + 16);
      storeLittle(manifest.data() + offset + 12 + field, value);
      storeLittle(record + 32, hashBytes(std::span(manifest).subspan(offset, stored)));
    }
    storeLittle(manifest.data() + 24, hashBytes(std::span(manifest).subspan(kManifestHeaderBytes, sections * kSectionRecordBytes)));
    storeLittle(manifest.data() + 56, hashBytes(std::span(manifest).first(56)));
    writeFile(folder.file("w.ffm"), manifest);
    const auto world = World::open(folder.file("w.ffm"));
    ASSERT_FALSE(world) << field;
    EXPECT_NE(world.error().line().find("outside the shards"), std::string::npos) << world.error().line();
  }
}

}  // namespace
}  // namespace ff::formats
