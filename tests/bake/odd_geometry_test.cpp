// Scenes as people export them, each with one odd thing, beside their clean twins.
#include <gtest/gtest.h>

#include <algorithm>

#include "bake/cleanup/coincident.h"
#include "tests/bake/variants.h"

namespace ff::bake::test {
namespace {

// A floor of 8 m with a slab 10 cm above its middle, and one triangle of 1 m2 so far away.
Scene floorUnderSlab(float stray_m) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 8}, {8, 0, 8}, {8, 0, 0}, m);
  addBlock(s, {2, 0.1f, 2}, {6, 0.14f, 6}, m);
  if (stray_m > 0) addTriangle(s, {stray_m, 0, 0}, {stray_m, 0, 2}, {stray_m + 1, 0, 1}, m);
  return s;
}

TEST(OddGeometry, AStrayTriangleFarAwayChangesNothing) {
  struct Near {
    double area = 0, sky = 0;
  };
  const auto near = [](float stray_m) {
    const CastScene c = cast(floorUnderSlab(stray_m), 0.5f, 256);
    Near sum;
    for (size_t i = 0; i < c.set.patches.size(); ++i) {
      if (c.set.patches[i].centroid.x > 100) continue;
      const double area = static_cast<double>(c.set.patches[i].area_m2);
      sum.area += area;
      sum.sky += area * c.rows.sky[i] / c.rows.rays[i];
    }
    return sum;
  };
  const Near alone = near(0);
  EXPECT_NEAR(alone.area, 64 + 2 * 16 + 4 * 4 * 0.04, 0.05);  // less a little that is sealed between floor and slab
  for (const float stray_m : {5e3f, 5e4f, 4e5f}) {
    const Near with = near(stray_m);
    EXPECT_NEAR(with.area, alone.area, 1e-4) << stray_m;
    // Patches' numbers are others, so are their rays: 256 rays of each of some 600 patches, a standard error of 0.1 % of a share near 0.5.
    EXPECT_NEAR(with.sky / alone.sky, 1, 0.005) << stray_m;
  }
}

enum class Twice { kNothing, kLamp, kWall, kWallOtherDiagonal, kWallNearly };

Scene lampRoom(Twice twice) {
  Scene s;
  const uint32_t walls = addMaterial(s, {.5f, .5f, .5f}), lamp = addMaterial(s, {}, {1, 1, 1}), other = addMaterial(s, {.5f, .5f, .5f});
  addRoom(s, {0, 0, 0}, {4, 3, 4}, walls, walls);
  const Vec3 a{0, 0, 0}, b{0, 3, 0}, c{0, 3, 4}, d{0, 0, 4};
  if (twice == Twice::kWall) addQuad(s, a, b, c, d, other);
  if (twice == Twice::kWallOtherDiagonal) addQuad(s, b, c, d, a, walls);
  if (twice == Twice::kWallNearly) {
    const Vec3 off{0, 1e-6f, -1e-6f};
    addQuad(s, a + off, b + off, c + off, d + off, other);
  }
  for (int i = 0; i < (twice == Twice::kLamp ? 3 : 1); ++i) addBlock(s, {1.5f, 1.8f, 1.5f}, {2.5f, 2.2f, 2.5f}, lamp);
  return s;
}

TEST(OddGeometry, WhatLiesTwiceAtOnePlaceCountsOnce) {
  std::vector<std::string> notes;
  for (const Variant& v : kVariants) {
    const Light twin = lightOf(lampRoom(Twice::kNothing), v, notes);
    EXPECT_TRUE(notes.empty());
    for (const Twice twice : {Twice::kLamp, Twice::kWall, Twice::kWallOtherDiagonal, Twice::kWallNearly}) {
      const Light odd = lightOf(lampRoom(twice), v, notes);
      ASSERT_EQ(notes.size(), 1u) << v.name;
      EXPECT_NE(notes[0].find(twice == Twice::kLamp ? "24 triangles" : "2 triangles"), std::string::npos) << notes[0];
      expectSameLight(odd, twin, v.name);
    }
  }
}

TEST(OddGeometry, OfTwoSurfacesAtOnePlaceTheEmitterStaysWhateverTheOrder) {
  for (const bool lamp_first : {false, true}) {
    Scene s;
    const uint32_t wall = addMaterial(s, {.5f, .5f, .5f}), lamp = addMaterial(s, {}, {1, 1, 1});
    for (const bool first : {true, false}) addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, first == lamp_first ? lamp : wall);
    const auto duplicate = findDuplicates(s);
    for (uint32_t t = 0; t < 4; ++t) EXPECT_EQ(duplicate[t], s.triangles[t].material == wall);
  }
}

