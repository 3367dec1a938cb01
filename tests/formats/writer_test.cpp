// A world is there whole or not at all; what the caller gets wrong is refused.
#include <gtest/gtest.h>

#include <filesystem>
#include <set>

#include "formats/manifest.h"
#include "formats/parent_links.h"
#include "formats/reader.h"
#include "formats/writer.h"
#include "tests/support/furnace_world.h"

namespace ff::formats {
namespace {

std::set<std::string> filesIn(const std::string& folder) {
  std::set<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) names.insert(entry.path().filename());
  return names;
}

EncodedStrip encoded(const RandomWorld& w, uint32_t level, uint32_t tile) {
  auto e = encodeStrip(w.strips[level][tile], w.bounds[level][tile]);
  EXPECT_TRUE(e) << e.error().line();
  return std::move(*e);
}

TEST(Writer, LeavesNothingWhenItIsDroppedBeforeFinish) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  {
    auto writer = WorldWriter::create(folder.file("w.ffm"), 5000);
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->addStrip(encoded(w, 2, 0)));
    ASSERT_TRUE(writer->addGeometry(w.geometry[0]));
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
  EXPECT_EQ(filesIn(folder.path()), (std::set<std::string>{fileNameOf(shardOf(folder.file("w.ffm"))), "w.ffm"}));
}

TEST(Writer, WritesTheSameBytesAgain) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  ASSERT_TRUE(writeWorld(w, folder.file("a.ffm"), 1 << 28));
  ASSERT_TRUE(writeWorld(makeRandomWorld({}), folder.file("b.ffm"), 1 << 28));
  for (const bool geometry : {false, true}) {
    const std::string a = shardOf(folder.file("a.ffm"), geometry), b = shardOf(folder.file("b.ffm"), geometry);
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
           !writer->finish(w.info, w.parents, w.cell_m, {});  // and it stays refused
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
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents[0][7] = 9; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents[0].back() = 148; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.parents.clear(); }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.cell_m.pop_back(); }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.cell_m[0] = 0; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.bounds = Box{}; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.cell_m = NAN; }));
  EXPECT_TRUE(finishes([](RandomWorld& w) { w.info.quanta = 299 / kMaxRowFactor + 1; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.info.quanta = 299 / kMaxRowFactor; }));
  EXPECT_FALSE(finishes([](RandomWorld& w) { w.geometry.push_back({0, {}, {}}); }));  // of one tile of two
  EXPECT_FALSE(finishes([](RandomWorld& w) { std::swap_ranges(w.parents[0].begin(), w.parents[0].begin() + 2, w.parents[0].begin() + 2); }));
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

TEST(Writer, LeavesOutAGridThatAReaderWouldRefuse) {
  TemporaryFolder folder;
  RandomWorld w = makeFurnaceWorld(300);
  for (const size_t more : {0, 1}) {
    w.grid.assign(maxGridBytes(300) + more, std::byte{1});
    std::vector<std::string> warnings;
    ASSERT_TRUE(writeWorld(w, folder.file("w.ffm"), 1 << 28, posixStorage(), &warnings));
    EXPECT_EQ(warnings.size(), more);
    const auto world = World::open(folder.file("w.ffm"));
    ASSERT_TRUE(world) << world.error().line();
    EXPECT_EQ(world->spatialGrid().size(), more == 0 ? w.grid.size() : 0);
  }
}

TEST(Writer, RefusesNamesAndFoldersAtOnce) {
  TemporaryFolder folder;
  EXPECT_EQ(WorldWriter::create(folder.file("w.bin")).error().code, ErrorCode::kUsage);
  EXPECT_EQ(WorldWriter::create(folder.file(".ffm")).error().code, ErrorCode::kUsage);
  EXPECT_EQ(WorldWriter::create(folder.file("absent/w.ffm")).error().code, ErrorCode::kIo);
}

TEST(ParentLinks, RankAndSelectAgreeWithCounting) {
  for (const uint32_t nodes : {1u, 63u, 64u, 65u, 1000u}) {
    std::vector<uint64_t> words((nodes + 63) / 64);
    std::vector<uint32_t> parents;
    for (uint32_t i = 0; i < nodes; ++i) {
      const bool starts = i == 0 || (i * 2654435761u >> 16) % 3 == 0 || (i > 200 && i < 400 && i % 64 == 63);
      words[i / 64] |= uint64_t{starts} << (i % 64);
      parents.push_back(i == 0 ? 0 : parents.back() + (starts ? 1 : 0));
    }
    const ParentLinks links(words, nodes);
    ASSERT_EQ(links.parents(), parents.back() + 1);
    for (uint32_t i = 0; i < nodes; ++i) {
      ASSERT_EQ(links.parent(i), parents[i]) << i;
      const auto [first, last] = links.children(parents[i]);
      ASSERT_TRUE(first <= i && i < last);
      ASSERT_TRUE(parents[first] == parents[i] && parents[last - 1] == parents[i]);
      ASSERT_TRUE(last == nodes || parents[last] == parents[i] + 1);
    }
  }
}

}  // namespace
}  // namespace ff::formats
