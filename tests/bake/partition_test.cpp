// A patch does not straddle what parts it: windowless rooms on open ground stay dark inside under the sky.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <random>

#include "bake/light/form_factor.h"
#include "bake/surface/patches.h"
#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

constexpr float kHalf = 2, kHigh = 3;
constexpr Vec3 kMiddle{0.0371f, 0, 0.0371f};  // so that no wall stands on a grid line

// A room of 4 x 4 x 3 m on open ground of 12 m. thickness 0: double-sided sheets.
Scene room(float thickness) {
  Scene s;
  const uint32_t wall = addMaterial(s, {.8f, .8f, .8f}), ground = addMaterial(s, {.6f, .6f, .6f});
  const auto at = [](float x, float y, float z) { return kMiddle + Vec3{x, y, z}; };
  addQuad(s, at(-6, 0, -6), at(-6, 0, 6), at(6, 0, 6), at(6, 0, -6), ground);
  const float a = kHalf, b = kHalf + thickness, h = kHigh;
  if (thickness == 0) {
    s.materials[wall].double_sided = true;
    addQuad(s, at(-a, 0, -a), at(-a, h, -a), at(-a, h, a), at(-a, 0, a), wall);
    addQuad(s, at(a, 0, -a), at(a, h, -a), at(a, h, a), at(a, 0, a), wall);
    addQuad(s, at(-a, 0, -a), at(-a, h, -a), at(a, h, -a), at(a, 0, -a), wall);
    addQuad(s, at(-a, 0, a), at(-a, h, a), at(a, h, a), at(a, 0, a), wall);
    addQuad(s, at(-a, h, -a), at(-a, h, a), at(a, h, a), at(a, h, -a), wall);
  } else {
    addBlock(s, at(-b, 0, -b), at(-a, h, b), wall);
    addBlock(s, at(a, 0, -b), at(b, h, b), wall);
    addBlock(s, at(-a, 0, -b), at(a, h, -a), wall);
    addBlock(s, at(-a, 0, a), at(a, h, b), wall);
    addBlock(s, at(-b, h, -b), at(b, h + thickness, b), wall);
  }
  return s;
}

struct Light {
  double mean_inside = 0, worst_inside = 0;  // of open ground, weighted by area
  size_t patches = 0;
};

// Irradiance under a uniform sky of what lies in the room, all bounces.
Light light(const Scene& scene, const PatchSet& set, const RayCaster& caster, const std::function<bool(const Patch&)>& isInside) {
  constexpr uint32_t kRays = 512;
  WorkCount done;
  const HitRows rows = castRows(scene, set, caster, kRays, 1, done);
  const size_t n = set.patches.size();
  std::vector<double> direct(n), e;
  for (size_t i = 0; i < n; ++i) direct[i] = rows.sky[i] / (static_cast<double>(exposedFraction(rows, i)) * rows.rays[i]);
  e = direct;
  for (int bounce = 0; bounce < 40; ++bounce) {
    std::vector<double> next = direct;
    for (size_t i = 0; i < n; ++i)
      for (uint64_t k = rows.start[i]; k < rows.start[i + 1]; ++k)
        next[i] += rows.count[k] / (static_cast<double>(exposedFraction(rows, i)) * rows.rays[i]) *
                   static_cast<double>(set.patches[rows.column[k]].albedo.x) * e[rows.column[k]];
    e = std::move(next);
  }
  double open = 0, area = 0;
  Light light;
  light.patches = n;
  for (size_t i = 0; i < n; ++i) {
    open = std::max(open, e[i]);
    if (!isInside(set.patches[i])) continue;
    area += static_cast<double>(set.patches[i].area_m2);
    light.mean_inside += static_cast<double>(set.patches[i].area_m2) * e[i];
    light.worst_inside = std::max(light.worst_inside, e[i]);
  }
  light.mean_inside /= area * open;
  light.worst_inside /= open;
  return light;
}