TEST(OddGeometry, BacksOfOneAnotherHolesAndNeighboursAreNoDuplicates) {
  Scene s;
  const uint32_t wall = addMaterial(s, {.5f, .5f, .5f}), leaves = addMaterial(s, {.5f, .5f, .5f});
  s.materials[leaves].cutout = true;
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, wall);
  addQuad(s, {0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}, wall);    // the other side of a sheet
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, leaves);  // seen through nothing but itself
  addQuad(s, {1, 0, 0}, {1, 0, 1}, {2, 0, 1}, {2, 0, 0}, wall);
  for (const bool d : findDuplicates(s)) EXPECT_FALSE(d);
}

TEST(OddGeometry, MillionsAtOnePlaceTakeLinearTime) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, m);
  for (int i = 0; i < 1'000'000; ++i) s.triangles.push_back(s.triangles[0]);
  const auto duplicate = findDuplicates(s);
  EXPECT_EQ(std::count(duplicate.begin(), duplicate.end(), true), 1'000'000);
}

// Two rooms that share a plane of no thickness at x = 4: one with a lamp for a ceiling, as large as the other or larger, and a dark one.
struct Rooms {
  Scene scene;
  size_t first_lit, end_lit;  // triangles
};
Rooms rooms(bool other, bool other_first, bool larger) {
  Rooms r;
  const uint32_t walls = addMaterial(r.scene, {.5f, .5f, .5f}), lamp = addMaterial(r.scene, {}, {1, 1, 1});
  if (other && other_first) addRoom(r.scene, {0, 0, 0}, {4, 3, 4}, walls, walls);
  r.first_lit = r.scene.triangles.size();
  addRoom(r.scene, {4, 0, larger ? -1.3f : 0}, larger ? Vec3{8.1f, 3.7f, 5.1f} : Vec3{8, 3, 4}, walls, lamp);
  r.end_lit = r.scene.triangles.size();
  if (other && !other_first) addRoom(r.scene, {0, 0, 0}, {4, 3, 4}, walls, walls);
  return r;
}

TEST(OddGeometry, RoomsThatShareAPlaneOfNoThicknessAreEachAsIfAlone) {
  std::vector<std::string> notes;
  for (const Variant& v : kVariants) {
    const Light twin = lightOf(rooms(false, false, false).scene, v, notes);
    for (const bool other_first : {true, false}) {
      const Light odd = lightOf(rooms(true, other_first, false).scene, v, notes);
      EXPECT_TRUE(notes.empty());
      expectSameLight(odd, twin, v.name);
    }
  }
}

TEST(OddGeometry, RoomsThatShareAPlaneShareNoPatchAndNoRay) {
  std::vector<Variant> variants(std::begin(kVariants), std::end(kVariants));
  // In a corner of the dark room lies a scrap of floor whose neighbours are scraps as well, and a patch of the lit room in its cell.
  variants.push_back({"scraps", {.3206048f, .5845813f, .7453035f}, {-.4333644f, .7901839f, -.4333644f}, {-.8422635f, -.1840493f, .5066735f}, 1, true});
  for (const Variant& v : variants)
    for (const bool larger : {true, false}) {
      const Rooms r = rooms(true, true, larger);
      const CastScene c = cast(varied(r.scene, v), 0.5f * v.scale, 256);
      const size_t n = r.scene.triangles.size();
      std::vector<int> room(c.set.patches.size());  // 1 lit, 2 dark, 3 both
      for (size_t i = 0; i < room.size(); ++i)
        for (uint32_t k = 0; k < c.set.patches[i].triangles; ++k) {
          const size_t source = c.set.triangles[c.set.patches[i].first_triangle + k].source, t = v.shuffled ? n - 1 - source : source;
          room[i] |= t >= r.first_lit && t < r.end_lit ? 1 : 2;
        }
      EXPECT_EQ(std::count(room.begin(), room.end(), 3), 0) << v.name;
      for (size_t i = 0; i < room.size(); ++i) {
        for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k) EXPECT_EQ(room[c.rows.column[k]], room[i]) << v.name;
        EXPECT_TRUE(room[i] == 1 || c.rows.lamps[i].empty()) << v.name;
      }
    }
}

// A block on a ground of 20 m under a dome of 500 m.
Scene domed(bool dome) {
  Scene s;
  const uint32_t ground = addMaterial(s, {.5f, .5f, .5f}), sky = addMaterial(s, {.4f, .6f, 1});
  addQuad(s, {-10, 0, -10}, {-10, 0, 10}, {10, 0, 10}, {10, 0, -10}, ground);
  addBlock(s, {-2, 0, -2}, {2, 3, 2}, ground);
  s.materials[sky].unlit = true;
  if (!dome) return s;
  const auto at = [](int r, int k) {
    const double t = std::numbers::pi / 2 * r / 8, p = 2 * std::numbers::pi * (k % 16) / 16;
    return Vec3{static_cast<float>(500 * std::sin(t) * std::cos(p)), static_cast<float>(500 * std::cos(t)),
                static_cast<float>(500 * std::sin(t) * std::sin(p))};
  };
  for (int r = 0; r < 8; ++r)
    for (int k = 0; k < 16; ++k) {
      if (r > 0) addTriangle(s, at(r, k), at(r + 1, k + 1), at(r, k + 1), sky);
      addTriangle(s, at(r, k), at(r + 1, k), at(r + 1, k + 1), sky);
    }
  return s;
}

