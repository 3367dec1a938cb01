// Objects whose patches are finer or coarser than elsewhere, beside the same scene without.
#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/cleanup/scene_cleanup.h"
#include "bake/estimate.h"
#include "bake/surface/fineness.h"
#include "bake/surface/patch_size.h"
#include "formats/read/whole_world.h"
#include "tests/bake/variants.h"

namespace ff::bake::test {
namespace {

constexpr float kCell = 0.5f;
constexpr uint32_t kRoom = 0, kStatue = 1, kSheet = 2;  // materials

// A closed room with a block that hangs in it and a sheet with two sides, askew.
Scene statueRoom(float density, Vec3 radiance = {1, 1, 1}, float albedo = .5f) {
  Scene s;
  for (const char* name : {"room", "statue", "sheet"}) {
    addMaterial(s, {albedo, albedo, albedo}, radiance);
    s.materials.back().name = name;
    s.materials.back().lamp_group = "all";
  }
  addRoom(s, {0, 0, 0}, {4, 3, 4}, kRoom, kRoom);
  addBlock(s, {1.13f, 0.87f, 1.21f}, {2.37f, 1.93f, 2.69f}, kStatue);
  addQuad(s, {2.9f, 0.4f, 0.5f}, {3.3f, 0.6f, 3.2f}, {3.4f, 2.5f, 3.3f}, {3.0f, 2.3f, 0.6f}, kSheet);
  s.materials[kSheet].double_sided = true;
  for (const uint32_t m : {kStatue, kSheet}) s.materials[m].density = density;
  return s;
}

PatchSet cutAt(const Scene& scene, float cell_m) {
  const auto caster = RayCaster::create(scene);
  return *makePatches(scene, {.cell_m = cell_m}, &*caster);
}

// Of the patches of some materials: their areas and places, in an order of their own, and their box's longest edge.
struct Cut {
  std::vector<std::array<double, 4>> patches;
  double area = 0, longest = 0;
};
Cut cutOf(const Scene& scene, const PatchSet& set, bool room) {
  Cut cut;
  for (const Patch& p : set.patches) {
    if ((scene.triangles[set.triangles[p.first_triangle].source].material == kRoom) != room) continue;
    const auto d = [](float x) { return static_cast<double>(x); };
    cut.patches.push_back({d(p.area_m2), d(p.centroid.x), d(p.centroid.y), d(p.centroid.z)});
    const Vec3 size = p.bounds.hi - p.bounds.lo;
    cut.longest = std::max({cut.longest, d(size.x), d(size.y), d(size.z)});
  }
  for (const PatchTriangle& t : set.triangles)
    if ((scene.triangles[t.source].material == kRoom) == room) cut.area += 0.5 * static_cast<double>(length(cross(t.b - t.a, t.c - t.a)));
  std::sort(cut.patches.begin(), cut.patches.end(), [](const auto& a, const auto& b) {
    const auto key = [](const auto& x) { return std::array{std::lround(x[1] * 1e3), std::lround(x[2] * 1e3), std::lround(x[3] * 1e3), std::lround(x[0] * 1e5)}; };
    return key(a) < key(b);
  });
  return cut;
}

TEST(Density, AnObjectIsCutAsTheWholeSceneWouldBeWithPatchesOfItsSizeAndTheRestAsIfItWereNot) {
  for (const Variant& v : kVariants)
    for (const float density : {0.25f, 0.5f, 2.0f, 4.0f, 8.0f}) {
      const Scene scene = varied(statueRoom(density), v), plain = varied(statueRoom(1), v);
      const float cell = kCell * v.scale;
      const PatchSet set = cutAt(scene, cell), there = cutAt(plain, cell), finer = cutAt(plain, cell / density);
      EXPECT_NEAR(set.area_m2 / there.area_m2, 1, 1e-5) << v.name;
      for (const bool room : {true, false}) {
        const Cut cut = cutOf(scene, set, room), twin = cutOf(plain, room ? there : finer, room);
        // Crumbs may join a patch of another grid, and borders are told apart by a share of the base cell.
        EXPECT_NEAR(static_cast<double>(cut.patches.size()), static_cast<double>(twin.patches.size()), 0.01 * static_cast<double>(twin.patches.size())) << v.name << density << room;
        EXPECT_NEAR(cut.area / twin.area, 1, 1e-4) << v.name << density << room;
        if (v.turned() || cut.patches.size() != twin.patches.size()) continue;
        for (size_t i = 0; i < cut.patches.size(); ++i)
          for (size_t k = 0; k < 4; ++k) EXPECT_NEAR(cut.patches[i][k], twin.patches[i][k], 1e-4 * static_cast<double>(v.scale * v.scale)) << v.name << density << room << i;
      }
      // A crumb reaches into the next cell, the crumb of a crumb into one more.
      EXPECT_LT(cutOf(scene, set, false).longest, 2.5 * static_cast<double>(cell / density)) << v.name << density;
    }
}

TEST(Density, EveryPointOfBothSidesIsFoundInAPatchThatLiesThere) {
  for (const Variant& v : kVariants)
    for (const float density : {0.0625f, 0.5f, 2.0f, 16.0f}) {
      const Scene scene = varied(statueRoom(density), v);
      const PatchSet set = cutAt(scene, kCell * v.scale);
      double farthest = 0;
      int points = 0, bent = 0;
      for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
        const auto& corner = scene.triangles[t].v;
        const Vec3 a = scene.positions[corner[0]], b = scene.positions[corner[1]] - a, c = scene.positions[corner[2]] - a;
        const bool both = scene.materials[scene.triangles[t].material].double_sided;
        for (int i = 0; i < 40; ++i)
          for (int k = 0; k + i < 40; ++k)
            for (int side = 0; side < (both ? 2 : 1); ++side) {
              const Vec3 at = a + b * (static_cast<float>(i) / 39) + c * (static_cast<float>(k) / 39);
              const uint32_t p = set.patchAt(t, side == 0, at);
              ASSERT_LT(p, set.patches.size()) << v.name << density;
              farthest = std::max(farthest, static_cast<double>(set.patches[p].bounds.distance(at)) / static_cast<double>(v.scale));
              ++points;
              bent += dot(set.patches[p].normal, cross(b, c)) * (side == 0 ? 1.0f : -1.0f) <= 0;
            }
      }
      EXPECT_LT(farthest, 1e-3) << v.name << density;
      EXPECT_LT(bent, 2e-3 * points) << v.name << density;  // next to nothing joins whatever is near
      for (uint32_t p = 0; p < set.patches.size(); ++p)  // and each triangle of a patch is found again
        for (uint32_t k = set.patches[p].first_triangle; k < set.patches[p].first_triangle + set.patches[p].triangles; ++k) {
          const PatchTriangle& t = set.triangles[k];
          const auto& corner = scene.triangles[t.source].v;
          const Vec3 n = cross(scene.positions[corner[1]] - scene.positions[corner[0]], scene.positions[corner[2]] - scene.positions[corner[0]]);
          EXPECT_EQ(set.patchAt(t.source, dot(n, cross(t.b - t.a, t.c - t.a)) > 0, (t.a + t.b + t.c) / 3.0f), p) << v.name << density;
        }
    }
}

TEST(Density, TheLightOfTheWholeStaysAsItIs) {
  // The room alone shines; what it gives the statue, and gets back from it, hangs on all of the cuts.
  const auto room = [](float density) {
    Scene s = statueRoom(density);
    for (const uint32_t m : {kStatue, kSheet}) s.materials[m].emission = {};
    s.materials[kStatue].base_color = {.9f, .9f, .9f};
    return s;
  };
  std::vector<std::string> notes;
  for (const size_t which : {2u, 5u}) {
    const Variant& v = kVariants[which];
    const Light twin = lightOf(room(1), v, notes);
    for (const float density : {0.5f, 4.0f}) {
      expectSameLight(lightOf(room(density), v, notes), twin, v.name);
      EXPECT_TRUE(notes.empty());
    }
  }
}

TEST(Density, AClosedFurnaceKeepsItsClosedFormAtEveryLevel) {
  // B = M / (1 - rho), as in Bake.AFurnaceOfAnyAlbedoReachesItsClosedForm: rows' counts add up to all, so it is exact if no ray is lost.
  const auto folder = std::filesystem::temp_directory_path() / ("ff_density_" + std::to_string(getpid()));
  for (const float density : {0.25f, 2.0f, 4.0f}) {
    std::filesystem::create_directories(folder);
    const auto stats = bakeWorld(statueRoom(density, {1, 1, 1}, 0.8f), {.cell_m = 0.19f, .rays = 64, .quanta = 64}, (folder / "w.ffm").string());
    ASSERT_TRUE(stats);
    EXPECT_TRUE(stats->warnings.empty() && stats->findings.empty());
    auto world = formats::WholeWorld::open((folder / "w.ffm").string());
    ASSERT_TRUE(world);
    ASSERT_GE(world->levels().size(), 2u);
    const auto expected = static_cast<float>(std::numbers::pi / (1 - 0.8));
    for (uint32_t l = 0; l < world->levels().size(); ++l) {
      double area = 0;
      for (const auto& tile : world->tiles(l)) {
        auto strip = world->strip(tile.id);
        ASSERT_TRUE(strip);
        std::vector<uint32_t> sum(strip->nodes.size());
        for (size_t e = 0; e < strip->rows.size(); ++e) sum[strip->rows[e]] += strip->counts[e];
        for (size_t i = 0; i < strip->nodes.size(); ++i) {
          const formats::Node& node = strip->nodes[i];
          ASSERT_EQ(sum[i], node.quanta) << density;  // B is the same everywhere if every row adds up
          EXPECT_NEAR(node.emission.x + node.albedo.x * expected, expected, 1e-3f * expected);
          area += static_cast<double>(node.area_m2);
        }
      }
      EXPECT_NEAR(area / stats->area_m2, 1, 1e-5) << density;
    }
    std::filesystem::remove_all(folder);
  }
}

TEST(Density, TheBudgetIsMetAndTheEstimateIsOfIt) {
  for (const float density : {0.25f, 0.5f, 2.0f, 4.0f, 16.0f}) {
    const Scene scene = statueRoom(density);
    const auto caster = RayCaster::create(scene);
    for (const uint32_t budget : {2000u, 10000u}) {
      const auto set = patchesWithin(budget, scene, {}, *caster);
      ASSERT_TRUE(set);
      EXPECT_NEAR(static_cast<double>(set->patches.size()), budget, 0.1 * budget) << density;
      const double estimate = estimateBake(scene, {.cell_m = set->cell_m}).patches;
      EXPECT_NEAR(estimate / static_cast<double>(set->patches.size()), 1, 0.5) << density;
      EXPECT_NEAR(estimateBake(scene, {.patch_budget = budget}).cell_m / static_cast<double>(set->cell_m), 1, 0.3) << density;
    }
  }
}

TEST(Density, APatchThatIsCoarserIsListedInAllCellsThatItLiesIn) {
  const Scene plain = statueRoom(1), coarse = statueRoom(0.125f);
  const auto cells = [](const Scene& s) {
    std::set<Cell> out;
    const auto set = makePatches(s, {.cell_m = kCell});  // without crumbs parted or sealed
    for (const Patch& p : set->patches)
      if (s.triangles[set->triangles[p.first_triangle].source].material == kStatue)
        for (const Cell& cell : set->cellsOf(p)) out.insert(cell);
    return out;
  };
  EXPECT_EQ(cells(coarse), cells(plain));
}

TEST(Density, IsChosenByNameRoundedToAPowerOfTwoAndPartOfTheKey) {
  const Scene s = statueRoom(1);
  const auto clean = [&](std::vector<std::pair<std::string, float>> density) { return cleanUp(s, {.density = std::move(density)}); };
  EXPECT_FALSE(clean({})->scene);
  const auto two = clean({{"stat*", 2}}), four = clean({{"stat*", 2}, {"statue", 4}});
  ASSERT_TRUE(two && four && two->scene && four->scene);
  EXPECT_TRUE(two->findings.empty());
  const auto of = [](const Scene& scene, uint32_t t) { return scene.materials[scene.triangles[t].material].density; };
  EXPECT_EQ(of(*two->scene, 12), 2);   // the statue
  EXPECT_EQ(of(*two->scene, 11), 1);   // the room
  EXPECT_EQ(of(*four->scene, 12), 4);  // the last word
  EXPECT_NE(bakeKey(*two->scene, {}, 1), bakeKey(*four->scene, {}, 1));
  EXPECT_NE(bakeKey(*two->scene, {}, 1), bakeKey(s, {}, 1));

  const auto three = clean({{"statue", 3}});
  ASSERT_TRUE(three);
  ASSERT_EQ(three->findings.size(), 1u);
  EXPECT_NE(three->findings[0].what.find("3 is rounded to 4"), std::string::npos) << three->findings[0].what;
  EXPECT_NE(three->findings[0].places.at(0).name.find("statue"), std::string::npos);
  EXPECT_NE(bakeKey(*three->scene, {}, 1), bakeKey(*two->scene, {}, 1));  // the same triangles of the same materials
  EXPECT_EQ(cutAt(*three->scene, kCell).patches.size(), cutAt(*four->scene, kCell).patches.size());

  for (const auto& [density, fineness] : {std::pair(1.0f, 0), {1.3f, 0}, {1.5f, 1}, {0.7f, -1}, {0.0625f, -4}, {0.07f, -4}, {16.0f, 4}, {15.0f, 4}})
    EXPECT_EQ(finenessOf(density), fineness) << density;
}

TEST(Density, OutOfRangeOrOfNothingIsOneLine) {
  const Scene s = statueRoom(1);
  for (const auto& [pattern, density, what] : {std::tuple("statue", 17.0f, "0.0625 to 16"), {"statue", 0.06f, "0.0625 to 16"}, {"statue", -2.0f, "0.0625 to 16"},
                                               {"statue", std::nanf(""), "0.0625 to 16"}, {"Statue", 2.0f, "named \"Statue\""}}) {
    const auto clean = cleanUp(s, {.density = {{pattern, density}}});
    ASSERT_FALSE(clean) << density;
    EXPECT_EQ(clean.error().code, ErrorCode::kUsage);
    EXPECT_NE(clean.error().line().find(what), std::string::npos) << clean.error().line();
  }
}

}  // namespace
}  // namespace ff::bake::test
