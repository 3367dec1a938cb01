// Whole bakes of small scenes, read back through formats/read/reader.h.
#include "bake/bake.h"
#include "bake/estimate.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <new>
#include <stdexcept>
#include <system_error>

#include "formats/read/whole_world.h"
#include "tests/bake/variants.h"
#include "tools/inspect/world_check.h"

namespace ff::bake::test {
namespace {

class Bake : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() /
              ("ff_bake_test_" + std::to_string(getpid()) + testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  std::map<std::string, std::string> files(const std::string& folder) const {
    std::map<std::string, std::string> files;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / folder)) {
      std::ifstream in(entry.path(), std::ios::binary);
      files[entry.path().filename().string()] = std::string(std::istreambuf_iterator<char>(in), {});
    }
    return files;
  }

  std::filesystem::path folder_;
};

TEST_F(Bake, GivesTheSameBytesForAnyNumberOfThreads) {
  const Scene scene = sphericalCap(1.2, 12, 24);
  for (int threads : {1, 2, 3}) {
    std::filesystem::create_directories(folder_ / std::to_string(threads));
    ASSERT_TRUE(bakeWorld(scene, {.cell_m = 0.05f, .rays = 64, .quanta = 64, .threads = threads},
                          path(std::to_string(threads) + "/w.ffm")));
  }
  const auto one = files("1");
  EXPECT_GE(one.size(), 3u);  // manifest, strips, geometry
  EXPECT_TRUE(one == files("2"));
  EXPECT_TRUE(one == files("3"));
}

// With as little as the estimate asks for, of which this process holds more than all already, hits go through files, bucket by bucket.
TEST_F(Bake, GivesTheSameBytesInAnyMemory) {
  Scene scene = closedBox({.5f, .5f, .5f}, {});
  scene.materials[scene.triangles[0].material].emission = {1, 1, 1};
  BakeSettings settings{.cell_m = 0.05f, .rays = 1024, .quanta = 64};
  const auto baked = [&](const std::string& folder) {
    std::filesystem::create_directories(folder_ / folder);
    const auto stats = bakeWorld(scene, settings, path(folder + "/w.ffm"));
    EXPECT_TRUE(stats) << stats.error().line();
    return stats ? stats->spilled_bytes : 0;
  };
  EXPECT_EQ(baked("much"), 0u);
  settings.memory_bytes = static_cast<uint64_t>(estimateBake(scene, settings).least_memory_bytes * 1.01);
  const std::vector<char> taken(settings.memory_bytes, 1);
  EXPECT_GT(baked("little"), 100000u);
  EXPECT_TRUE(files("much") == files("little"));
  for (const auto& [name, content] : files("little")) EXPECT_EQ(name.find("spill"), std::string::npos) << name;
}

TEST_F(Bake, SaysNoToADiskThatIsTooSmallBeforeTheFirstRay) {
  EXPECT_TRUE(checkSpace(path("w.ffm"), {}, {.disk_bytes = 1}));
  const auto full = checkSpace(path("w.ffm"), {}, {.disk_bytes = 1e18});
  ASSERT_FALSE(full);
  EXPECT_EQ(full.error().code, ErrorCode::kIo);
  EXPECT_NE(full.error().line().find("1000 PB of world do not fit"), std::string::npos) << full.error().line();
  const auto aside = checkSpace(path("w.ffm"), {.memory_bytes = 1 << 30}, {.memory_bytes = 1e18, .disk_bytes = 1});
  ASSERT_FALSE(aside);
  EXPECT_NE(aside.error().line().find("1 B of world and 1000 PB that memory has no room for do not fit"), std::string::npos) << aside.error().line();
  EXPECT_TRUE(checkSpace("/nowhere/at/all/w.ffm", {}, {.disk_bytes = 1e18}));  // others say what is wrong with it
}

