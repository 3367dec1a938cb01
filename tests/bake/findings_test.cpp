// What a bake says of scenes that are broken, with counts and places; and that it says nothing of those that are not.
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <functional>
#include <iostream>
#include <string>

#include "bake/bake.h"
#include "bake/cleanup/open_edges.h"
#include "bake/cleanup/slivers.h"
#include "bake/import/gltf_import.h"
#include "tests/bake/variants.h"
#include "tests/support/random_world.h"
#include "tests/support/town_scene.h"

namespace ff::bake::test {
namespace {

std::optional<Finding> openEdges(const Scene& scene) {
  const auto caster = RayCaster::create(scene);
  EXPECT_TRUE(caster);
  WorkCount stop;
  return findOpenEdges(scene, *caster, stop);
}

// An outward box; face: 0 its underside, 1 to 4 its sides, 5 its top.
void addBox(Scene& s, Vec3 lo, Vec3 hi, uint32_t material) {
  const size_t first = s.triangles.size();
  addRoom(s, lo, hi, material, material);
  for (size_t t = first; t < s.triangles.size(); ++t) std::swap(s.triangles[t].v[1], s.triangles[t].v[2]);
}

void addGround(Scene& s) { addQuad(s, {-9, 0, -9}, {-9, 0, 9}, {9, 0, 9}, {9, 0, -9}, addMaterial(s, {.5f, .5f, .5f})); }

void takeFace(Scene& s, size_t box_first, size_t face) {
  const auto at = s.triangles.begin() + static_cast<ptrdiff_t>(box_first + 2 * face);
  s.triangles.erase(at, at + 2);
}

// A ground, and 1 m above it a cube of 2 m, from (-1, 1, -1).
Scene cube() {
  Scene s;
  addGround(s);
  addBox(s, {-1, 1, -1}, {1, 3, 1}, addMaterial(s, {.5f, .5f, .5f}));
  s.materials[1].name = "cube";
  return s;
}

TEST(OpenEdges, ACubeWithoutAFaceIsNamedWhicheverItIs) {
  for (const Variant& v : kVariants) {
    EXPECT_FALSE(openEdges(varied(cube(), v))) << v.name;
    for (size_t face = 0; face < 6; ++face) {
      SCOPED_TRACE(std::string(v.name) + ", face " + std::to_string(face));
      Scene s = cube();
      takeFace(s, 2, face);
      const auto found = openEdges(varied(s, v));
      ASSERT_TRUE(found);
      EXPECT_EQ(found->kind, "open_edges");
      EXPECT_EQ(found->count, 4u);
      EXPECT_NEAR(found->share, 20.0 / (20 + 324), 1e-5);
      ASSERT_EQ(found->places.size(), 1u);
      EXPECT_NE(found->places[0].name.find("cube"), std::string::npos);
      // The middle of an edge of the cube: two coordinates at corners, the third between.
      const auto& at = *found->places[0].at;
      int ends = 0;
      for (const Vec3 axis : {v.x, v.y, v.z}) {
        double along = 0;
        for (int k = 0; k < 3; ++k) along += static_cast<double>(axis[k]) * at[static_cast<size_t>(k)];
        along = along / static_cast<double>(v.scale) - (axis == v.y ? 2 : 0);
        ends += std::abs(std::abs(along) - 1) < 1e-4;
      }
      EXPECT_EQ(ends, 2);
    }
  }
}

TEST(OpenEdges, ACrackedFaceIsNamed) {
  const auto cracked = [](const std::function<void(Scene&)>& crack) {
    Scene s = cube();
    crack(s);
    const auto found = openEdges(s);
    return found && found->places[0].name.find("cube") != std::string::npos;
  };
  const auto corner = [](Scene& s, uint32_t triangle, uint32_t k) -> Vec3& { return s.positions[s.triangles[triangle].v[k]]; };
  EXPECT_TRUE(cracked([&](Scene& s) {  // the top, a millimetre too high
    for (const uint32_t t : {12u, 13u})
      for (uint32_t k = 0; k < 3; ++k) corner(s, t, k).y += 1e-3f;
  }));
  EXPECT_TRUE(cracked([&](Scene& s) { corner(s, 12, 0).y += 1e-3f; }));  // a corner of one of its triangles
  EXPECT_TRUE(cracked([&](Scene& s) { corner(s, 4, 1).x += 0.2f; }));    // a side's
  EXPECT_TRUE(cracked([](Scene& s) { s.triangles.erase(s.triangles.begin() + 5); }));
  EXPECT_FALSE(cracked([&](Scene& s) { corner(s, 12, 0).y += 1e-7f; }));  // rounding
}

TEST(OpenEdges, OfWhatMayBeOpenNothingIsSaid) {
  Scene standing;  // without an underside, on a ground
  addGround(standing);
  addBox(standing, {-1, 0, -1}, {1, 2, 1}, addMaterial(standing, {.5f, .5f, .5f}));
  takeFace(standing, 2, 0);
  EXPECT_FALSE(openEdges(standing));

  Scene post;  // whose end is in another solid
  addBox(post, {-1, 0, -1}, {1, 2, 1}, addMaterial(post, {.5f, .5f, .5f}));
  addBox(post, {-.1f, 1.5f, -.1f}, {.1f, 3, .1f}, 0);
  takeFace(post, 12, 0);
  EXPECT_FALSE(openEdges(post));

  Scene double_sided = cube();
  takeFace(double_sided, 2, 5);
  double_sided.materials[1].double_sided = true;
  EXPECT_FALSE(openEdges(double_sided));

  Scene sheet;
  addGround(sheet);
  EXPECT_FALSE(openEdges(sheet));

  Scene seam;  // a face in two halves beside an edge that is whole: a corner on an edge
  addBox(seam, {0, 0, 0}, {2, 2, 2}, addMaterial(seam, {.5f, .5f, .5f}));
  takeFace(seam, 0, 5);
  addQuad(seam, {0, 2, 0}, {0, 2, 2}, {1, 2, 2}, {1, 2, 0}, 0);
  addQuad(seam, {1, 2, 0}, {1, 2, 2}, {2, 2, 2}, {2, 2, 0}, 0);
  EXPECT_FALSE(openEdges(seam));

  Scene block;  // of ground, with hills, sides and no underside
  addMaterial(block, {.5f, .5f, .5f});
  const auto height = [](int x, int z) { return 20 + 3 * std::sin(static_cast<float>(x)) + 2 * std::cos(static_cast<float>(2 * z)); };
  const auto p = [&](int x, int z) { return Vec3{static_cast<float>(x), height(x, z), static_cast<float>(z)}; };
  const auto foot = [](int x, int z) { return Vec3{static_cast<float>(x), 0, static_cast<float>(z)}; };
  for (int x = 0; x < 20; ++x)
    for (int z = 0; z < 20; ++z) addQuad(block, p(x, z), p(x, z + 1), p(x + 1, z + 1), p(x + 1, z), 0);
  for (int k = 0; k < 20; ++k) {
    addQuad(block, foot(0, k), foot(0, k + 1), p(0, k + 1), p(0, k), 0);
    addQuad(block, foot(20, k + 1), foot(20, k), p(20, k), p(20, k + 1), 0);
    addQuad(block, foot(k + 1, 0), foot(k, 0), p(k, 0), p(k + 1, 0), 0);
    addQuad(block, foot(k, 20), foot(k + 1, 20), p(k + 1, 20), p(k, 20), 0);
  }
  EXPECT_FALSE(openEdges(block));
  block.triangles.erase(block.triangles.begin() + 400);  // a hole in a hill is none of its borders
  EXPECT_TRUE(openEdges(block));
}

TEST(OpenEdges, ARoomHasWindowsAndIsNotCracked) {
  const auto room = [](float window_m) {  // in the wall at x = 0, upright
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
    addRoom(s, {0, 0, 0}, {4, 3, 4}, m, m);
    takeFace(s, 0, 1);
    const float lo = 2 - window_m / 2, hi = 2 + window_m / 2;
    const auto wall = [&](float y0, float y1, float z0, float z1) { addQuad(s, {0, y0, z0}, {0, y1, z0}, {0, y1, z1}, {0, y0, z1}, m); };
    wall(0, 3, 0, lo);
    wall(0, 3, hi, 4);
    wall(0, 1, lo, hi);
    wall(2, 3, lo, hi);
    return s;
  };
  EXPECT_FALSE(openEdges(room(1)));
  EXPECT_TRUE(openEdges(room(0.01f)));
}

TEST(Slivers, AreSaidWhereTheyAreMany) {
  Scene s = cube();
  EXPECT_FALSE(findSlivers(s));
  s.without_area = 1;
  s.without_area_at = {{{{1, 2, 3}}, "node 7"}};
  auto found = findSlivers(s);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->count, 1u);
  EXPECT_EQ(lineOf(*found), "1 triangle has no area and is left out (6.7 % of the triangles): at 1 2 3, node 7");
  addTriangle(s, {-1, 3, -1}, {1, 3, -1}, {0, 3.000002f, -1}, 1);
  found = findSlivers(s);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->count, 2u);
  ASSERT_EQ(found->places.size(), 2u);
  EXPECT_NEAR((*found->places[0].at)[1], 3, 1e-3);
  for (int k = 0; k < 200; ++k) addBox(s, {20, 0, 0}, {21, 1, 1}, 1);
  EXPECT_FALSE(findSlivers(s)) << "one in a thousand";
}

