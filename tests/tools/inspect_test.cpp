// ffinspect as users run it: exit codes, what it names, what it exports.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <nlohmann/json.hpp>
#include <sstream>

#include "formats/read/whole_world.h"
#include "tests/support/furnace_world.h"
#include "tests/support/simulated_world.h"
#include "tools/inspect/world_check.h"

namespace ff::tools {
namespace {

using namespace ff::formats;

struct Outcome {
  int code = -1;
  std::string text;  // stdout and stderr
};

Outcome inspect(const std::string& arguments) {
  Outcome run;
  std::FILE* pipe = ::popen((std::string(FF_INSPECT) + " " + arguments + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return run;
  char buffer[4096];
  for (size_t n = 0; (n = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) run.text.append(buffer, n);
  const int status = ::pclose(pipe);
  run.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return run;
}

class Inspect : public testing::Test {
 protected:
  void SetUp() override { write(makeFurnaceWorld(300)); }
  void write(const RandomWorld& w) {
    const auto ok = writeWorld(w, world(), 1 << 28);
    ASSERT_TRUE(ok) << ok.error().line();
  }
  std::string world() const { return folder_.file("f.ffm"); }
  // All of one lamp group, of whose emission half arrives at even patches and a quarter at odd ones.
  static RandomWorld worldWithLamps() {
    RandomWorld w = makeFurnaceWorld(300);
    w.info.lamp_groups = {{"candle", {1, 0, 0}, 150, 150}};
    for (size_t level = 0; level < w.strips.size(); ++level)
      for (Strip& strip : w.strips[level])
        for (size_t i = 0; i < strip.nodes.size(); ++i) {
          strip.nodes[i].lamp_group = 0;
          const float weight = level == 1 ? 0.375f : i % 2 == 0 ? 0.5f : 0.25f;
          strip.lamps.push_back({static_cast<uint8_t>(i), 0, {weight, 0, 0}});
        }
    return w;
  }
  TemporaryFolder folder_;
};

// At the far end of 1.7e10 patches: numbers of nodes there do not fit 32 bits.
TEST_F(Inspect, LooksAtPlacesOfAWorldOfMoreThanTwoToThe32Patches) {
  ASSERT_TRUE(writeSimulatedWorld(world(), 12));
  const nlohmann::json info = nlohmann::json::parse(inspect("info --json " + world()).text);
  EXPECT_EQ(info["levels"][0]["nodes"], (uint64_t{1} << 22) * 16 * 248);
  EXPECT_EQ(info["levels"][0]["tiles"], (uint64_t{1} << 22) * 16);
  EXPECT_NEAR(info["levels"][0]["bytes_per_node"].get<double>(), info["levels"][3]["bytes_per_node"].get<double>(), 20);
  EXPECT_NE(inspect("info " + world()).text.find("\n    0  16642998272   67108864 "), std::string::npos) << inspect("info " + world()).text;
  // Of the chunk in the last corner, as of one that stands alone.
  const TemporaryFolder folder;
  ASSERT_TRUE(writeSimulatedWorld(folder.file("one.ffm"), 2));
  const auto read = [](const std::string& arguments) { return nlohmann::json::parse(inspect(arguments).text); };
  const auto far = read("row --json " + world() + " 0 2047,0,2047 15 247"), near = read("row --json " + folder.file("one.ffm") + " 0 1,0,1 15 247");
  EXPECT_EQ(far["sky"], near["sky"]);
  ASSERT_EQ(far["entries"].size(), near["entries"].size());
  for (size_t k = 0; k < near["entries"].size(); ++k) {
    EXPECT_EQ(far["entries"][k]["count"], near["entries"][k]["count"]);
    EXPECT_EQ(far["entries"][k]["column"]["index"], near["entries"][k]["column"]["index"]);
  }
  const std::string index = std::to_string(near["entries"].back()["column"]["index"].get<int>()), tile = std::to_string(near["entries"].back()["column"]["tile"].get<int>());
  EXPECT_EQ(read("pair --json " + world() + " 0 2047,0,2047 15 247 2047,0,2047 " + tile + " " + index)["count_ij"], near["entries"].back()["count"]);
  const Outcome whole = inspect("verify " + world());
  EXPECT_EQ(whole.code, 1);
  EXPECT_NE(whole.text.find("level 0 has 16642998272 nodes, and what reads a whole world numbers 4294967294 at most"), std::string::npos) << whole.text;
  // Tiles have numbers of 32 bits.
  ASSERT_TRUE(writeSimulatedWorld(world(), 15));
  const Outcome beyond = inspect("info " + world());
  EXPECT_EQ(beyond.code, 3);
  EXPECT_NE(beyond.text.find("level 0 has 4294967296 tiles, this reader numbers 4294967294 at most"), std::string::npos) << beyond.text;
}

TEST_F(Inspect, VerifiesABalancedWorld) {
  const Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 0) << run.text;
  EXPECT_NE(run.text.find("\nok\n"), std::string::npos) << run.text;
}

TEST_F(Inspect, ComparesEveryPairOnce) {
  auto w = WholeWorld::open(world());
  ASSERT_TRUE(w);
  for (const int threads : {1, 3}) {
    const WorldCheck check = checkWorld(*w, threads, nullptr);
    EXPECT_TRUE(check.corrupt.empty() && check.unphysical.empty());
    // 300 patches without their own pairs; 150 clusters with them.
    EXPECT_EQ(check.pairs, 300u * 299 / 2 + 150u * 151 / 2);
    EXPECT_EQ(check.entries, 300u * 299 + 150u * 150);
    EXPECT_EQ(check.worst_area, 0);
  }
}

TEST_F(Inspect, NamesStripAndOffsetOfAChangedByte) {
  auto w = WholeWorld::open(world());
  ASSERT_TRUE(w);
  const TileInfo tile = w->tiles(0)[1];
  const std::string shard = shardOf(world());
  std::vector<std::byte> bytes = readFile(shard);
  bytes[tile.strip.offset + tile.strip.stored_bytes / 2] ^= std::byte{1};
  writeFile(shard, bytes);
  const Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 3) << run.text;
  EXPECT_NE(run.text.find("tile 1 of chunk -2,0,2 of level 0, strip at offset " + std::to_string(tile.strip.offset)), std::string::npos) << run.text;
  EXPECT_EQ(run.text.find("tile 0 of chunk -2,0,2 of level 0"), std::string::npos) << run.text;  // only that one
  EXPECT_EQ(inspect("verify --json " + world()).code, 3);
  EXPECT_EQ(inspect("row " + world() + " 0 -2,0,2 0 5").code, 0);    // other strips can still be looked at
  EXPECT_EQ(inspect("row " + world() + " 0 -2,0,2 1 43").code, 3);
}

// Row 280 gives ten of its quanta for patch 7 to patch 8: closed, in order, and wrong. Each pair of the two loses
// reciprocity: 1 and 11 of 299 quanta are further apart than the one quantum a row that sampling allows.
TEST_F(Inspect, FindsARowThatContradictsItsPartner) {
  RandomWorld w = makeFurnaceWorld(300);
  Strip& s = w.strips[0][1];
  size_t e = 0;
  while (!(s.rows[e] == 280 - 256 && s.columns[e] == 8)) ++e;
  s.counts[e] = 11;
  size_t removed = 0;
  for (size_t k = s.blocks[0].entries; removed < 10;)  // block of partner tile 1
    if (s.rows[k] == 280 - 256) {
      s.rows.erase(s.rows.begin() + static_cast<std::ptrdiff_t>(k));
      s.columns.erase(s.columns.begin() + static_cast<std::ptrdiff_t>(k));
      s.counts.erase(s.counts.begin() + static_cast<std::ptrdiff_t>(k));
      --s.blocks[1].entries;
      ++removed;
    } else {
      ++k;
    }
  write(w);
  const Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4) << run.text;
  EXPECT_NE(run.text.find("nodes -2,0,2 0 8 and -2,0,2 1 24 disagree"), std::string::npos) << run.text;
  const Outcome pair = inspect("pair --json " + world() + " 0 -2,0,2 1 24 -2,0,2 0 8");
  EXPECT_EQ(pair.code, 0);
  const auto json = nlohmann::json::parse(pair.text);
  EXPECT_EQ(json["count_ij"], 11);
  EXPECT_EQ(json["count_ji"], 1);
  EXPECT_GT(json["of_allowed"], 1.0);
  // What the row of most deviation admits to is not granted to others, only its own total is: with an eleventh, its 11
  // quanta are as much as the partner's one, and its single ones within a quantum of theirs.
  w.info.row_total_deviation = 1;
  write(w);
  EXPECT_EQ(inspect("verify " + world()).code, 4);
  w.strips[0][1].nodes[280 - 256].row_total = 1.0f / 11;
  write(w);
  EXPECT_EQ(inspect("verify " + world()).code, 0) << inspect("verify " + world()).text;
}

// The other direction: an entry that nothing answers, below and above the diagonal of one tile and between two.
TEST_F(Inspect, FindsAnEntryThatNothingAnswers) {
  for (const auto& [tile, row, column_tile, column] :
       {std::array<uint32_t, 4>{0, 9, 0, 4}, {0, 4, 0, 9}, {0, 4, 1, 9}, {1, 9, 0, 4}}) {
    RandomWorld w = makeFurnaceWorld(300);
    Strip& s = w.strips[0][tile];
    size_t e = column_tile == 0 ? 0 : s.blocks[0].entries;
    while (!(s.rows[e] == row && s.columns[e] == column)) ++e;
    s.counts[e] = 5;
    s.nodes[row].quanta += 4;
    write(w);
    const Outcome run = inspect("verify " + world());
    EXPECT_EQ(run.code, 4) << run.text;
    EXPECT_NE(run.text.find("disagree"), std::string::npos) << run.text;
  }
}

TEST_F(Inspect, FindsAPyramidThatDoesNotAddUp) {
  RandomWorld w = makeFurnaceWorld(300);
  w.strips[1][0].nodes[17].area_m2 = 2.001f;
  write(w);
  Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4) << run.text;
  EXPECT_NE(run.text.find("tile 0 of chunk -1,0,1 of level 1"), std::string::npos) << run.text;
  EXPECT_NE(run.text.find("node 17: area"), std::string::npos) << run.text;
  w = makeFurnaceWorld(300);
  w.strips[0][1].nodes[2].emission = {0, 0, 1};
  write(w);
  run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4) << run.text;
  EXPECT_NE(run.text.find("node 129: emission"), std::string::npos) << run.text;
}

