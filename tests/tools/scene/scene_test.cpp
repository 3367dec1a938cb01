#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <tuple>

#include "tools/scene/analytic.h"
#include "tools/scene/camera.h"
#include "tools/scene/glb.h"
#include "tools/scene/kinds.h"
#include "tools/scene/town.h"

namespace ff::tools {
namespace {

using Point = std::tuple<float, float, float>;
Point key(Vec3 p) { return {p.x, p.y, p.z}; }

Town town(uint64_t patches, uint64_t seed = 1) {
  auto made = makeTown({patches, seed, 1});
  if (!made) std::abort();
  return std::move(*made);
}

template <class F>
void eachTriangle(const SceneModel& model, F&& f) {
  for (const SceneNode& node : model.nodes)
    for (const ScenePart& part : node.parts)
      for (size_t i = 0; i + 2 < part.indices.size(); i += 3)
        f(std::array<Vec3, 3>{part.positions[part.indices[i]], part.positions[part.indices[i + 1]],
                              part.positions[part.indices[i + 2]]},
          part.material);
}

double areaOf(const SceneModel& model) {
  double area = 0;
  eachTriangle(model, [&](const auto& t, uint32_t) { area += 0.5 * length(cross(t[1] - t[0], t[2] - t[0])); });
  return area;
}

// How often each directed edge occurs more often than its opposite: empty for a closed, consistently oriented surface.
std::map<std::pair<Point, Point>, int> openEdges(const SceneModel& model) {
  std::map<std::pair<Point, Point>, int> edges;
  eachTriangle(model, [&](const auto& t, uint32_t) {
    for (size_t k = 0; k < 3; ++k) {
      const Point a = key(t[k]), b = key(t[(k + 1) % 3]);
      ++edges[{a, b}];
      --edges[{b, a}];
    }
  });
  std::erase_if(edges, [](const auto& e) { return e.second == 0; });
  return edges;
}

// Six times the volume enclosed; negative where the faces look inwards.
double signedVolume(const SceneModel& model) {
  double v = 0;
  eachTriangle(model, [&](const auto& t, uint32_t) { v += dot(t[0], cross(t[1], t[2])); });
  return v;
}

TEST(Town, IsTheSameBytesForTheSameSeedAndOthersForAnother) {
  const auto a = glbBytes(townModel(town(3000, 7), false)), b = glbBytes(townModel(town(3000, 7), false));
  const auto c = glbBytes(townModel(town(3000, 8), false));
  ASSERT_TRUE(a && b && c);
  EXPECT_EQ(*a, *b);
  EXPECT_NE(*a, *c);
}

// FNV-1a of all bytes: fails if a machine or a change of the code makes another town. Update on purpose only: figures that
// were published for a seed belong to the town of that seed.
TEST(Town, OfSeedOneIsTheOneKnown) {
  const auto bytes = glbBytes(townModel(town(2000, 1), false));
  ASSERT_TRUE(bytes);
  // The JSON names the generator's version: only the geometry counts.
  uint32_t json_bytes = 0;
  for (size_t i = 0; i < 4; ++i) json_bytes |= uint32_t{(*bytes)[12 + i]} << (8 * i);
  uint64_t h = 0xcbf29ce484222325u;
  for (size_t i = 20 + json_bytes; i < bytes->size(); ++i) h = (h ^ (*bytes)[i]) * 0x100000001b3u;
  EXPECT_EQ(h, 0xf10efeb5d002cbedu);
}

class TownSize : public testing::TestWithParam<std::tuple<uint64_t, uint64_t>> {};
TEST_P(TownSize, IsWithinFivePercentOfWhatWasAsked) {
  const auto [patches, seed] = GetParam();
  const Town t = town(patches, seed);
  EXPECT_LE(std::abs(static_cast<double>(t.faces) / static_cast<double>(patches) - 1), 0.05) << t.faces;
  EXPECT_EQ(t.faces, t.voxels.exposedFaces());
  EXPECT_GT(t.lamps, 2u);
}
INSTANTIATE_TEST_SUITE_P(Sizes, TownSize,
                         testing::Combine(testing::Values(2000, 3000, 8999, 9000, 30'000, 60'000, 400'000),
                                          testing::Values(1, 2, 3)));

TEST(Town, RefusesSizesOutsideItsRange) {
  EXPECT_FALSE(makeTown({kMinTownPatches - 1, 1, 1}));
  EXPECT_FALSE(makeTown({kMaxTownPatches + 1, 1, 1}));
}

TEST(Town, HasEachUnitFaceOnceOnIntegerCoordinatesAndFacingAir) {
  const Town t = town(12'000, 4);
  const SceneModel model = townModel(t, false);
  std::map<std::array<Point, 3>, int> seen;
  uint64_t triangles = 0;
  eachTriangle(model, [&](const auto& v, uint32_t material) {
    ++triangles;
    std::array<Point, 3> k{key(v[0]), key(v[1]), key(v[2])};
    std::sort(k.begin(), k.end());
    EXPECT_EQ(++seen[k], 1);
    for (Vec3 p : v) EXPECT_TRUE(p.x == std::round(p.x) && p.y == std::round(p.y) && p.z == std::round(p.z));
    const Vec3 n = cross(v[1] - v[0], v[2] - v[0]), c = (v[0] + v[1] + v[2]) / 3;
    EXPECT_EQ(length(n), 1);  // half a unit square
    const auto voxelAt = [&](Vec3 p) {
      return t.voxels.at({static_cast<int>(std::floor(p.x)) - t.origin.x, static_cast<int>(std::floor(p.y)) - t.origin.y,
                          static_cast<int>(std::floor(p.z)) - t.origin.z});
    };
    EXPECT_EQ(voxelAt(c + n * 0.1f), Voxels::kAir);
    EXPECT_EQ(voxelAt(c - n * 0.1f), material + 1);
  });
  EXPECT_EQ(triangles, 2 * t.faces);
}

TEST(Town, MergedHasTheSameAreaPerMaterialWithFewerTriangles) {
  const Town t = town(12'000, 4);
  std::map<uint32_t, double> unit, merged;
  size_t unit_n = 0, merged_n = 0;
  const auto add = [](std::map<uint32_t, double>& sum, size_t& n) {
    return [&sum, &n](const std::array<Vec3, 3>& v, uint32_t material) {
      sum[material] += 0.5 * length(cross(v[1] - v[0], v[2] - v[0]));
      ++n;
    };
  };
  eachTriangle(townModel(t, false), add(unit, unit_n));
  eachTriangle(townModel(t, true), add(merged, merged_n));
  EXPECT_EQ(unit, merged);
  EXPECT_LT(merged_n, unit_n / 2);
}

TEST(Town, HasLampsInRoomsWithoutASkyAndLampsOutside) {
  const Town t = town(60'000, 1);
  std::set<uint8_t> kinds;
  uint64_t under_a_roof = 0, under_the_sky = 0;
  const Int3 size = t.voxels.size();
  for (int y = 0; y < size.y; ++y)
    for (int z = 0; z < size.z; ++z)
      for (int x = 0; x < size.x; ++x) {
        const uint8_t kind = t.voxels.at({x, y, z});
        kinds.insert(kind);
        if (kind != kWarmLamp && kind != kCoolLamp && kind != kStreetLamp) continue;
        bool roof = false;
        for (int up = y + 1; up < size.y && !roof; ++up) roof = !t.voxels.air({x, up, z});
        ++(roof ? under_a_roof : under_the_sky);
      }
  EXPECT_GT(under_a_roof, 50u);
  EXPECT_GT(under_the_sky, 10u);
  EXPECT_GT(kinds.size(), 20u);
}

class TownCamera : public testing::TestWithParam<uint64_t> {};
TEST_P(TownCamera, StaysInOpenAirAndEntersAHouseAndRisesAboveTheRoofs) {
  const Town t = town(GetParam(), 2);
  const auto path = flyThrough(t, 20);
  ASSERT_TRUE(path) << path.error().line();
  bool inside = false, above = false;
  for (size_t i = 0; i < path->keys.size(); ++i) {
    const CameraKey& k = path->keys[i];
    EXPECT_TRUE(openAir(t, k.eye, 0.2f)) << "key " << i;
    EXPECT_GT(length(k.target - k.eye), 1);
    if (i > 0) {
      const CameraKey& before = path->keys[i - 1];
      EXPECT_GE(k.t, before.t);
      for (int s = 1; s < 8; ++s)
        EXPECT_TRUE(openAir(t, before.eye + (k.eye - before.eye) * (static_cast<float>(s) / 8), 0.1f)) << "after key " << i - 1;
    }
    const Int3 v{static_cast<int>(std::floor(k.eye.x)) - t.origin.x, static_cast<int>(std::floor(k.eye.y)) - t.origin.y,
                 static_cast<int>(std::floor(k.eye.z)) - t.origin.z};
    bool roof = false, ground_far_below = true;
    for (int up = v.y + 1; up < t.voxels.size().y; ++up) roof |= !t.voxels.air({v.x, up, v.z});
    for (int down = 1; down < 20; ++down) ground_far_below &= t.voxels.air({v.x, v.y - down, v.z});
    inside |= roof;
    above |= ground_far_below;
  }
  EXPECT_TRUE(inside);
  EXPECT_TRUE(above);
  EXPECT_NEAR(path->keys.back().t, 20, 1e-6);
}
INSTANTIATE_TEST_SUITE_P(Sizes, TownCamera, testing::Values(2000, 12'000, 60'000));

TEST(Town, CameraFileHoldsKeysSunAndSky) {
  const auto path = flyThrough(town(12'000), 10);
  ASSERT_TRUE(path);
  const auto j = nlohmann::json::parse(cameraJson(*path));
  EXPECT_EQ(j["keys"].size(), path->keys.size());
  EXPECT_EQ(j["keys"][3]["eye"].size(), 3u);
  const auto& d = j["sun"]["direction"];
  EXPECT_NEAR(std::hypot(d[0].get<double>(), d[1].get<double>(), d[2].get<double>()), 1, 2e-3);
  EXPECT_EQ(j["sky"]["zenith"].size(), 3u);
}

TEST(Analytic, BoxAndRoomsAndCorridorAreClosedAndLookInwards) {
  EXPECT_TRUE(openEdges(furnaceBox(0.5f, 1)).empty());
  EXPECT_NEAR(signedVolume(furnaceBox(0.5f, 1)), -6, 1e-6);
  EXPECT_TRUE(openEdges(corridor(0.5f, 1)).empty());
  EXPECT_NEAR(signedVolume(corridor(0.5f, 1)), -6 * 80, 1e-3);
  // The lit room's ceiling is in nine parts beside undivided walls: closed by area, not edge by edge.
  EXPECT_NEAR(areaOf(twoRooms(0.1f, 0.5f, 1)), 2 * 80, 1e-3);
  EXPECT_NEAR(signedVolume(twoRooms(0.1f, 0.5f, 1)), -6 * 2 * 48, 1e-2);
}

TEST(Analytic, PlatesAreUnitSquaresThatFaceEachOther) {
  for (const SceneModel& m : {parallelPlates(1, 0.5f, 1), perpendicularPlates(0.5f, 1)}) {
    EXPECT_NEAR(areaOf(m), 2, 1e-6) << m.name;
    eachTriangle(m, [&](const auto& t, uint32_t) {
      const Vec3 to_middle = Vec3{0.5f, 0.5f, 0.5f} - (t[0] + t[1] + t[2]) / 3;
      EXPECT_GT(dot(cross(t[1] - t[0], t[2] - t[0]), to_middle), 0) << m.name;
    });
  }
}

TEST(Analytic, DiscsHaveTheAreaOfTheDiscAndFaceEachOther) {
  const SceneModel m = coaxialDiscs(2, 48, 0.5f, 1);
  EXPECT_NEAR(areaOf(m), 2 * 3.14159265, 1e-5);
  eachTriangle(m, [&](const auto& t, uint32_t material) {
    EXPECT_EQ(t[0].y, material == 0 ? 0 : 2);
    EXPECT_GT(cross(t[1] - t[0], t[2] - t[0]).y * (material == 0 ? 1.f : -1.f), 0);
  });
}

TEST(Analytic, CapHasItsAreaAndLooksAtTheCentre) {
  // Facets of width d = 2 pi / segments lie inside the sphere: each chord lacks d^2/24 of its arc, the mean ring of a facet
  // d^2/8 of the arc's, the slanted height at most d^2/8 more. Together at most d^2/3 of the area.
  const SceneModel m = sphericalCap(60, 128, 0.5f, 1);
  const double area = 2 * 3.14159265 * (1 - 0.5), d = 2 * 3.14159265 / 128;
  EXPECT_LE(areaOf(m), area);
  EXPECT_NEAR(areaOf(m), area, area * d * d / 3);
  eachTriangle(m, [&](const auto& t, uint32_t) { EXPECT_LT(dot(cross(t[1] - t[0], t[2] - t[0]), t[0]), 0); });
  EXPECT_EQ(openEdges(m).size(), 2u * 128);  // the rim, each edge in both directions
}

TEST(Analytic, EmissionIsWrittenAsRadiance) {
  const SceneModel m = furnaceBox(0.5f, 3.14159265f);
  EXPECT_FLOAT_EQ(m.materials[0].radiance.x, 1);
}

}  // namespace
}  // namespace ff::tools