TEST(Findings, AreOneLineEach) {
  Finding f{"kind", "what", 3, "triangles", 0.0123, "surface"};
  EXPECT_EQ(lineOf(f), "what (1.2 % of the surface)");
  f.places = {{{{1.5, -0.0001, -2.25}}, "a", 0.75}, {{}, "b", 0.25}};
  f.more_places = 2;
  f.remedy = "do this";
  EXPECT_EQ(lineOf(f), "what (1.2 % of the surface): at 1.5 0 -2.25, a (75 %); b (25 %); and 2 more; do this");
  EXPECT_EQ(textOf({1e7 + 0.001, -12345, 0}), "10000000.001 -12345 0");
}

class BakeFindings : public ::testing::Test {
 protected:
  Result<BakeStats> bake(const Scene& s, BakeSettings settings = {}) {
    settings.rays = 256;
    settings.quanta = 64;
    settings.geometry = false;
    if (settings.cell_m == 0) settings.cell_m = 0.5f;
    return bakeWorld(s, settings, folder_.file("w.ffm"));
  }
  static std::vector<std::string> lines(const BakeStats& stats) {
    std::vector<std::string> out;
    for (const Finding& f : stats.findings) out.push_back(f.kind + ": " + lineOf(f));
    return out;
  }
  const formats::TemporaryFolder folder_;
};

