// The cubes on a ray's way, against a test of every cube of the box.
#include "bake/rays/ray_trail.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <random>
#include <set>

namespace ff::bake {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// How long a ray is inside of a cube that is larger by `more` on all sides, m; below 0: not at all.
double within(const CubeBox& box, const CubeBox::Cube& cube, const Ray& ray, double to_m, double more) {
  double enter = 0, leave = to_m;
  for (int a = 0; a < 3; ++a) {
    const double lo = static_cast<double>(cube[static_cast<size_t>(a)]) * static_cast<double>(box.edge_m) - more, hi = lo + static_cast<double>(box.edge_m) + 2 * more;
    const auto from = static_cast<double>(ray.origin[a]), along = static_cast<double>(ray.direction[a]);
    if (along == 0) {
      if (from < lo || from > hi) return -1;
      continue;
    }
    enter = std::max(enter, std::min((lo - from) / along, (hi - from) / along));
    leave = std::min(leave, std::max((lo - from) / along, (hi - from) / along));
  }
  return leave - enter;
}

Vec3 randomDirection(std::mt19937& random) {
  std::normal_distribution<float> normal;
  Vec3 d{normal(random), normal(random), normal(random)};
  if (random() % 4 == 0) d[static_cast<int>(random() % 3)] = 0;  // along a grid plane
  if (random() % 8 == 0) d = {0, 0, random() % 2 ? 1.0f : -1.0f};
  return normalized(d);
}

std::vector<uint32_t> cubesOf(const RayTrail& trail) {
  std::vector<uint32_t> numbers;
  for (const auto& [block, cubes] : trail.passed())
    for (uint32_t bit = 0; bit < 64; ++bit) if (cubes >> bit & 1) numbers.push_back(64 * block + bit);
  return numbers;
}

TEST(RayTrail, HoldsTheCubesOnTheWayAndNoOthers) {
  std::mt19937 random(1);
  const CubeBox box{0.75f, {-4, 4, -8}, {8, 8, 12}};
  RayTrail trail(box);
  for (int round = 0; round < 2000; ++round) {
    std::uniform_real_distribution<float> part(-0.3f, 1.3f);
    Ray ray;
    for (int a = 0; a < 3; ++a) {
      const auto i = static_cast<size_t>(a);
      ray.origin[a] = (static_cast<float>(box.lo[i]) + part(random) * static_cast<float>(box.size[i])) * box.edge_m;
    }
    if (random() % 4 == 0) ray.origin.x = std::round(ray.origin.x / box.edge_m) * box.edge_m;  // in a grid plane
    ray.direction = randomDirection(random);
    const double to_m = random() % 3 == 0 ? static_cast<double>(kInfinity) : 8.0 * static_cast<double>(random() % 1000) / 1000;
    trail.clear();
    trail.add(ray, to_m);
    const std::vector<uint32_t> cubes = cubesOf(trail);
    const std::set<uint32_t> passed(cubes.begin(), cubes.end());
    EXPECT_EQ(passed.size(), cubes.size());
    EXPECT_TRUE(std::is_sorted(cubes.begin(), cubes.end()));
    const auto cubesFrom = [&](double t, int a) {  // the lower side
      return (static_cast<double>(ray.origin[a]) + t * static_cast<double>(ray.direction[a])) / static_cast<double>(box.edge_m) - box.lo[static_cast<size_t>(a)];
    };
    const auto isOutside = [&](double t, int a, bool upper) {
      return upper ? cubesFrom(t, a) > box.size[static_cast<size_t>(a)] + 1e-5 : cubesFrom(t, a) < -1e-5;
    };
    // Everywhere on its way outside of the box, a ray is past a side that it left by, so that a box that is larger elsewhere alone is not on its way.
    for (int step = 0; step <= 400; ++step) {
      const double t = std::min(to_m, 40.0) * step / 400;
      bool outside = false, told = false;
      for (int a = 0; a < 3; ++a)
        for (const bool upper : {false, true}) {
          outside |= isOutside(t, a, upper);
          told |= isOutside(t, a, upper) && trail.left().has(static_cast<size_t>(a), upper);
        }
      EXPECT_EQ(told, outside) << round << ", " << t << " m on";
    }
    bool from_inside = true;
    for (int a = 0; a < 3; ++a) from_inside &= cubesFrom(0, a) > 0 && cubesFrom(0, a) < box.size[static_cast<size_t>(a)];
    for (int a = 0; from_inside && a < 3; ++a)
      for (const bool upper : {false, true}) {
        if (ray.direction[a] == 0 || (ray.direction[a] > 0) != upper) {
          EXPECT_FALSE(trail.left().has(static_cast<size_t>(a), upper)) << round;
        }
      }
    for (uint32_t number = 0; number < box.count(); ++number) {
      const CubeBox::Cube cube = box.cube(number);
      ASSERT_EQ(box.number(cube), number);
      if (within(box, cube, ray, to_m, -1e-5) > 1e-5) {
        EXPECT_TRUE(passed.contains(number)) << round << ": a cube on the way is missing";
      } else if (passed.contains(number)) {
        EXPECT_GE(within(box, cube, ray, to_m, 1e-5), 0) << round << ": a cube beside the way";
      }
    }
  }
}

TEST(RayTrail, ForgetsWhatIsClearedAndGathersWhatIsNot) {
  RayTrail trail({1, {0, 0, 0}, {4, 4, 4}});
  const Ray along_x{{0.5f, 0.5f, 0.5f}, {1, 0, 0}}, along_y{{0.5f, 0.5f, 0.5f}, {0, 1, 0}};
  trail.add(along_x, 1);
  trail.add(along_y, 1);
  EXPECT_EQ(cubesOf(trail), (std::vector<uint32_t>{0, 1, 4}));
  EXPECT_TRUE(trail.left().none());
  trail.clear();
  EXPECT_TRUE(cubesOf(trail).empty());
  trail.add(along_x, static_cast<double>(kInfinity));
  EXPECT_EQ(cubesOf(trail).size(), 4u);
  EXPECT_TRUE(trail.left().has(0, true));
  EXPECT_EQ(std::popcount(trail.left().bits()), 1);
}

}  // namespace
}  // namespace ff::bake