TEST_F(Inspect, FindsACountOfSkyThatContradictsTheFractionOfSky) {
  RandomWorld w = makeFurnaceWorld(300);
  Node& node = w.strips[0][0].nodes[7];
  node.sky_fraction = 1 / 299.0f;  // none of 299 quanta is within one of it
  write(w);
  EXPECT_EQ(inspect("verify " + world()).code, 0);
  node.sky_fraction = 3 / 299.0f;
  write(w);
  Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4);
  EXPECT_NE(run.text.find("node 7: 0 of 299 samples are sky"), std::string::npos) << run.text;
  w.info.rays = w.info.fewest_rays = 4096;  // of a hundredth, so many rays are off by 6 * 0.47 quanta and less
  write(w);
  EXPECT_EQ(inspect("verify " + world()).code, 0);
}

TEST_F(Inspect, FindsLampsThatDoNotAddUp) {
  write(worldWithLamps());
  EXPECT_EQ(inspect("verify " + world()).code, 0) << inspect("verify " + world()).text;
  RandomWorld w = worldWithLamps();
  w.strips[1][0].lamps[17].weight.x *= 1.001f;  // 12 bits are a quarter of that
  write(w);
  Outcome run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4);
  EXPECT_NE(run.text.find("node 17: light of lamp group 0"), std::string::npos) << run.text;
  // As for weights above 1, which estimates may reach; not for those at 2, which were clamped.
  for (const float most : {1.5f, 2.0f}) {
    w = worldWithLamps();
    for (auto& level : w.strips)
      for (Strip& strip : level)
        for (LampLight& lamp : strip.lamps) lamp.weight.x *= 2 * most;
    write(w);
    EXPECT_EQ(inspect("verify " + world()).code, 0) << inspect("verify " + world()).text;
    w.strips[1][0].lamps[17].weight.x *= 1.001f;
    write(w);
    EXPECT_EQ(inspect("verify " + world()).code, most < 2 ? 4 : 0) << most;
  }
  w = worldWithLamps();
  w.strips[0][1].lamps.erase(w.strips[0][1].lamps.begin() + 3);  // a patch that none of it reaches
  write(w);
  run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4);
  EXPECT_NE(run.text.find("node 129: light of lamp group 0"), std::string::npos) << run.text;
  w = worldWithLamps();
  w.strips[0][1].nodes[3].lamp_group = kNoLampGroup;
  write(w);
  run = inspect("verify " + world());
  EXPECT_EQ(run.code, 4);
  EXPECT_NE(run.text.find("node 129: is of another lamp group than its child -2,0,2 1 3"), std::string::npos) << run.text;
  w = worldWithLamps();
  w.strips[0][1].lamps[3].group = 1;
  write(w);
  run = inspect("verify " + world());
  EXPECT_EQ(run.code, 3);
  EXPECT_NE(run.text.find("names lamp group 1, the manifest lists 1"), std::string::npos) << run.text;
}