// Faces the room's middle and lies in or on the inner faces of its walls, floor and ceiling.
bool isInRoom(const Patch& p) {
  const Vec3 c = p.centroid - kMiddle, in = Vec3{0, kHigh / 2, 0} - c;
  const float slack = 0.002f;
  return std::abs(c.x) < kHalf + slack && std::abs(c.z) < kHalf + slack && c.y > -slack && c.y < kHigh + slack && dot(p.normal, in) > 0;
}

// The scene moved, with triangles and corners in another order; mirrored ones wound the other way.
Scene moved(const Scene& in, const std::function<Vec3(Vec3)>& move, bool mirrored, uint32_t seed) {
  Scene s = in;
  for (Vec3& p : s.positions) p = move(p);
  std::mt19937 random(seed);
  for (size_t i = s.triangles.size(); i-- > 1;) std::swap(s.triangles[i], s.triangles[random() % (i + 1)]);
  for (Triangle& t : s.triangles) {
    if (mirrored) std::swap(t.v[1], t.v[2]);
    std::rotate(t.v.begin(), t.v.begin() + random() % 3, t.v.end());
  }
  return s;
}

constexpr double kMaxMean = 5e-4, kMaxOfAPatch = 1e-2;  // of open ground

TEST(Partitions, AWindowlessRoomOnOpenGroundIsDark) {
  for (const float thickness : {0.0f, 0.1f, 0.3f})
    for (const float cell : {0.25f, 1.0f}) {
      const Scene scene = room(thickness);
      const auto caster = RayCaster::create(scene);
      const auto set = makePatches(scene, {.cell_m = cell}, &*caster);
      ASSERT_TRUE(caster && set);
      // The scrap of floor in a corner of the room that lies in a cell of its own.
      const uint32_t corner = set->patchAt(1, true, {2.02f, 0, 2.02f}), beside = set->patchAt(0, true, {2.02f, 0, 2.02f});
      EXPECT_TRUE(isInRoom(set->patches[std::min(corner, beside)])) << thickness << " m walls, patches of " << cell;
      const Light l = light(scene, *set, *caster, isInRoom);
      EXPECT_LT(l.mean_inside, kMaxMean) << thickness << " m walls, patches of " << cell;
      EXPECT_LT(l.worst_inside, kMaxOfAPatch) << thickness << " m walls, patches of " << cell;
    }
}

TEST(Partitions, SoItIsTurnedScaledMirroredFarFromTheOriginAndInAnotherOrder) {
  const auto turned = [](float angle, Vec3 p) {
    const float c = std::cos(angle), s = std::sin(angle);
    return Vec3{c * p.x + s * p.z, p.y, c * p.z - s * p.x};
  };
  struct Variant {
    const char* name;
    std::function<Vec3(Vec3)> move, back;
    bool mirrored = false;
    float scale = 1;
  };
  const Variant variants[] = {
      {"turned", [&](Vec3 p) { return turned(0.4f, p); }, [&](Vec3 p) { return turned(-0.4f, p); }},
      {"tilted", [](Vec3 p) { return Vec3{0.8f * p.x - 0.6f * p.y, 0.6f * p.x + 0.8f * p.y, p.z}; },
       [](Vec3 p) { return Vec3{0.8f * p.x + 0.6f * p.y, 0.8f * p.y - 0.6f * p.x, p.z}; }},
      {"scaled", [](Vec3 p) { return p * 0.01f; }, [](Vec3 p) { return p * 100.0f; }, false, 0.01f},
      {"mirrored", [](Vec3 p) { return Vec3{p.z, p.y, p.x}; }, [](Vec3 p) { return Vec3{p.z, p.y, p.x}; }, true},
      {"far away", [](Vec3 p) { return p + Vec3{2000, 0, -1000}; }, [](Vec3 p) { return p - Vec3{2000, 0, -1000}; }},
  };
  for (const Variant& v : variants)
    for (const float thickness : {0.0f, 0.3f}) {
      const Scene scene = moved(room(thickness), v.move, v.mirrored, 7);
      const auto caster = RayCaster::create(scene);
      const auto set = makePatches(scene, {.cell_m = 0.7f * v.scale}, &*caster);
      ASSERT_TRUE(caster && set);
      const Light l = light(scene, *set, *caster, [&](Patch p) {
        const Vec3 tip = v.back(p.centroid + p.normal * v.scale);
        p.centroid = v.back(p.centroid);
        p.normal = tip - p.centroid;
        return isInRoom(p);
      });
      EXPECT_LT(l.mean_inside, kMaxMean) << v.name << ", " << thickness << " m walls";
      EXPECT_LT(l.worst_inside, kMaxOfAPatch) << v.name << ", " << thickness << " m walls";
    }
}