// A room with a sheet in it, at x = 3, which faces the wall behind it: what half of the room sees is its back.
Scene roomWithSheet() {
  Scene s;
  const uint32_t walls = addMaterial(s, {.5f, .5f, .5f}), sheet = addMaterial(s, {.5f, .5f, .5f}, {1, 1, 1});
  s.materials[sheet].name = "sheet";
  s.origin = {100, 0, 0};
  addRoom(s, {0, 0, 0}, {4, 3, 4}, walls, walls);
  addQuad(s, {3, .5f, .5f}, {3, 2.5f, .5f}, {3, 2.5f, 3.5f}, {3, .5f, 3.5f}, sheet);  // its front is at larger x
  return s;
}

TEST_F(BakeFindings, LeaksAreWhereLightEndsOnBacksFromTheCacheAsWell) {
  const Scene s = roomWithSheet();
  const auto fresh = bake(s);
  ASSERT_TRUE(fresh) << fresh.error().line();
  ASSERT_EQ(fresh->findings.size(), 1u);
  const Finding& leak = fresh->findings[0];
  EXPECT_EQ(leak.kind, "leaks");
  EXPECT_NEAR(leak.share, fresh->absorbed_fraction, 1e-12);
  EXPECT_GT(leak.share, 0.05);
  EXPECT_GT(leak.count, 0u);
  ASSERT_FALSE(leak.places.empty());
  double all = 0;
  for (const FoundPlace& place : leak.places) {
    ASSERT_TRUE(place.at);
    EXPECT_NEAR((*place.at)[0], 103, 1e-4);  // on the sheet
    EXPECT_GT((*place.at)[1], 0.5 - 1e-4);
    EXPECT_LT((*place.at)[1], 2.5 + 1e-4);
    EXPECT_NE(place.name.find("sheet"), std::string::npos);
    all += place.share;
  }
  EXPECT_NEAR(all, 1, 1e-5);  // the room is less than a cube of kLeakLog wide, and no unit has more than kMaxLeaks of them

  for (const int threads : {1, 3}) {
    auto cache = BakeCache::open(folder_.file("cache" + std::to_string(threads)), 1 << 30);
    ASSERT_TRUE(cache);
    for (const bool cached : {false, true}) {
      const auto again = bake(s, {.threads = threads, .cache = cache->get()});
      ASSERT_TRUE(again);
      EXPECT_EQ(again->cast_rays == 0, cached);
      EXPECT_EQ(lines(*again), lines(*fresh));
    }
  }
}