// Worlds are taken for the same where their keys are (ffchart keeps bakes by them). Two materials that differ in name alone, and a pattern that
// finds one of them: the content hash of the file's scene does not cover such names, that of what is baked covers what they chose.
TEST_F(Bake, HasAKeyOfItsOwnForWhateverChangesItsBytes) {
  const Scene scene = parallelSquares();
  ASSERT_EQ(scene.materials.size(), 2u);
  const auto keyOf = [&](const BakeSettings& settings, std::array<const char*, 2> names = {"a", "b"}, const char* file = "scene") {
    Scene named = scene;
    named.name = file;
    for (size_t m = 0; m < 2; ++m) named.materials[m].name = names[m];
    const auto clean = cleanUp(named, settings.cleanup);
    EXPECT_TRUE(clean) << clean.error().line();
    return bakeKey(clean->scene ? *clean->scene : named, settings, 0.25f);
  };
  const CleanupSettings out{.exclude = {"a"}}, blocks{.occlude_only = {"a"}}, finer{.density = {{"a", 2.0f}}};
  const std::vector<std::array<uint8_t, 16>> keys{
      keyOf({}), keyOf({}, {"a", "b"}, "other"), keyOf({.geometry = false}), keyOf({.seed = 2}), keyOf({.metals = 0.5f}),
      keyOf({.cleanup = out}), keyOf({.cleanup = out}, {"b", "a"}), keyOf({.cleanup = blocks}), keyOf({.cleanup = blocks}, {"b", "a"}),
      keyOf({.cleanup = finer}), keyOf({.cleanup = finer}, {"b", "a"}), keyOf({.cleanup = {.backs = Backs::kPass}})};
  for (size_t i = 0; i < keys.size(); ++i)
    for (size_t j = 0; j < i; ++j) EXPECT_NE(keys[i], keys[j]) << i << " " << j;
  EXPECT_EQ(keys[0], keyOf({.threads = 3, .memory_bytes = 1 << 30}));
}

TEST_F(Bake, WhateverRunsOutIsAnErrorWithARemedy) {
  const auto refusal = [&](auto thrown) {
    BakeSettings settings{.cell_m = 0.5f, .rays = 16, .quanta = 16};
    settings.announce = [thrown](const BakeEstimate&) { throw thrown; };
    const auto stats = bakeWorld(parallelSquares(), settings, path("w.ffm"));
    EXPECT_FALSE(stats);
    if (stats) return std::string();
    EXPECT_EQ(stats.error().code, ErrorCode::kIo);
    EXPECT_FALSE(stats.error().remedy.empty());
    return stats.error().message;
  };
  EXPECT_EQ(refusal(std::bad_alloc()), "the bake ran out of memory");
  EXPECT_NE(refusal(std::system_error(std::make_error_code(std::errc::resource_unavailable_try_again))).find("out of threads"), std::string::npos);
  EXPECT_EQ(refusal(std::runtime_error("OpenVDB says no")), "the bake cannot go on: OpenVDB says no");
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
}

TEST_F(Bake, GoesOnWhereItsProgressCannotBeShown) {
  const auto closed = [](const char*, uint64_t, uint64_t) { throw std::runtime_error("the terminal is gone"); };
  EXPECT_TRUE(bakeWorld(parallelSquares(), {.cell_m = 0.5f, .rays = 16, .quanta = 16}, path("w.ffm"), closed));
}