// A floor of two triangles with a wall from border to border along their common side, and one with a wall that ends half way.
TEST(Partitions, AWallPartsAFloorOnlyIfItReachesAcross) {
  for (const float end : {1.0f, 0.5f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), wall = addMaterial(s, {.5f, .5f, .5f});
    s.materials[wall].double_sided = true;
    addQuad(s, {0, .5f, 0}, {0, .5f, 1}, {1, .5f, 1}, {1, .5f, 0}, m);
    addQuad(s, {0, .5f, 0}, {end, .5f, end}, {end, .9f, end}, {0, .9f, 0}, wall);
    const auto caster = RayCaster::create(s);
    const auto set = makePatches(s, {.cell_m = 1}, &*caster);
    ASSERT_TRUE(caster && set);
    const uint32_t one = set->patchAt(0, true, {0.1f, .5f, .8f}), other = set->patchAt(1, true, {0.8f, .5f, .1f});
    ASSERT_LT(std::max(one, other), set->patches.size());
    EXPECT_EQ(one == other, end < 1) << end;
    EXPECT_NEAR(set->patches[one].area_m2, end < 1 ? 1 : 0.5, 1e-6) << end;
  }
}

// Two boards and a seam of two triangles between them, narrower than a hair, under a wall across all three: a moulding that goes on through a wall.
TEST(Partitions, AWallPartsASeamNarrowerThanAHair) {
  constexpr float kWall = 0.3f;
  for (const float seam : {4e-4f, 1e-4f, 2e-5f}) {
    Scene s;
    const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), wall = addMaterial(s, {.5f, .5f, .5f});
    s.materials[wall].double_sided = true;
    const float lines[] = {0, .5f, .5f + seam, 1};
    for (size_t k = 0; k < 3; ++k) addQuad(s, {0, .5f, lines[k]}, {0, .5f, lines[k + 1]}, {1, .5f, lines[k + 1]}, {1, .5f, lines[k]}, m);
    addQuad(s, {kWall, .5f, 0}, {kWall, .5f, 1}, {kWall, .9f, 1}, {kWall, .9f, 0}, wall);
    const auto caster = RayCaster::create(s);
    const auto set = makePatches(s, {.cell_m = 1}, &*caster);
    ASSERT_TRUE(caster && set);
    std::vector<float> floor;
    for (const Patch& p : set->patches)
      if (p.orientation == 2) floor.push_back(p.area_m2);
    std::sort(floor.begin(), floor.end());
    ASSERT_EQ(floor.size(), 2u) << seam;
    EXPECT_NEAR(floor[0], kWall, 1e-3f) << seam;
    EXPECT_NEAR(floor[1], 1 - kWall, 1e-3f) << seam;
  }
}

