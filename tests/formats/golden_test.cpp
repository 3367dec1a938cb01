// A small world as version 3 wrote it: tests/golden/furnace_v3.hex, with its expected content in
// furnace_world.h. Old files must stay readable, and the same calls must give the same bytes.
#include <gtest/gtest.h>
#include <zstd.h>

#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>

#include "formats/codec/records.h"
#include "formats/read/whole_world.h"
#include "tests/support/furnace_world.h"

namespace ff::formats {
namespace {

constexpr uint32_t kPatches = 24;
using Files = std::map<std::string, std::vector<std::byte>>;

RandomWorld goldenWorld() {
  RandomWorld w = makeFurnaceWorld(kPatches);
  TileGeometry g;
  for (uint32_t i = 0; i < kPatches; ++i) {
    const Vec3 p = w.strips[0][0].nodes[i].centroid;
    g.patch.push_back(static_cast<uint8_t>(i));
    for (const Vec3& corner : {p, p + Vec3{1, 0, 0}, p + Vec3{0, 1, 0}}) g.positions.push_back(corner);
  }
  w.geometry.push_back(g);
  w.strips[0][0].nodes[3].normal = {0, -1, 0};
  w.strips[0][0].nodes[4].sky_direction = {0, 1, 0};
  w.strips[0][0].nodes[4].sky_fraction = 0.375f;
  w.strips[0][0].nodes[4].sky_quadratic = {0, 0, 0, 1, 0};
  w.strips[0][0].nodes[5].row_total = 1.25f;
  for (uint32_t level = 0; level < 2; ++level)
    for (Node& node : w.strips[level][0].nodes) node.lamp_group = 0;
  w.strips[0][0].lamps = {{2, 0, {0.5f, 0.25f, 0}}, {9, 0, {0.125f, 0.125f, 0.125f}}};
  w.info.lamp_groups = {{"lamp", {1, 0, 0}, 12, 12}};
  return w;
}

// "file NAME", then lines of hex bytes, or "zeros N".
Files readGolden() {
  Files files;
  std::ifstream in(FF_GOLDEN "/furnace_v3.hex");
  std::string line, name;
  while (std::getline(in, line)) {
    std::istringstream words(line);
    std::string word;
    words >> word;
    if (word == "file") words >> name;
    else if (word == "zeros") {
      size_t n = 0;
      words >> n;
      files[name].resize(files[name].size() + n);
    } else if (word != "#") {
      for (size_t i = 0; i + 1 < word.size(); i += 2)
        files[name].push_back(static_cast<std::byte>(std::stoul(word.substr(i, 2), nullptr, 16)));
    }
  }
  return files;
}

void writeGolden(const Files& files, const std::string& path) {
  std::ofstream out(path);
  out << "# A world as format version 3 wrote it; see golden_test.cpp.\n";
  for (const auto& [name, bytes] : files) {
    out << "file " << name << "\n";
    for (size_t i = 0; i < bytes.size();) {
      size_t zeros = 0;
      while (i + zeros < bytes.size() && bytes[i + zeros] == std::byte{0}) ++zeros;
      if (zeros >= 64) {
        out << "zeros " << zeros << "\n";
        i += zeros;
        continue;
      }
      static const char kDigits[] = "0123456789abcdef";
      for (size_t k = 0; k < 32 && i < bytes.size(); ++k, ++i)
        out << kDigits[std::to_integer<size_t>(bytes[i]) >> 4] << kDigits[std::to_integer<size_t>(bytes[i]) & 15];
      out << "\n";
    }
  }
}

Files writeNow(const TemporaryFolder& folder) {
  EXPECT_TRUE(writeWorld(goldenWorld(), folder.file("furnace.ffm"), 1 << 28));
  Files files;
  const std::string manifest = folder.file("furnace.ffm");
  for (const std::string& path : {manifest, shardOf(manifest), shardOf(manifest, kKindGeometry), shardOf(manifest, kKindIndex)}) files[fileNameOf(path)] = readFile(path);
  return files;
}

TEST(Golden, Version3StaysReadable) {
  TemporaryFolder folder;
  const Files files = readGolden();
  ASSERT_EQ(files.size(), 4u) << "tests/golden/furnace_v3.hex is missing";
  for (const auto& [name, bytes] : files) writeFile(folder.file(name), bytes);
  auto world = WholeWorld::open(folder.file("furnace.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  const RandomWorld expected = goldenWorld();
  ASSERT_EQ(world->levels().size(), 2u);
  EXPECT_EQ(world->info().scene, "furnace");
  for (uint32_t level = 0; level < 2; ++level) {
    auto strip = world->strip(TileId{level, 0});
    ASSERT_TRUE(strip) << strip.error().line();
    const Strip& e = expected.strips[level][0];
    EXPECT_EQ(strip->rows, e.rows);
    EXPECT_EQ(strip->columns, e.columns);
    EXPECT_EQ(strip->counts, e.counts);
    ASSERT_EQ(strip->nodes.size(), e.nodes.size());
    ASSERT_EQ(strip->lamps.size(), e.lamps.size());
    for (size_t k = 0; k < e.lamps.size(); ++k) EXPECT_EQ(strip->lamps[k].weight, e.lamps[k].weight);
    for (size_t i = 0; i < e.nodes.size(); ++i) {
      EXPECT_EQ(strip->nodes[i].area_m2, e.nodes[i].area_m2);
      EXPECT_EQ(strip->nodes[i].normal, e.nodes[i].normal);
      EXPECT_EQ(strip->nodes[i].emission, e.nodes[i].emission);
      EXPECT_EQ(strip->nodes[i].sky_direction, e.nodes[i].sky_direction);
      EXPECT_EQ(strip->nodes[i].sky_fraction, e.nodes[i].sky_fraction);
      EXPECT_EQ(strip->nodes[i].sky_quadratic, e.nodes[i].sky_quadratic);
      EXPECT_EQ(strip->nodes[i].row_total, e.nodes[i].row_total);
      EXPECT_EQ(strip->nodes[i].lamp_group, 0);
      // Centroids lie at eighths of the box, whose nearest 16-bit fraction is at most half a step off.
      EXPECT_LE(length(strip->nodes[i].centroid - e.nodes[i].centroid), 1.8f * 0.5f * 8 / 65535);
      EXPECT_NEAR(strip->nodes[i].albedo.y, 0.5f, 0.5f / 65535);
    }
  }
  ASSERT_EQ(world->info().lamp_groups.size(), 1u);
  EXPECT_EQ(world->info().lamp_groups[0].name, "lamp");
  EXPECT_EQ(world->info().lamp_groups[0].emission, (Vec3{1, 0, 0}));
  auto geometry = world->geometry(0);
  ASSERT_TRUE(geometry) << geometry.error().line();
  EXPECT_EQ(geometry->patch, expected.geometry[0].patch);
}

TEST(Golden, TheWriterStillWritesTheseBytes) {
  TemporaryFolder folder;
  const Files now = writeNow(folder);
  if (const char* path = std::getenv("FF_WRITE_GOLDEN")) writeGolden(now, path);  // for the next version's file
  if (ZSTD_versionNumber() != 10504) GTEST_SKIP() << "zstd is not 1.5.4: its frames may differ, and may";
  for (const auto& [name, bytes] : readGolden()) EXPECT_EQ(now.contains(name) ? now.at(name) : Files::mapped_type(), bytes) << name;
}

}  // namespace
}  // namespace ff::formats
