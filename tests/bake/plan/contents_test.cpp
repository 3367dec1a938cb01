// What digests of places tell apart, and what they do not.
#include "bake/plan/contents.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "tests/support/analytic_scenes.h"

namespace ff::bake {
namespace {

constexpr float kCell = 1;

// By the first corner of the cube, in cubes.
std::map<CubeBox::Cube, Digest> cubesOf(const Scene& scene) {
  const auto caster = RayCaster::create(scene);
  EXPECT_TRUE(caster);
  const auto set = makePatches(scene, {.cell_m = kCell}, &*caster);
  EXPECT_TRUE(set) << set.error().line();
  const Contents contents(scene, *set);
  const CubeBox& box = contents.box();
  std::map<CubeBox::Cube, Digest> cubes;
  for (uint32_t number = 0; number < box.count(); ++number) {
    std::vector<Digest> held;
    const CubeBox::Cube cube = box.cube(number), block = box.cube(number / 64 * 64);
    contents.append(block, uint64_t{1} << number % 64, 0, held);
    if (!held.empty()) cubes[cube] = held[0];
  }
  return cubes;
}

std::set<CubeBox::Cube> changed(const Scene& before, const Scene& after) {
  const auto a = cubesOf(before), b = cubesOf(after);
  std::set<CubeBox::Cube> changed;
  for (const auto* of : {&a, &b})
    for (const auto& [cube, digest] : *of)
      if (!a.contains(cube) || !b.contains(cube) || a.at(cube) != b.at(cube)) changed.insert(cube);
  return changed;
}

TEST(Contents, OfACubeDoNotCountHowItsSurfaceIsCut) {
  Scene scene;
  const uint32_t grey = test::addMaterial(scene, {.5f, .5f, .5f});
  test::addQuad(scene, {0, 0, 0}, {0, 0, 16}, {16, 0, 16}, {16, 0, 0}, grey);
  Scene with_sheet = scene;
  test::addQuad(with_sheet, {5.5f, 0, 4.2f}, {5.5f, 0, 5.8f}, {5.5f, 3, 5.8f}, {5.5f, 3, 4.2f}, grey);  // cuts cells of the ground that reach to the next cubes
  EXPECT_EQ(changed(scene, with_sheet), (std::set<CubeBox::Cube>{{2, -1, 2}, {2, 0, 2}, {2, 1, 2}}));
}

TEST(Contents, OfACubeCountWhatIsSealedThere) {
  Scene closed;
  const uint32_t grey = test::addMaterial(closed, {.5f, .5f, .5f});
  test::addBlock(closed, {4, 0, 4.2f}, {7, 0.5f, 4.8f}, grey);  // a duct, seen from both sides
  closed.materials[grey].double_sided = true;
  Scene open = closed;
  std::erase_if(open.triangles, [&](const Triangle& t) { return std::ranges::all_of(t.v, [&](uint32_t v) { return open.positions[v].x == 7; }); });
  ASSERT_EQ(open.triangles.size() + 2, closed.triangles.size());
  EXPECT_TRUE(changed(open, closed).contains({2, 0, 2}));  // it has nothing of the end wall
}

}  // namespace
}  // namespace ff::bake