TEST_F(Inspect, ShowsLampGroupsAndWhatANodeGetsOfThem) {
  write(worldWithLamps());
  EXPECT_NE(inspect("info " + world()).text.find("lamp group   0 \"candle\": 1 0 0 W/m2"), std::string::npos);
  const auto groups = nlohmann::json::parse(inspect("info --json " + world()).text)["lamp_groups"];
  ASSERT_EQ(groups.size(), 1u);
  EXPECT_EQ(groups[0]["name"], "candle");
  EXPECT_NE(inspect("row " + world() + " 0 -2,0,2 0 7").text.find("0 \"candle\": 0.25 0 0 of its emission arrives"), std::string::npos);
  const auto row = nlohmann::json::parse(inspect("row --json " + world() + " 1 -1,0,1 0 3").text);
  ASSERT_EQ(row["lamps"].size(), 1u);
  EXPECT_EQ(row["lamps"][0]["name"], "candle");
  EXPECT_EQ(row["lamps"][0]["weight"][0], 0.375);
  EXPECT_EQ(row["lamp_group"], 0);
  EXPECT_EQ(nlohmann::json::parse(inspect("tile --json " + world() + " 0 -2,0,2 1").text)["nodes"][1]["lamps"].size(), 1u);
}

TEST_F(Inspect, ListsTheLightsOfTheFile) {
  RandomWorld w = makeFurnaceWorld(300);
  w.info.lights = {{"bulb", Light::kPoint, {10, 0, 0.5f}, {1, 2, 3}, {}, 4, 0, 0}};
  write(w);
  EXPECT_NE(inspect("info " + world()).text.find("\"bulb\": point, 10 0 0.5 W/sr, at 1 2 3, within 4 m"), std::string::npos);
  const auto lights = nlohmann::json::parse(inspect("info --json " + world()).text)["lights"];
  ASSERT_EQ(lights.size(), 1u);
  EXPECT_EQ(lights[0]["name"], "bulb");
  EXPECT_EQ(lights[0]["kind"], "point");
  EXPECT_EQ(lights[0]["range_m"], 4);
}