// Areas of a floor's patches, ascending: of one cell, with something over it.
std::vector<float> floorUnder(const std::function<void(Scene&, uint32_t)>& add) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), sheet = addMaterial(s, {.5f, .5f, .5f});
  s.materials[sheet].double_sided = true;
  addQuad(s, {0, .5f, 0}, {0, .5f, 1}, {1, .5f, 1}, {1, .5f, 0}, m);
  add(s, sheet);
  const auto caster = RayCaster::create(s);
  const auto set = makePatches(s, {.cell_m = 1}, &*caster);
  std::vector<float> areas;
  for (const Patch& p : set->patches)
    if (p.orientation == 2 && p.centroid.y < .5f + 1e-4f) areas.push_back(p.area_m2);
  std::sort(areas.begin(), areas.end());
  return areas;
}

// A door, or a moulding with a slit behind it; what hangs higher, as a table does, does not part a floor.
TEST(Partitions, WhatHangsLowOverAFloorPartsIt) {
  constexpr float kAt = 0.3f;
  for (const float gap : {0.003f, 0.02f, 0.2f}) {
    const std::vector<float> sheet = floorUnder([&](Scene& s, uint32_t m) {
      addQuad(s, {kAt, .5f + gap, 0}, {kAt, .5f + gap, 1}, {kAt, .9f, 1}, {kAt, .9f, 0}, m);
    });
    const std::vector<float> board = floorUnder([&](Scene& s, uint32_t m) { addBlock(s, {kAt, .5f + gap, -1}, {2, 1.5f, 2}, m); });
    for (const std::vector<float>& areas : {sheet, board}) {
      ASSERT_EQ(areas.size(), gap < 0.1f ? 2u : 1u) << gap;
      EXPECT_NEAR(areas[0], gap < 0.1f ? kAt : 1, 1e-3f) << gap;
      EXPECT_NEAR(areas.back(), gap < 0.1f ? 1 - kAt : 1, 1e-3f) << gap;
    }
  }
}

// A mesh that hangs low bounds what is under it, not what its own edges part; a stick that ends half way parts nothing.
TEST(Partitions, WhatHangsLowPartsAFloorByItsOutlineAlone) {
  const std::vector<float> mesh = floorUnder([&](Scene& s, uint32_t m) {
    constexpr int kSide = 8;
    const auto at = [](int i, int k) { return Vec3{.25f + .5f * static_cast<float>(i) / kSide, .51f, .25f + .5f * static_cast<float>(k) / kSide}; };
    for (int i = 0; i < kSide; ++i)
      for (int k = 0; k < kSide; ++k) addQuad(s, at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k), m);
  });
  ASSERT_EQ(mesh.size(), 2u);
  EXPECT_NEAR(mesh[0], .25f, 1e-3f);
  EXPECT_NEAR(mesh[1], .75f, 1e-3f);
  const std::vector<float> stick = floorUnder([&](Scene& s, uint32_t m) { addQuad(s, {.3f, .51f, 0}, {.3f, .51f, .5f}, {.3f, .9f, .5f}, {.3f, .9f, 0}, m); });
  ASSERT_EQ(stick.size(), 1u);
}

TEST(Partitions, FeetAndGrassDoNotMakeAFloorSmaller) {
  // Four feet of 4 cm and 200 blades on one cell of floor: one patch, less what is under the feet.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), blade = addMaterial(s, {.1f, .5f, .1f});
  s.materials[blade].double_sided = true;
  addQuad(s, {0, .5f, 0}, {0, .5f, 1}, {1, .5f, 1}, {1, .5f, 0}, m);
  for (const float x : {0.2f, 0.7f})
    for (const float z : {0.2f, 0.7f}) addBlock(s, {x, .5f, z}, {x + .04f, .8f, z + .04f}, m);
  std::mt19937 random(3);
  const auto uniform = [&] { return static_cast<float>(random() >> 8) * 0x1p-24f; };
  for (int k = 0; k < 200; ++k) {
    const Vec3 at{0.3f + uniform() * 0.3f, .5f, uniform() * 0.9f};  // between the feet, across each other
    addTriangle(s, at, at + Vec3{uniform() * 0.05f, 0, uniform() * 0.05f}, at + Vec3{0, 0.05f, 0}, blade);
  }
  const auto caster = RayCaster::create(s);
  const auto set = makePatches(s, {.cell_m = 1}, &*caster);
  ASSERT_TRUE(caster && set);
  const uint32_t floor = set->patchAt(0, true, {0.05f, .5f, .95f});
  ASSERT_LT(floor, set->patches.size());
  EXPECT_NEAR(set->patches[floor].area_m2, 1, 1e-3);  // the feet's tops are crumbs and join it
  for (const float x : {0.22f, 0.72f})
    for (const float z : {0.22f, 0.72f}) EXPECT_EQ(set->patchAt(x > z ? 1 : 0, true, {x, .5f, z}), kSealed) << x << " " << z;
}

