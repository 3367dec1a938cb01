// Patches that become one where light is smooth and materials agree, and those that do not.
#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/plan/cache.h"
#include "bake/surface/fineness.h"
#include "formats/read/whole_world.h"
#include "tests/bake/variants.h"
#include "tools/inspect/world_check.h"

namespace ff::bake::test {
namespace {

constexpr float kError = 0.05f;

void addGround(Scene& s, Vec3 lo, Vec3 hi, uint32_t material) { addQuad(s, {lo.x, lo.y, lo.z}, {lo.x, lo.y, hi.z}, {hi.x, lo.y, hi.z}, {hi.x, lo.y, lo.z}, material); }

// 64 m of ground, and what stands on it.
Scene openGround(float edge = 64) {
  Scene s;
  addGround(s, {0, 0, 0}, {edge, 0, edge}, addMaterial(s, {.5f, .5f, .5f}));
  return s;
}

// A block of 4 by 4 by 6 m in the middle.
Scene groundWithABlock() {
  Scene s = openGround();
  addBlock(s, {30, 0, 30}, {34, 6, 34}, 0, false);
  return s;
}

PatchSet merged(const Scene& scene, float error = kError, float cell_m = 1) {
  const auto caster = RayCaster::create(scene);
  return *makePatches(scene, {.cell_m = cell_m, .merge_error = error}, &*caster);
}

bool isGround(const Patch& p) { return p.normal.y > 0.99f && p.centroid.y < 0.5f; }

TEST(Merging, FlatGroundIsOfPatchesEightCellsWideInAnyPlace) {
  for (const Variant& v : kVariants) {
    const Scene scene = varied(openGround(32), v);
    const PatchSet set = merged(scene, kError, v.scale), plain = merged(scene, 0, v.scale);
    EXPECT_EQ(plain.unmerged, 0u);
    EXPECT_EQ(set.unmerged, plain.patches.size()) << v.name;
    EXPECT_NEAR(set.area_m2 / plain.area_m2, 1, 1e-6) << v.name;
    if (v.turned()) {
      EXPECT_LT(set.patches.size(), plain.patches.size() / 15) << v.name;
    } else {
      ASSERT_EQ(set.patches.size(), 16u) << v.name;
      EXPECT_EQ(set.merged[kMaxMergedLog - 1], 16u);
      for (const Patch& p : set.patches) {
        EXPECT_NEAR(p.area_m2, 64 * v.scale * v.scale, 1e-3f * v.scale * v.scale) << v.name;
        EXPECT_EQ(p.fineness, -3);
      }
    }
    EXPECT_TRUE(std::ranges::is_sorted(set.patches, {}, &Patch::key)) << v.name;
    for (uint32_t p = 0; p < set.patches.size(); ++p)  // all of a patch is found again
      for (const PatchTriangle& t : std::span(set.triangles).subspan(set.patches[p].first_triangle, set.patches[p].triangles))
        ASSERT_EQ(set.patchAt(t.source, true, (t.a + t.b + t.c) / 3.0f), p) << v.name;
  }
}

TEST(Merging, AStepPartsAndBothLevelsAreMergedApart) {
  Scene s;
  addMaterial(s, {.5f, .5f, .5f});
  addGround(s, {0, 0, 0}, {19, 0, 64}, 0);
  addGround(s, {19, 1, 0}, {64, 1, 64}, 0);
  addQuad(s, {19, 0, 0}, {19, 0, 64}, {19, 1, 64}, {19, 1, 0}, 0);
  const PatchSet set = merged(s);
  EXPECT_LT(set.patches.size(), set.unmerged / 4);
  float widest_low = 0, widest_high = 0;
  for (const Patch& p : set.patches) {
    if (p.normal.y < 0.99f) continue;
    const Vec3 size = p.bounds.hi - p.bounds.lo;
    const bool low = p.centroid.y < 0.5f;
    EXPECT_LT(size.y, 1e-4f);
    EXPECT_LE(size.x, low && p.bounds.hi.x > 18.5f ? 1.001f : 8.001f);  // at the foot; anywhere
    float& widest = low ? widest_low : widest_high;
    widest = std::max(widest, size.x);
  }
  EXPECT_GT(widest_low, 3.9f);
  EXPECT_GT(widest_high, 7.9f);
}

TEST(Merging, TwoMaterialsStayApart) {
  for (const float albedo : {0.45f, 0.5f}) {  // 5 % from their middle; no difference
    Scene s;
    addMaterial(s, {.5f, .5f, .5f});
    addMaterial(s, {albedo, .5f, .5f});
    addGround(s, {0, 0, 0}, {13, 0, 64}, 0);
    addGround(s, {13, 0, 0}, {64, 0, 64}, 1);
    const PatchSet set = merged(s, 0.04f);
    size_t both = 0;
    for (const Patch& p : set.patches) both += p.bounds.lo.x < 12.5f && p.bounds.hi.x > 13.5f;
    EXPECT_EQ(both, albedo < 0.5f ? 0u : 8u);
    EXPECT_LT(set.patches.size(), set.unmerged / 8);
  }
}

TEST(Merging, AWallsFootStaysAsItIsCutAndWhatLiesFarOffDoesNot) {
  const PatchSet set = merged(groundWithABlock());
  size_t near = 0, far = 0;
  for (const Patch& p : set.patches) {
    if (!isGround(p)) continue;
    const Box block{{30, 0, 30}, {34, 6, 34}};
    const float away = block.distance(p.centroid);
    if (away < 1) {
      EXPECT_LE(p.area_m2, 1.001f);
      ++near;
    }
    far += p.area_m2 > 63;
  }
  EXPECT_EQ(near, 4 * 4u + 4);  // the cells along its foot and at its corners
  EXPECT_GT(far, 20u);      // of the 64 cubes
}

TEST(Merging, ALampAndWhatItShinesOnNearbyStayAsTheyAreCut) {
  Scene s = openGround();
  addMaterial(s, {.5f, .5f, .5f}, {5, 5, 5});
  addQuad(s, {10, 4, 10}, {14, 4, 10}, {14, 4, 14}, {10, 4, 14}, 1);  // faces down
  const PatchSet set = merged(s);
  bool lamp = false;
  for (const Patch& p : set.patches) {
    const Vec3 way = p.centroid - Vec3{12, 4, 12};
    if (p.emits()) {
      lamp = true;
      EXPECT_LE(p.area_m2, 1.001f);
    } else if (const float away = length(way); away < kLampEdges * 2) {
      EXPECT_LE(p.area_m2, 1.001f) << away;
    } else if (away < kLampEdges * 8 - 6) {  // less half a patch's diagonal
      EXPECT_LE(p.area_m2, 16.001f) << away;
    }
  }
  EXPECT_TRUE(lamp);
  EXPECT_GT(set.merged[kMaxMergedLog - 1], 0u);
}

TEST(Merging, WhatHasHolesStaysAsItIsCutAndAPaneIsMerged) {
  for (const bool picture : {false, true}) {
    Scene s = openGround(16);
    s.materials[0].cutout = s.materials[0].blend = true;
    s.materials[0].alpha = 0.5f;
    addGround(s, {0, -3, 0}, {16, -3, 16}, addMaterial(s, {.5f, .5f, .5f}));  // beneath the pane, seen by chance
    if (picture) {
      s.images.push_back({.width = 1, .height = 1, .rgba = {255, 255, 255, 128}});
      s.materials[0].base_image = 0;
      s.uv0.resize(s.positions.size());
    }
    const PatchSet set = merged(s, 0.2f);
    std::map<uint32_t, size_t> of_material;
    for (const Patch& p : set.patches) ++of_material[s.triangles[set.triangles[p.first_triangle].source].material];
    EXPECT_EQ(of_material[0], picture ? 256u : 4u);
    EXPECT_LT(of_material[1], 256u);
  }
}

TEST(Merging, TheLightAtAPointIsThatOfTheUnmergedPatchWithinTheError) {
  const auto lightOf = [](float error) {
    CastScene c{groundWithABlock(), {}, {}};
    const auto caster = RayCaster::create(c.scene);
    c.set = *makePatches(c.scene, {.cell_m = 1, .merge_error = error}, &*caster);
    WorkCount done;
    c.rows = castRows(c.scene, c.set, *caster, 1024, 1, done);
    return c;
  };
  const CastScene plain = lightOf(0), coarse = lightOf(kError);
  ASSERT_LT(coarse.set.patches.size(), plain.set.patches.size() / 4);
  // Patches differ from the middle of the least and the most by kError, so from their mean by twice that; the looks that tell err by about one of 128, rows of
  // 1024 rays by less than 1/32 each, five times the deviation of plain random ones.
  double square = 0;
  for (uint32_t p = 0; p < plain.set.patches.size(); ++p) {
    const Patch& patch = plain.set.patches[p];
    const uint32_t q = coarse.set.patchAt(plain.set.triangles[patch.first_triangle].source, true, patch.centroid);
    ASSERT_LT(q, coarse.set.patches.size());
    const auto sky = static_cast<double>(plain.rows.sky_fraction[p]), off = static_cast<double>(coarse.rows.sky_fraction[q]) - sky;
    EXPECT_LE(std::abs(off), 2 * static_cast<double>(kError) + 1.0 / 128 + 2.0 / 32) << patch.centroid.x << " " << patch.centroid.z;
    square += off * off;
  }
  EXPECT_LT(std::sqrt(square / static_cast<double>(plain.set.patches.size())), static_cast<double>(kError) / 2);
}

std::map<std::string, std::string> filesOf(const std::filesystem::path& folder, const std::string& name) {
  std::map<std::string, std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().filename().string().starts_with(name + ".") && entry.is_regular_file()) {
      std::ifstream in(entry.path(), std::ios::binary);
      files[entry.path().filename().string()] = {std::istreambuf_iterator<char>(in), {}};
    }
  return files;
}

TEST(Merging, AWorldIsRightAndTheSameBytesOnAnyThreadsAndFromTheCacheOfAnother) {
  const auto folder = std::filesystem::temp_directory_path() / ("ff_merging_" + std::to_string(getpid()));
  const std::string path = (folder / "w.ffm").string();
  std::map<std::string, std::string> first;
  for (const auto& [threads, cached] : {std::pair(1, false), {4, false}, {2, true}}) {
    std::filesystem::create_directories(folder);
    BakeSettings settings{.cell_m = 1, .rays = 128, .quanta = 64, .threads = threads};
    auto cache = BakeCache::open((folder / "cache").string(), 1 << 30);
    ASSERT_TRUE(cache);
    if (cached) {
      settings.cache = cache->get();
      ASSERT_TRUE(bakeWorld(groundWithABlock(), settings, path));  // unmerged
    }
    settings.merge_error = kError;
    const auto stats = bakeWorld(groundWithABlock(), settings, path);
    ASSERT_TRUE(stats);
    EXPECT_EQ(stats->unmerged_patches, 64 * 64u + 4 * 4 * 6);
    EXPECT_LT(stats->levels[0].nodes, 2000u);
    const auto files = filesOf(folder, "w");
    EXPECT_GE(files.size(), 4u);
    if (first.empty()) first = files;
    EXPECT_EQ(files, first) << threads << cached;
    auto world = formats::WholeWorld::open(path);
    ASSERT_TRUE(world);
    const auto check = tools::checkWorld(*world, 1, nullptr);
    EXPECT_TRUE(check.corrupt.empty());
    EXPECT_TRUE(check.unphysical.empty());
    std::filesystem::remove_all(folder);
  }
  BakeSettings merging;
  merging.merge_error = kError;
  EXPECT_NE(bakeKey(groundWithABlock(), merging, 1), bakeKey(groundWithABlock(), {}, 1));
}

TEST(Merging, GroundThatIsCoarserByItsDensityIsMergedToo) {
  Scene s = openGround();
  s.materials[0].density = 0.5f;
  const PatchSet set = merged(s);
  ASSERT_EQ(set.patches.size(), 16u);
  for (const Patch& p : set.patches) EXPECT_NEAR(p.area_m2, 256, 1e-2f);
}

}  // namespace
}  // namespace ff::bake::test