TEST_F(Inspect, PrintsJsonThatParses) {
  for (const char* command : {"info %", "stats %", "verify %", "row % 0 -2,0,2 1 43", "row % 1 -1,0,1 0 3", "tile % 0 -2,0,2 1", "pair % 1 -1,0,1 0 3 -1,0,1 0 3",
                              "locate % 1 2 3", "locate % -5 2 3"}) {
    std::string arguments = command;
    arguments.replace(arguments.find('%'), 1, world());
    const Outcome run = inspect(arguments + " --json");
    EXPECT_EQ(run.code, 0) << command << run.text;
    EXPECT_TRUE(nlohmann::json::accept(run.text)) << command << run.text;
    EXPECT_EQ(inspect(arguments).code, 0) << command;
  }
  const auto row = nlohmann::json::parse(inspect("row --json " + world() + " 0 -2,0,2 1 43").text);
  EXPECT_EQ(row["entries"].size(), 299u);
  EXPECT_EQ(row["entries"][0]["column"], (nlohmann::json{{"level", 0}, {"chunk", {-2, 0, 2}}, {"tile", 0}, {"index", 0}}));
  EXPECT_EQ(row["parent"], (nlohmann::json{{"level", 1}, {"chunk", {-1, 0, 1}}, {"tile", 0}, {"index", 149}}));
  const auto above = nlohmann::json::parse(inspect("row --json " + world() + " 1 -1,0,1 0 149").text);
  ASSERT_EQ(above["children"].size(), 2u);
  for (int k = 0; k < 2; ++k) EXPECT_EQ(above["children"][k], (nlohmann::json{{"level", 0}, {"chunk", {-2, 0, 2}}, {"tile", 1}, {"index", 42 + k}}));
  EXPECT_EQ(nlohmann::json::parse(inspect("locate --json " + world() + " 3 0 0").text)["name"]["index"], 3);
}

