// A world is there whole or not at all; what the caller gets wrong is refused.
#include <gtest/gtest.h>

#include <filesystem>
#include <set>

#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "formats/write/writer.h"
#include "tests/support/furnace_world.h"

namespace ff::formats {
namespace {

std::set<std::string> filesIn(const std::string& folder) {
  std::set<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) names.insert(entry.path().filename());
  return names;
}

EncodedStrip encoded(const RandomWorld& w, uint32_t level, uint32_t tile) {
  auto e = encodeStrip(w.strips[level][tile], w.bounds[level][tile], nameTiles(w)[level]);
  EXPECT_TRUE(e) << e.error().line();
  return std::move(*e);
}

TEST(Writer, LeavesNothingWhenItIsDroppedBeforeFinish) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  {
    auto writer = WorldWriter::create(folder.file("w.ffm"), 5000);
    ASSERT_TRUE(writer);
    for (uint32_t level = 3; level-- > 0;)
      for (uint32_t t = 0; t < w.strips[level].size(); ++t) ASSERT_TRUE(writer->addStrip(encoded(w, level, t)));
    ASSERT_TRUE(writer->addGeometry(w.geometry[0], w.info));
    EXPECT_FALSE(filesIn(folder.path()).empty());
  }
  EXPECT_TRUE(filesIn(folder.path()).empty());
}

TEST(Writer, LeavesTheOldWorldWhenANewOneIsDropped) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  ASSERT_TRUE(writeWorld(w, folder.file("w.ffm"), 1 << 28));
  const auto before = filesIn(folder.path());
  const auto manifest = readFile(folder.file("w.ffm")), rows = readFile(shardOf(folder.file("w.ffm")));
  {
    auto writer = WorldWriter::create(folder.file("w.ffm"));
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->addStrip(encoded(makeFurnaceWorld(64), 1, 0)));
  }
  EXPECT_EQ(filesIn(folder.path()), before);
  EXPECT_EQ(readFile(folder.file("w.ffm")), manifest);
  EXPECT_EQ(readFile(shardOf(folder.file("w.ffm"))), rows);
}

TEST(Writer, RemovesTheShardsOfALargerWorldThatItReplaces) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({.level0_tiles = 6});
  ASSERT_TRUE(writeWorld(w, folder.file("w.ffm"), 4200));
  EXPECT_GT(filesIn(folder.path()).size(), 5u);
  ASSERT_TRUE(writeWorld(makeFurnaceWorld(64), folder.file("w.ffm"), 1 << 28));
  EXPECT_EQ(filesIn(folder.path()), (std::set<std::string>{fileNameOf(shardOf(folder.file("w.ffm"))), fileNameOf(shardOf(folder.file("w.ffm"), kKindIndex)), "w.ffm"}));
}

TEST(Writer, WritesTheSameBytesAgain) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  ASSERT_TRUE(writeWorld(w, folder.file("a.ffm"), 1 << 28));
  ASSERT_TRUE(writeWorld(makeRandomWorld({}), folder.file("b.ffm"), 1 << 28));
  for (const uint32_t kind : {kKindRows, kKindGeometry, kKindIndex}) {
    const std::string a = shardOf(folder.file("a.ffm"), kind), b = shardOf(folder.file("b.ffm"), kind);
    EXPECT_EQ(readFile(a), readFile(b));
    EXPECT_EQ(fileNameOf(a).substr(1), fileNameOf(b).substr(1));
  }
}

TEST(Writer, RefusesStripsOutOfOrder) {
  TemporaryFolder folder;
  const RandomWorld w = makeFurnaceWorld(300);  // two tiles at level 0, one at level 1
  const auto refuses = [&](std::vector<TileId> order) {
    auto writer = WorldWriter::create(folder.file("w.ffm"));
    EXPECT_TRUE(writer);
    for (size_t i = 0; i + 1 < order.size(); ++i) EXPECT_TRUE(writer->addStrip(encoded(w, order[i].level, order[i].tile)));
    return !writer->addStrip(encoded(w, order.back().level, order.back().tile)) &&
           !writer->finish(w.info, w.parents);  // and it stays refused
  };
  EXPECT_TRUE(refuses({{1, 0}, {0, 1}}));
  EXPECT_TRUE(refuses({{1, 0}, {0, 0}, {0, 0}}));
  EXPECT_TRUE(refuses({{1, 0}, {0, 0}, {1, 0}}));
  EXPECT_TRUE(refuses({{0, 1}}));
}