TEST_F(BakeFindings, DuplicatesAndOverlapsHavePlaces) {
  Scene s;
  const uint32_t room = addMaterial(s, {.5f, .5f, .5f}), wall = addMaterial(s, {.5f, .5f, .5f}), sheet = addMaterial(s, {.5f, .5f, .5f});
  s.materials[wall].name = "wall";
  s.materials[sheet].name = "sheet";
  addRoom(s, {0, 0, 0}, {4, 3, 4}, room, room);
  const uint32_t side = addMaterial(s, {.5f, .5f, .5f});
  s.materials[side].cutout = s.materials[sheet].cutout = true;  // without holes the one would stand for the other
  s.triangles[2].material = s.triangles[3].material = side;     // at x = 0
  addQuad(s, {4, 0, 0}, {4, 0, 4}, {4, 3, 4}, {4, 3, 0}, wall);                            // as the room's own, at x = 4
  addQuad(s, {0, 0.4f, 0.4f}, {0, 2.6f, 0.4f}, {0, 2.6f, 3.6f}, {0, 0.4f, 3.6f}, sheet);  // on the wall at x = 0
  const auto stats = bake(s, {.cell_m = 1});
  ASSERT_TRUE(stats) << stats.error().line();
  ASSERT_EQ(stats->findings.size(), 2u) << lines(*stats)[0];
  EXPECT_EQ(stats->findings[0].kind, "duplicates");
  EXPECT_EQ(stats->findings[0].count, 2u);
  EXPECT_NEAR(stats->findings[0].share, 12 / (80 + 12 + 2.2 * 3.2), 1e-5);
  EXPECT_NEAR((*stats->findings[0].places.at(0).at)[0], 4, 1e-6);
  EXPECT_EQ(stats->findings[1].kind, "overlaps");
  EXPECT_NEAR((*stats->findings[1].places.at(0).at)[0], 0, 1e-3);
}

TEST_F(BakeFindings, OfATownNothingIsSaid) {
  const Scene scene = townScene(folder_, 4000);
  const auto caster = RayCaster::create(scene);
  ASSERT_TRUE(caster);
  WorkCount stop;
  const auto began = std::chrono::steady_clock::now();
  EXPECT_FALSE(findOpenEdges(scene, *caster, stop));
  const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - began;
  std::cout << "looking for open edges takes " << took.count() / static_cast<double>(scene.triangles.size()) << " us a triangle\n";
  const auto stats = bake(scene, {.cell_m = 1});
  ASSERT_TRUE(stats);
  EXPECT_TRUE(stats->findings.empty()) << lines(*stats)[0];
}

}  // namespace
}  // namespace ff::bake::test