TEST(OddGeometry, ASkyDomeIsLeftOutAndSaid) {
  std::vector<std::string> notes;
  for (const Variant& v : kVariants) {
    const Light twin = lightOf(domed(false), v, notes);
    EXPECT_TRUE(notes.empty());
    const Light odd = lightOf(domed(true), v, notes);
    ASSERT_EQ(notes.size(), 1u) << v.name;
    EXPECT_NE(notes[0].find("--keep-sky-dome"), std::string::npos);
    expectSameLight(odd, twin, v.name);
  }
  EXPECT_FALSE(cleanUp(domed(true), {.keep_sky_dome = true})->scene);
}

TEST(OddGeometry, OnlyWhatIsASkyIsTakenForOne) {
  Scene s = domed(true);
  s.materials[1].unlit = false;
  EXPECT_FALSE(cleanUp(s, {})->scene);  // a dome of stone
  for (const char* name : {"SkyDome_01", "sky", "Sky Sphere", "low-skybox.003"}) {
    s.materials[1].name = name;
    EXPECT_TRUE(cleanUp(s, {})->scene) << name;
  }
  for (const char* name : {"skylight", "Skyscraper", "husky", "dome"}) {
    s.materials[1].name = name;
    EXPECT_FALSE(cleanUp(s, {})->scene) << name;
  }
  Scene ground = domed(false);  // an unlit ground under what stands on it
  addQuad(ground, {-100, 0, -100}, {-100, 0, 100}, {100, 0, 100}, {100, 0, -100}, 1);
  EXPECT_FALSE(cleanUp(ground, {})->scene);
}

TEST(OddGeometry, BacksAbsorbReflectOrPass) {
  // A floor under a sheet that faces up: the floor sees its back.
  Scene s;
  const uint32_t white = addMaterial(s, {.8f, .8f, .8f});
  addQuad(s, {0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, white);
  addQuad(s, {0, 2.5f, 0}, {0, 2.5f, 4}, {4, 2.5f, 4}, {4, 2.5f, 0}, white);
  struct Sums {
    double floor_m2 = 0, floor = 0, down_m2 = 0;
  };
  const auto sums = [&](Backs backs) {
    std::vector<std::string> notes;
    Sums sum;
    for (const auto& [place, bin] : lightOf(s, kVariants[0], notes, {.backs = backs})) {
      const auto [x, y, z, facing] = place;
      if (facing == 3 && y > 0) sum.down_m2 += bin.first;
      if (facing != 2 || y != 0) continue;
      sum.floor_m2 += bin.first;
      sum.floor += bin.second;
    }
    return sum;
  };
  const Sums absorb = sums(Backs::kAbsorb), reflect = sums(Backs::kReflect), pass = sums(Backs::kPass);
  for (const Sums& each : {absorb, reflect, pass}) EXPECT_NEAR(each.floor_m2, 16, 0.1);
  EXPECT_EQ(absorb.down_m2, 0);
  EXPECT_NEAR(reflect.down_m2, 16, 0.1);
  EXPECT_EQ(pass.down_m2, 0);
  EXPECT_NEAR(pass.floor, 16, 0.01);  // all of the sky
  EXPECT_LT(absorb.floor, 12);
  // The floor's form factor to the sheet is 0.4 (squares at 0.625 of their edge): it gets back at least 0.4 * 0.8 of what it sends there.
  EXPECT_GT(reflect.floor, absorb.floor * (1 + 0.8 * 0.8 * 0.4 * 0.4));
}

TEST(OddGeometry, ChosenObjectsAreLeftOutOrOnlyBlockLight) {
  Scene s = lampRoom(Twice::kNothing);
  s.node_names = {"room", "bulb 1"};
  s.objects = {{0, 0, kNone}, {12, 1, kNone}};
  EXPECT_EQ(cleanUp(s, {.exclude = {"bulb*"}})->scene->triangles.size(), 12u);
  EXPECT_EQ(cleanUp(s, {.exclude = {"bulb*"}})->scene->objects[1].first_triangle, 12u);
  EXPECT_FALSE(cleanUp(s, {.exclude = {"Bulb*"}}));
  const auto blocks = cleanUp(s, {.occlude_only = {"bulb ?"}});
  ASSERT_TRUE(blocks && blocks->scene);
  EXPECT_NE(blocks->scene->content_hash, s.content_hash);
  const CastScene c = cast(*blocks->scene, 0.5f, 256), all = cast(s, 0.5f, 256);
  EXPECT_NEAR(c.set.area_m2, 80, 1e-3);
  EXPECT_NEAR(all.set.area_m2, 83.6, 1e-3);
  uint64_t absorbed = 0;
  for (const uint32_t hits : c.rows.absorbed) absorbed += hits;
  EXPECT_GT(absorbed, 0u);  // rays end on the lamp
}

}  // namespace
}  // namespace ff::bake::test