TEST_F(Inspect, ExportsRowsAndPatches) {
  const std::string to = folder_.file("out");
  ASSERT_EQ(inspect("export " + world() + " --what rows --level 1 --format mtx -o " + to).code, 0);
  const std::vector<std::byte> mtx = readFile(to);
  std::istringstream in(std::string(reinterpret_cast<const char*>(mtx.data()), mtx.size()));
  std::string line;
  std::getline(in, line);
  EXPECT_EQ(line, "%%MatrixMarket matrix coordinate real general");
  std::getline(in, line);
  uint32_t rows = 0, columns = 0, entries = 0, read = 0;
  in >> rows >> columns >> entries;
  EXPECT_EQ(rows, 150u);
  EXPECT_EQ(columns, 150u);
  EXPECT_EQ(entries, 150u * 150);
  std::vector<double> sums(rows + 1);
  double f = 0;
  for (uint32_t i = 0, j = 0; in >> i >> j >> f; ++read) sums.at(i) += f;
  EXPECT_EQ(read, entries);
  for (uint32_t i = 1; i <= rows; ++i) EXPECT_NEAR(sums[i], 1, 150 * 1e-9);  // nine digits are printed

  ASSERT_EQ(inspect("export " + world() + " --what patches --format npy -o " + to).code, 0);
  const std::vector<std::byte> npy = readFile(to);
  const size_t header = 10 + std::to_integer<size_t>(npy[8]) + 256 * std::to_integer<size_t>(npy[9]);
  EXPECT_EQ(header % 64, 0u);
  EXPECT_EQ(npy.size() - header, 300u * 112);
  ASSERT_EQ(inspect("export " + world() + " --what rows --format npy -o " + to).code, 0);
  write(worldWithLamps());
  ASSERT_EQ(inspect("export " + world() + " --what lamps --format npy -o " + to).code, 0);
  const std::vector<std::byte> lamps = readFile(to);
  const size_t lamps_header = 10 + std::to_integer<size_t>(lamps[8]) + 256 * std::to_integer<size_t>(lamps[9]);
  EXPECT_EQ(lamps.size() - lamps_header, 300u * 20);
  ASSERT_EQ(inspect("export " + world() + " --what patches --format ply -o " + to).code, 0);
  EXPECT_EQ(inspect("export " + world() + " --what rows --format ply -o " + to).code, 1);
  EXPECT_EQ(inspect("export " + world() + " --what rows --format mtx -o " + folder_.file("absent/x")).code, 2);
}

TEST_F(Inspect, UsesTheExitCodesOfAllTools) {
  EXPECT_EQ(inspect("--help").code, 0);
  EXPECT_EQ(inspect("--version").code, 0);
  EXPECT_EQ(inspect("").code, 1);
  EXPECT_EQ(inspect("verify").code, 1);
  EXPECT_EQ(inspect("frobnicate " + world()).code, 1);
  EXPECT_EQ(inspect("row " + world() + " 0 -2,0,2 1 44").code, 1);
  EXPECT_EQ(inspect("row " + world() + " 2 -2,0,2 0 0").code, 1);
  EXPECT_EQ(inspect("tile " + world() + " 0 -2,0,2 2").code, 1);
  EXPECT_EQ(inspect("tile " + world() + " 0 5,0,2 0").code, 1);
  EXPECT_EQ(inspect("tile " + world() + " 0 5,0 0").code, 1);
  EXPECT_EQ(inspect("info " + folder_.file("absent.ffm")).code, 2);
  writeFile(folder_.file("bad.ffm"), std::vector<std::byte>(200));
  EXPECT_EQ(inspect("info " + folder_.file("bad.ffm")).code, 3);
}

}  // namespace
}  // namespace ff::tools