TEST(Writer, RefusesToFinishWhatIsNotAWorld) {
  TemporaryFolder folder;
  const RandomWorld good = makeFurnaceWorld(300);
  const auto finishes = [&](const std::function<void(RandomWorld&)>& damage) {
    RandomWorld w = good;
    damage(w);
    return writeWorld(w, folder.file("w.ffm"), 1 << 28).has_value();
  };
  EXPECT_TRUE(finishes([](RandomWorld&) {}));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.strips[0].clear(); }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents[0].pop_back(); }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents[0][7] = 150; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents[0][6] = w.parents[0][7] = 9; }));  // a parent without children
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents.clear(); }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.cell_m = 0; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.bounds = Box{}; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.cell_m = NAN; }));
  EXPECT_TRUE(finishes([](RandomWorld& w) { w.info.quanta = 299 / kMaxRowFactor + 1; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.quanta = 299 / kMaxRowFactor; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.geometry.push_back({0, {}, {}}); }));  // of one tile of two
  // Siblings may stand anywhere in their tile.
  EXPECT_TRUE(finishes([](RandomWorld& w) { std::swap_ranges(w.parents[0].begin(), w.parents[0].begin() + 2, w.parents[0].begin() + 2); }));
  EXPECT_TRUE(finishes([](RandomWorld& w) { w.parents[0][7] = 9; }));
  // Parents of one tile in two: the level above in tiles of 100 and 50 nodes.
  EXPECT_FALSE(finishes([](RandomWorld& w) {
    Strip& whole = w.strips[1][0];
    Strip rest = whole;
    rest.id.tile = 1;
    rest.first_node = 100;
    rest.nodes.erase(rest.nodes.begin(), rest.nodes.begin() + 100);
    whole.nodes.resize(100);
    for (Strip* s : {&whole, &rest}) {
      s->blocks.clear(), s->rows.clear(), s->columns.clear(), s->counts.clear();
      for (Node& n : s->nodes) n.sky = n.quanta, n.absorbed = 0;
    }
    w.strips[1].push_back(rest);
    w.bounds[1].push_back(w.bounds[1][0]);
  }));
  // Siblings in two tiles: node 255 and 256 get one parent.
  EXPECT_FALSE(finishes([](RandomWorld& w) {
    for (uint32_t i = 0; i < 300; ++i) w.parents[0][i] = (i + 1) / 2 < 150 ? (i + 1) / 2 : 149;
  }));
}

TEST(Writer, RefusesNamesAndFoldersAtOnce) {
  TemporaryFolder folder;
  EXPECT_EQ(WorldWriter::create(folder.file("w.bin")).error().code, ErrorCode::kUsage);
  EXPECT_EQ(WorldWriter::create(folder.file(".ffm")).error().code, ErrorCode::kUsage);
  EXPECT_EQ(WorldWriter::create(folder.file("absent/w.ffm")).error().code, ErrorCode::kIo);
}

// Tiles must fit the tree of chunks.
TEST(Writer, RefusesNamesThatDoNotFitTheTree) {
  TemporaryFolder folder;
  const RandomWorld w = makeFurnaceWorld(512);  // two tiles at level 0, one at level 1
  const auto good = nameTiles(w);
  const auto finishes = [&](const std::function<void(std::vector<std::vector<TileName>>&)>& damage) {
    auto names = good;
    damage(names);
    auto writer = WorldWriter::create(folder.file("w.ffm"));
    for (uint32_t level = 2; level-- > 0;)
      for (uint32_t t = 0; t < w.strips[level].size(); ++t) {
        auto strip = encodeStrip(w.strips[level][t], w.bounds[level][t], names[level]);
        EXPECT_TRUE(strip) << strip.error().line();
        if (!writer->addStrip(std::move(*strip))) return false;
      }
    return writer->finish(w.info, w.parents).has_value();
  };
  EXPECT_TRUE(finishes([](auto&) {}));
  EXPECT_FALSE(finishes([](auto& n) { n[0][0].tile = 1; }));
  EXPECT_FALSE(finishes([](auto& n) { n[0][1].tile = 0; }));
  EXPECT_FALSE(finishes([](auto& n) { n[0][1].chunk[0] += 2, n[0][1].tile = 0; }));                           // of another parent
  EXPECT_FALSE(finishes([](auto& n) { n[0][1].chunk[1] += 1, n[0][1].tile = 0; }));  // child tiles in two chunks
}

}  // namespace
}  // namespace ff::formats