// A floor of 1,152 triangles in one cell, each under a blade of grass, on both sides of a wall: neighbours in a mesh are connected however many lie in a cell, or
// each triangle would be a crumb, and all crumbs one patch.
TEST(Partitions, AWallPartsAFloorOfManyTrianglesUnderGrass) {
  constexpr int kSide = 24;
  constexpr float kEdge = 1.0f / kSide, kBlade = 0.1f * kEdge;
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), sheet = addMaterial(s, {.5f, .5f, .5f});
  s.materials[sheet].double_sided = true;
  for (int i = 0; i < kSide; ++i)
    for (int k = 0; k < kSide; ++k) {
      const Vec3 o{static_cast<float>(i) * kEdge, .5f, static_cast<float>(k) * kEdge}, middle = o + Vec3{kEdge / 2, 0, kEdge / 2};
      addQuad(s, o, o + Vec3{0, 0, kEdge}, o + Vec3{kEdge, 0, kEdge}, o + Vec3{kEdge, 0, 0}, m);
      addTriangle(s, middle + Vec3{kBlade, 0, -kBlade}, middle + Vec3{-kBlade, 0, kBlade}, middle + Vec3{0, kBlade, 0}, sheet);
    }
  addQuad(s, {.5f, .5f, 0}, {.5f, .5f, 1}, {.5f, .9f, 1}, {.5f, .9f, 0}, sheet);
  const auto caster = RayCaster::create(s);
  ASSERT_TRUE(caster);
  const auto set = makePatches(s, {.cell_m = 1}, &*caster);
  ASSERT_TRUE(set);
  std::vector<float> floor;
  for (const Patch& p : set->patches)
    if (p.orientation == 2) floor.push_back(p.area_m2);
  ASSERT_EQ(floor.size(), 2u);
  for (const float area : floor) EXPECT_NEAR(area, 0.5f, 1e-3f);
}

TEST(Partitions, GroundUnderASingleSidedWaterFaceIsNotLitByTheRaysThatGetAway) {
  // A seabed of 40 m, the water's face 0.2 m above it: a few rays of its border get away.
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f}), water = addMaterial(s, {.1f, .1f, .3f});
  addQuad(s, {-20, 0, -20}, {-20, 0, 20}, {20, 0, 20}, {20, 0, -20}, m);
  addQuad(s, {-20, .2f, -20}, {-20, .2f, 20}, {20, .2f, 20}, {20, .2f, -20}, water);
  const CastScene c = cast(std::move(s), 1, 512);
  for (size_t i = 0; i < c.set.patches.size(); ++i) {
    if (materialOf(c, static_cast<uint32_t>(i)) != m) continue;
    const Patch& p = c.set.patches[i];
    const float to_border = 20 - std::max(std::abs(p.centroid.x), std::abs(p.centroid.z));
    const double sky = c.rows.sky[i] / (static_cast<double>(exposedFraction(c.rows, i)) * c.rows.rays[i]);
    // By the edge of an endless strip at distance d less than a cell all the light comes over the border: at most half the sky.
    EXPECT_LT(sky, to_border > 1 ? 0.1 : 0.55) << to_border << " m from the border";
  }
}

}  // namespace
}  // namespace ff::bake::test