TEST_F(Bake, AClosedBoxKeepsAllEnergyAtEveryLevel) {
  ASSERT_TRUE(bakeWorld(closedBox({.5f, .5f, .5f}, {1, 1, 1}), {.cell_m = 0.03125f, .rays = 256, .quanta = 128}, path("box.ffm")));
  auto world = formats::WholeWorld::open(path("box.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  ASSERT_GE(world->levels().size(), 2u);
  for (uint32_t l = 0; l < world->levels().size(); ++l) {
    double area = 0;
    for (const auto& tile : world->tiles(l)) {
      auto strip = world->strip(tile.id);
      ASSERT_TRUE(strip) << strip.error().line();
      std::vector<uint64_t> sum(strip->nodes.size());
      for (size_t e = 0; e < strip->rows.size(); ++e) sum[strip->rows[e]] += strip->counts[e];
      for (size_t i = 0; i < strip->nodes.size(); ++i) {
        EXPECT_EQ(sum[i], strip->nodes[i].quanta);  // nothing reaches a sky, nothing is lost
        EXPECT_EQ(strip->nodes[i].sky + strip->nodes[i].absorbed, 0u);
        EXPECT_NEAR(strip->nodes[i].emission.x, std::numbers::pi, 1e-3);
        area += static_cast<double>(strip->nodes[i].area_m2);
      }
    }
    EXPECT_NEAR(area, 6.0, 1e-4) << "level " << l;
  }
}

TEST_F(Bake, AFurnaceOfAnyAlbedoReachesItsClosedForm) {
  // B = M / (1 - rho): row sums are exactly one, so every Jacobi iterate is uniform and the limit has no sampling error.
  for (float rho : {0.5f, 0.9f}) {
    ASSERT_TRUE(bakeWorld(closedBox({rho, rho, rho}, {1, 1, 1}), {.cell_m = 0.125f, .rays = 128, .quanta = 64}, path("box.ffm")));
    auto world = formats::WholeWorld::open(path("box.ffm"));
    ASSERT_TRUE(world) << world.error().line();
    const uint32_t n = formats::wholeNumber(world->levels()[0].nodes);
    std::vector<double> b(n, 0), next(n);
    for (int k = 0; k < 400; ++k) {
      for (const auto& tile : world->tiles(0)) {
        auto strip = world->strip(tile.id);
        ASSERT_TRUE(strip);
        std::vector<double> e(strip->nodes.size());
        size_t at = 0;
        for (const auto& block : strip->blocks)
          for (uint32_t q = 0; q < block.entries; ++q, ++at)
            e[strip->rows[at]] += b[world->tiles(0)[block.partner_tile].first_node + strip->columns[at]] * strip->counts[at] /
                                  strip->nodes[strip->rows[at]].quanta;
        for (size_t i = 0; i < e.size(); ++i)
          next[strip->first_node + i] = static_cast<double>(strip->nodes[i].emission.x) + static_cast<double>(strip->nodes[i].albedo.x) * e[i];
      }
      std::swap(b, next);
    }
    // Stored albedo is a 16-bit fraction and emission a float: 1e-5 of 1/(1-rho)^2 covers both.
    const double expected = std::numbers::pi / (1 - static_cast<double>(rho));
    for (double v : b) EXPECT_NEAR(v, expected, 1e-3 * expected);
  }
}

TEST_F(Bake, OfASurfaceHalfInsideASolidTheOtherHalfTakesPart) {
  // A floor in the open, half of it in a closed block that stands in it: that half is sealed.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0.5f, 0}, {0, 0.5f, 1}, {1, 0.5f, 1}, {1, 0.5f, 0}, m);
  addBlock(s, {0.5f, 0.2f, -1}, {3.5f, 0.9f, 2}, m);
  const auto stats = bakeWorld(s, {.cell_m = 1, .rays = 4096, .quanta = 4096}, path("buried.ffm"));
  ASSERT_TRUE(stats);
  EXPECT_LT(stats->absorbed_fraction, 0.01);  // the block's foot sees the floor's back
  auto world = formats::WholeWorld::open(path("buried.ffm"));
  ASSERT_TRUE(world);
  double exposed = -1, sky = -1;
  for (const auto& tile : world->tiles(0)) {
    auto strip = world->strip(tile.id);
    ASSERT_TRUE(strip);
    for (const auto& node : strip->nodes)
      if (std::abs(node.centroid.y - 0.5f) < 1e-3f && node.normal.y > 0.9f && std::abs(node.centroid.x - 0.25f) < 1e-5f) {
        exposed = static_cast<double>(node.area_m2);
        sky = static_cast<double>(node.sky) / node.quanta;
      }
  }
  EXPECT_NEAR(exposed, 0.5, 1e-5);
  double drawn = 0, sealed = 0;  // of the floor
  for (uint32_t t = 0; t < world->levels()[0].tiles; ++t) {
    const auto geometry = world->geometry(t);
    ASSERT_TRUE(geometry) << geometry.error().line();
    for (size_t k = 0; k < geometry->patch.size(); ++k) {
      const Vec3* p = &geometry->positions[3 * k];
      const Vec3 doubled = cross(p[1] - p[0], p[2] - p[0]);
      if (doubled.y > 0 && std::abs(p[0].y - 0.5f) < 1e-3f && std::abs(p[1].y - 0.5f) < 1e-3f)
        (k < geometry->exposed() ? drawn : sealed) += static_cast<double>(length(doubled)) / 2;
    }
  }
  EXPECT_NEAR(drawn, 0.5, 1e-3);
  EXPECT_NEAR(sealed, 0.5, 1e-3);
  // Sky seen from the exposed half: all but the block's face, a wall 0.4 high and long beside it: between 0.5 and 1.
  EXPECT_GT(sky, 0.7);
  EXPECT_LT(sky, 0.95);
}

TEST_F(Bake, LeavesOutTheMaterialsItIsToldToAndRefusesAnUnknownOne) {
  Scene s = parallelSquares();
  s.materials[0].name = "floor";
  s.materials[1].name = "outline";
  const auto all = bakeWorld(s, {.cell_m = 1, .rays = 16, .quanta = 16}, path("all.ffm"));
  const auto rest = bakeWorld(s, {.cell_m = 1, .rays = 16, .quanta = 16, .cleanup = {.exclude = {"outline"}}}, path("rest.ffm"));
  ASSERT_TRUE(all && rest);
  EXPECT_EQ(all->levels[0].nodes, 2u);
  EXPECT_EQ(rest->levels[0].nodes, 1u);
  EXPECT_EQ(rest->sky_fraction, 1);
  auto a = formats::WholeWorld::open(path("all.ffm")), b = formats::WholeWorld::open(path("rest.ffm"));
  ASSERT_TRUE(a && b);
  EXPECT_NE(a->info().bake_key, b->info().bake_key);
  const auto unknown = bakeWorld(s, {.cell_m = 1, .cleanup = {.exclude = {"Outline"}}}, path("unknown.ffm"));
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().code, ErrorCode::kUsage);
}

// Lamps of one group, each three times as bright as the one before, in a row that clusters take together.
TEST_F(Bake, AGroupOfLampsThatDifferInBrightnessAddsUpAtEveryLevel) {
  Scene s;
  addQuad(s, {0, 0, 0}, {0, 0, 16}, {16, 0, 16}, {16, 0, 0}, addMaterial(s, {.5f, .5f, .5f}));
  double power = 0;
  for (int i = 0; i < 8; ++i) {
    const float x = 1 + 0.25f * static_cast<float>(i), radiance = std::pow(3.0f, static_cast<float>(i));
    const uint32_t lamp = addMaterial(s, {}, {radiance, 1, 0});
    s.materials[lamp].lamp_group = "row";
    addQuad(s, {x, 1, 1}, {x + 0.25f, 1, 1}, {x + 0.25f, 1, 1.25f}, {x, 1, 1.25f}, lamp);
    power += 0.0625 * std::numbers::pi * static_cast<double>(radiance);
  }
  ASSERT_TRUE(bakeWorld(s, {.cell_m = 0.25f, .rays = 128, .quanta = 128}, path("row.ffm")));
  auto world = formats::WholeWorld::open(path("row.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  const auto check = tools::checkWorld(*world, 1, nullptr);
  EXPECT_TRUE(check.corrupt.empty());
  EXPECT_TRUE(check.unphysical.empty()) << check.unphysical[0].line();
  ASSERT_EQ(world->info().lamp_groups.size(), 1u);
  EXPECT_NEAR(world->info().lamp_groups[0].emission.x, 2187 * std::numbers::pi, 0.01);
  uint32_t fewest = 8;
  double floor = 0, floor_0 = 0;  // what floors get at a level, W
  for (uint32_t l = 0; l < world->levels().size(); ++l) {
    uint32_t lamps = 0;
    double sum = 0;
    floor = 0;
    for (const auto& tile : world->tiles(l)) {
      auto strip = world->strip(tile.id);
      ASSERT_TRUE(strip);
      for (const auto& node : strip->nodes) {
        lamps += node.lamp_group == 0;
        sum += static_cast<double>(node.area_m2 * node.emission.x);
      }
      for (const auto& lamp : strip->lamps) floor += static_cast<double>(strip->nodes[lamp.row].area_m2 * lamp.weight.x);
    }
    EXPECT_NEAR(sum / power, 1, 1e-5) << "level " << l;
    if (l == 0) floor_0 = floor;
    EXPECT_NEAR(floor / floor_0, 1, 1e-3) << "level " << l;  // weights have 12 bits
    fewest = std::min(fewest, lamps);
  }
  EXPECT_EQ(fewest, 4u) << "clusters hold two each";
}

// A sheet pasted on a larger wall is no duplicate, but its rows tell: of two patches at one place each casts all its rays, and both
// together are met by what others cast there, so that the mean of both ends is 3/4 of a row, in the mean of the two.
TEST_F(Bake, RowsThatDoNotAddUpAreSaidWithTheirPlaceAndThoseOfACleanSceneAreNot) {
  for (const bool pasted : {true, false})
    for (const Variant& v : kVariants) {
      Scene s;
      const uint32_t room = addMaterial(s, {.5f, .5f, .5f}), wall = addMaterial(s, {.5f, .5f, .5f}), sheet = addMaterial(s, {.5f, .5f, .5f});
      s.materials[wall].name = "wall";
      s.materials[sheet].name = "sheet";
      s.materials[wall].cutout = s.materials[sheet].cutout = true;  // without holes the one would stand for the other
      addRoom(s, {0, 0, 0}, {4, 3, 4}, room, room);
      s.triangles[2].material = s.triangles[3].material = wall;  // at x = 0
      if (pasted) addQuad(s, {0, 0.4f, 0.4f}, {0, 2.6f, 0.4f}, {0, 2.6f, 3.6f}, {0, 0.4f, 3.6f}, sheet);
      const auto stats = bakeWorld(varied(s, v), {.cell_m = v.scale, .rays = 512, .quanta = 128, .geometry = false}, path("w.ffm"));
      ASSERT_TRUE(stats) << stats.error().line();
      if (!pasted) {
        EXPECT_TRUE(stats->findings.empty()) << v.name << ": " << lineOf(stats->findings[0]);
        continue;
      }
      ASSERT_EQ(stats->findings.size(), 1u) << v.name;
      EXPECT_EQ(stats->findings[0].kind, "overlaps");
      const std::string line = lineOf(stats->findings[0]);
      const auto names = [&](const char* it) { return line.find(it) != std::string::npos; };
      EXPECT_TRUE(names("wall") || names("sheet")) << line;
    }
}

TEST_F(Bake, CarriesTheAskedShareOfAMetalsReflectionAsDiffuse) {
  Scene s = parallelSquares();
  for (Material& m : s.materials) m.metallic = 0.8f;  // base colour 0.5
  for (const float metals : {0.0f, 0.25f, 1.0f}) {
    ASSERT_TRUE(bakeWorld(s, {.cell_m = 1, .rays = 16, .quanta = 16, .metals = metals}, path("metal.ffm")));
    auto world = formats::WholeWorld::open(path("metal.ffm"));
    ASSERT_TRUE(world);
    auto strip = world->strip(formats::TileId{0, 0});
    ASSERT_TRUE(strip);
    EXPECT_NEAR(strip->nodes[0].albedo.x, 0.5f * (1 - 0.8f * (1 - metals)), 2e-5f);
  }
}

TEST_F(Bake, LowersAnAlbedoOfOneInAClosedRoomAndSaysSo) {
  const auto stats = bakeWorld(closedBox({1, 0.5f, 1}, {}), {.cell_m = 0.25f, .rays = 64, .quanta = 64}, path("white.ffm"));
  ASSERT_TRUE(stats);
  EXPECT_EQ(stats->clamped_nodes, 96u);
  auto world = formats::WholeWorld::open(path("white.ffm"));
  ASSERT_TRUE(world);
  auto strip = world->strip(formats::TileId{0, 0});
  ASSERT_TRUE(strip);
  for (const auto& node : strip->nodes) {
    EXPECT_NEAR(node.albedo.x, 0.999f, 2e-5f);  // stored in 16 bits
    EXPECT_NEAR(node.albedo.y, 0.5f, 2e-5f);
  }
  // An open scene keeps its white.
  const auto open = bakeWorld(parallelSquares(), {.cell_m = 0.25f, .rays = 64, .quanta = 64}, path("open.ffm"));
  ASSERT_TRUE(open);
  EXPECT_EQ(open->clamped_nodes, 0u);
}

TEST_F(Bake, ASceneWithoutSurfaceOrABadSettingLeavesNothingBehind) {
  Scene empty;
  empty.name = "empty.glb";
  EXPECT_FALSE(bakeWorld(empty, {.cell_m = 1}, path("empty.ffm")));
  EXPECT_FALSE(bakeWorld(parallelSquares(), {.cell_m = 1, .rays = 0}, path("bad.ffm")));
  EXPECT_FALSE(bakeWorld(parallelSquares(), {.cell_m = 1, .quanta = 70000}, path("bad.ffm")));
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
}

TEST_F(Bake, APatchBudgetIsMetWithinATenth) {
  const auto stats = bakeWorld(sphericalCap(2.0, 32, 64), {.patch_budget = 3000, .rays = 16, .quanta = 16}, path("cap.ffm"));
  ASSERT_TRUE(stats) << stats.error().line();
  EXPECT_NEAR(static_cast<double>(stats->levels[0].nodes), 3000, 450);
}

TEST_F(Bake, DrawingGeometryCoversThePatches) {
  const auto stats = bakeWorld(sphericalCap(1.5, 16, 32), {.cell_m = 0.1f, .rays = 16, .quanta = 16}, path("cap.ffm"));
  ASSERT_TRUE(stats);
  auto world = formats::WholeWorld::open(path("cap.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  ASSERT_TRUE(world->hasGeometry());
  double area = 0;
  for (uint32_t t = 0; t < world->levels()[0].tiles; ++t) {
    const auto geometry = world->geometry(t);
    ASSERT_TRUE(geometry) << geometry.error().line();
    for (size_t k = 0; k < geometry->patch.size(); ++k) {
      const Vec3 a = geometry->positions[3 * k];
      area += 0.5 * static_cast<double>(length(cross(geometry->positions[3 * k + 1] - a, geometry->positions[3 * k + 2] - a)));
    }
  }
  EXPECT_NEAR(area / stats->area_m2, 1, 1e-3);
}

}  // namespace
}  // namespace ff::bake::test
