// What rays meet against each triangle on its own, which has no boxes, on every instruction set that Embree knows and this processor has.
#include "bake/rays/ray_caster.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <random>
#include <thread>

#include "bake/paging.h"
#include "bake/rays/surface_sampling.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/random_world.h"

namespace ff::bake::test {
namespace {

constexpr float kFar = std::numeric_limits<float>::infinity();
constexpr uint64_t kNoRoom = 1;  // for trees: each is let go once the next is wanted

// Casters of one scene, at least two.
std::vector<RayCaster> casters(const Scene& scene) {
  std::vector<RayCaster> made;
  for (const char* isa : {"isa=sse2", "isa=sse4.2", "isa=avx", "isa=avx2", "isa=avx512"}) {
    auto caster = RayCaster::create(scene, RayCaster::kNoLimit, isa);
    auto in_parts = RayCaster::create(scene, kNoRoom, isa);
    if (!caster) std::cout << "note: this processor has no " << isa << "; it is not tested\n";
    for (auto* c : {&caster, &in_parts})
      if (*c) made.push_back(std::move(**c));
  }
  EXPECT_GE(made.size(), 2u);
  return made;
}

// Of materials the second has holes.
Scene doubleSided() {
  Scene s;
  s.materials.resize(2);
  for (Material& m : s.materials) m.double_sided = true;
  s.materials[1].cutout = s.materials[1].blend = true;
  s.materials[1].alpha = 0.5f;
  return s;
}

class Random {
 public:
  explicit Random(uint64_t seed) : random_(seed) {}
  float unit() { return std::uniform_real_distribution<float>(-1, 1)(random_); }
  Vec3 any(float reach) { return Vec3{unit(), unit(), unit()} * reach; }
  size_t below(size_t n) { return random_() % n; }

 private:
  std::mt19937_64 random_;
};

// Triangles of all sizes, slivers among them, in a box of `size` metres around a place; every tenth lies twice.
Scene soup(uint64_t seed, Vec3 around, float size, int triangles) {
  Scene s = doubleSided();
  Random random(seed);
  for (int i = 0; i < triangles; ++i) {
    const Vec3 a = around + random.any(size), u = random.any(size * std::exp2(-8 * std::abs(random.unit())));
    const Vec3 b = a + u, c = a + (i % 7 == 0 ? u * 0.5f + random.any(1e-5f * size) : random.any(length(u)));
    for (int copy = 0; copy < (i % 10 == 0 ? 2 : 1); ++copy) {
      const auto v = static_cast<uint32_t>(s.positions.size());
      s.positions.insert(s.positions.end(), {a, b, c});
      s.triangles.push_back({{v, v + 1, v + 2}, i % 3 == 0});
    }
  }
  return s;
}

// Squares of a lattice, as a voxel world's: rays through their corners and along their sides.
Scene lattice(int n) {
  Scene s = doubleSided();
  for (int x = 0; x < n; ++x)
    for (int y = 0; y < n; ++y) {
      const auto v = static_cast<uint32_t>(s.positions.size());
      const auto at = [&](int i, int k) { return Vec3{static_cast<float>(x + i), static_cast<float>((x * y) % 3), static_cast<float>(y + k)}; };
      s.positions.insert(s.positions.end(), {at(0, 0), at(0, 1), at(1, 1), at(1, 0)});
      s.triangles.push_back({{v, v + 1, v + 2}, 0});
      s.triangles.push_back({{v, v + 2, v + 3}, 0});
    }
  return s;
}

Corners cornersOf(const Scene& scene, size_t triangle) {
  const auto& v = scene.triangles[triangle].v;
  return {scene.positions[v[0]], scene.positions[v[1]], scene.positions[v[2]]};
}

void expectSame(const Scene& scene, const std::vector<Ray>& rays) {
  const std::vector<RayCaster> all = casters(scene);
  // One ray that is none, and a number that packets do not divide: neither tells on the others.
  std::vector<Ray> with_none = rays;
  with_none.push_back({rays[0].origin, Vec3{1, 1, 1} * std::numeric_limits<float>::quiet_NaN()});
  std::vector<std::vector<Hit>> together(all.size(), std::vector<Hit>(with_none.size()));
  std::vector<std::vector<SightLine>> lines(all.size());
  for (size_t c = 0; c < all.size(); ++c) {
    all[c].nearest(with_none, together[c]);
    for (const Ray& ray : with_none) lines[c].push_back({ray, kFar});
    all[c].occlude(lines[c]);
  }
  size_t hits = 0;
  for (size_t r = 0; r < rays.size(); ++r) {
    uint32_t triangle = kNone;
    double distance_m = 1e300;
    for (uint32_t t = 0; t < scene.triangles.size(); ++t)
      if (const auto met = meet(rays[r], cornersOf(scene, t), 0); met && met->distance_m < distance_m && !isHole(scene, t, met->b, met->c))
        triangle = t, distance_m = met->distance_m;
    hits += triangle != kNone;
    for (size_t c = 0; c < all.size(); ++c) {
      const Hit hit = all[c].nearest(rays[r]);
      ASSERT_EQ(hit.triangle, triangle) << "ray " << r << ", caster " << c << ", at " << distance_m << " m";
      ASSERT_EQ(all[c].occluded(rays[r], kFar), triangle != kNone) << "ray " << r << ", caster " << c;
      ASSERT_EQ(together[c][r].triangle, triangle) << "ray " << r << " of many, caster " << c << ", at " << distance_m << " m";
      ASSERT_EQ(together[c][r].front, hit.front);
      ASSERT_EQ(lines[c][r].occluded, triangle != kNone) << "ray " << r << " of many, caster " << c;
      if (triangle == kNone) continue;
      ASSERT_EQ(together[c][r].point, hit.point);
      ASSERT_EQ(hit.point, rays[r].origin + rays[r].direction * static_cast<float>(distance_m));
    }
  }
  EXPECT_GT(hits, rays.size() / 10);
  EXPECT_LT(hits, rays.size());
}

TEST(RayCaster, MeetsWhatTheTrianglesOneByOneDoOnEveryInstructionSet) {
  Random random(5);
  for (const auto& [around, size] : {std::pair(Vec3{0, 0, 0}, 1.0f), {Vec3{500, -20, 3}, 4.0f}, {Vec3{0, 1e5f, 0}, 30.0f}}) {
    const Scene scene = soup(7, around, size, 300);
    std::vector<Ray> rays;
    for (size_t i = 0; i < 6000; ++i) {
      const Corners to_triangle = cornersOf(scene, random.below(scene.triangles.size()));
      const auto& [a, b, c] = to_triangle;
      Vec3 from = around + random.any((i % 4 == 0 ? 100 : 2) * size), to = around + random.any(size);
      if (i % 5 == 1) to = a;
      if (i % 5 == 2) to = (a + b) * 0.5f;
      if (i % 5 == 3) from = a + (b - a) * (3 * random.unit()) + (c - a) * (3 * random.unit()), to = (a + b + c) * (1 / 3.0f);  // grazing
      if (i % 5 == 4) from = (a + b + c) * (1 / 3.0f);  // on the triangle, to rounding
      if (!(from == to)) rays.push_back({from, normalized(to - from)});
    }
    SCOPED_TRACE(size);
    expectSame(scene, rays);
  }
}

TEST(RayCaster, MeetsTheSameAlongTheLinesOfALattice) {
  Random random(6);
  std::vector<Ray> rays;
  for (int i = 0; i < 6000; ++i) {
    const auto any = [&](size_t n) { return static_cast<float>(random.below(2 * n)) / 2; };
    const Vec3 from{any(17), any(5) - 1, any(17)};
    const Vec3 ways[] = {{0, -1, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, -1}, normalized({1, 1, 0}), normalized({0, -1, 1}), normalized({-1, -1, -1})};
    rays.push_back({from, ways[random.below(std::size(ways))]});
  }
  expectSame(lattice(16), rays);
}

// Against the plane's equation in long double: distances of well shaped triangles are right to 1e-12 of what the ray went.
TEST(RayCaster, TrianglesAreMetToDoublePrecision) {
  const Scene scene = soup(9, {10, 20, -5}, 3, 200);
  Random random(8);
  using Long = std::array<long double, 3>;
  const auto longOf = [](Vec3 v) { return Long{v.x, v.y, v.z}; };
  const auto minus = [](Long a, Long b) { return Long{a[0] - b[0], a[1] - b[1], a[2] - b[2]}; };
  const auto dotOf = [](Long a, Long b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
  int checked = 0;
  for (int i = 0; i < 20000; ++i) {
    const Corners corners = cornersOf(scene, random.below(scene.triangles.size()));
    const Vec3 from = Vec3{10, 20, -5} + random.any(6), middle = (corners[0] + corners[1] + corners[2]) * (1 / 3.0f);
    const Vec3 d = normalized(middle + random.any(0.5f * length(corners[1] - corners[0])) - from);
    const auto met = meet({from, d}, corners, 0);
    if (!met) continue;
    const Long a = longOf(corners[0]), e = minus(longOf(corners[1]), a), f = minus(longOf(corners[2]), a);
    const Long n{e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]};
    const long double steep = dotOf(n, longOf(d)), area = std::sqrt(dotOf(n, n)), side = std::max(dotOf(e, e), dotOf(f, f));
    if (std::abs(steep) < 0.01L * area || area < 0.01L * side || side < 1e-4L) continue;
    const double t = static_cast<double>(dotOf(n, minus(a, longOf(from))) / steep);
    ASSERT_NEAR(met->distance_m, t, 1e-12 * (1 + t)) << i;
    const Vec3 by_weights = corners[0] * (1 - met->b - met->c) + corners[1] * met->b + corners[2] * met->c;
    ASSERT_LT(length(by_weights - (from + d * static_cast<float>(t))), 1e-4f);  // coordinates below 32 m, of 2^-24 of that
    ++checked;
  }
  EXPECT_GT(checked, 500);
}

TEST(RayCaster, NoRayLeavesAClosedBoxThroughItsSidesAndCorners) {
  for (const float size : {0.1f, 1.0f, 300.0f}) {
    Scene scene = closedBox({.5f, .5f, .5f}, {});
    for (Vec3& p : scene.positions) p = p * size + Vec3{3, 1, 2};
    Random random(4);
    const auto within = [&] { return 0.5f + 0.49f * random.unit(); };
    std::vector<Ray> rays;
    for (size_t i = 0; i < 20000; ++i) {
      const Vec3 from = Vec3{within(), within(), within()} * size + Vec3{3, 1, 2};
      const Corners to_triangle = cornersOf(scene, random.below(scene.triangles.size()));
      const float along = i % 5 == 0 ? 0 : within();
      rays.push_back({from, normalized(to_triangle[0] * (1 - along) + to_triangle[1 + i % 2] * along - from)});
    }
    for (const RayCaster& caster : casters(scene))
      for (size_t i = 0; i < rays.size(); ++i) ASSERT_NE(caster.nearest(rays[i]).triangle, kNone) << size << " " << i;
  }
}

TEST(RayCaster, DistancesAreLimitsAndOfEquallyNearTrianglesTheFirstIsMet) {
  Scene s = doubleSided();  // triangles at heights 0, 1, 1, 2
  for (const float y : {0.0f, 1.0f, 1.0f, 2.0f}) {
    const auto v = static_cast<uint32_t>(s.positions.size());
    s.positions.insert(s.positions.end(), {{0, y, 0}, {0, y, 4}, {4, y, 0}});
    s.triangles.push_back({{v, v + 1, v + 2}, 0});
  }
  for (const RayCaster& caster : casters(s)) {
    EXPECT_EQ(caster.nearest({{1, -1, 1}, {0, 1, 0}}).triangle, 0u);
    EXPECT_EQ(caster.nearest({{1, 0, 1}, {0, 1, 0}}).triangle, 1u) << "not what it starts on, and the lower number of two";
    EXPECT_EQ(caster.nearest({{1, 1.5f, 1}, {0, -1, 0}}).triangle, 1u);
    EXPECT_EQ(caster.nearest({{1, -1, 1}, {0, 1, 0}}, 1).triangle, 0u) << "the limit belongs to it";
    EXPECT_EQ(caster.nearest({{1, -1, 1}, {0, 1, 0}}, 0.999f).triangle, kNone);
    EXPECT_TRUE(caster.occluded({{1, 1, 1}, {0, 1, 0}}, 1));
    EXPECT_FALSE(caster.occluded({{1, 1, 1}, {0, 1, 0}}, 0.999f));
    // From far away, towards it and not.
    EXPECT_EQ(caster.nearest({{1, -1e6f, 1}, {0, 1, 0}}).triangle, 0u);
    EXPECT_FALSE(caster.occluded({{1, -1e6f, 1}, {0, 1, 0}}, 9e5f));
    EXPECT_EQ(caster.nearest({{1, -1e6f, 1}, {0, -1, 0}}).triangle, kNone);
    EXPECT_EQ(caster.nearest({{1, -1e6f, 1}, {1, 0, 0}}).triangle, kNone);
    std::vector<SightLine> lines = {{{{1, 1, 1}, {0, 1, 0}}, 1}, {{{1, 1, 1}, {0, 1, 0}}, 0.999f}, {{{1, -1e6f, 1}, {0, 1, 0}}, 9e5f}, {{{1, -1e6f, 1}, {0, 1, 0}}, kFar}};
    caster.occlude(lines);
    EXPECT_EQ((std::array{lines[0].occluded, lines[1].occluded, lines[2].occluded, lines[3].occluded}), (std::array{true, false, false, true}));
  }
  const Scene nothing;
  const auto caster = RayCaster::create(nothing);
  ASSERT_TRUE(caster);
  EXPECT_EQ(caster->nearest({{1, -1, 1}, {0, 1, 0}}).triangle, kNone);
}

// Trees come and go while rays are in others.
TEST(RayCaster, PartsWhoseTreesAreLetGoAreMetTheSameFromManyThreads) {
  const Scene scene = soup(11, {0, 0, 0}, 10, 4000);
  const auto whole = RayCaster::create(scene);
  ASSERT_TRUE(whole);
  Random random(12);
  std::vector<Ray> rays;
  for (int i = 0; i < 4000; ++i) rays.push_back({random.any(12), normalized(random.any(1))});
  std::vector<Hit> expected(rays.size());
  whole->nearest(rays, expected);
  for (const uint64_t tree_bytes : {uint64_t{1}, uint64_t{40000}}) {
    const auto in_parts = RayCaster::create(scene, tree_bytes);
    ASSERT_TRUE(in_parts);
    std::vector<std::vector<Hit>> found(4, std::vector<Hit>(rays.size()));
    std::vector<std::thread> threads;
    for (size_t t = 0; t < found.size(); ++t)
      threads.emplace_back([&, t] {
        const size_t half = rays.size() / 2;
        in_parts->nearest(std::span(rays).first(half), std::span(found[t]).first(half));
        for (size_t i = half; i < rays.size(); ++i) found[t][i] = in_parts->nearest(rays[i]);
      });
    for (std::thread& t : threads) t.join();
    for (const auto& hits : found)
      for (size_t i = 0; i < rays.size(); ++i) {
        ASSERT_EQ(hits[i].triangle, expected[i].triangle) << i;
        ASSERT_EQ(hits[i].point, expected[i].point) << i;
      }
  }
}

// Blocks in a file, of which a cache holds some 16,000, and slots that are taken from under other threads' eyes.
TEST(RayCaster, BlocksThatMemoryHasNoRoomForAreMetTheSameFromManyThreads) {
  const Scene scene = soup(13, {0, 0, 0}, 10, 200000);
  const auto whole = RayCaster::create(scene);
  ASSERT_TRUE(whole);
  const formats::TemporaryFolder folder;
  const uint64_t aside = pagedBytes().now;
  const Paging paging(folder.path(), uint64_t{64} << 30);
  const auto cached = RayCaster::create(scene, uint64_t{8} << 20);
  ASSERT_TRUE(cached);
  EXPECT_GT(pagedBytes().now - aside, scene.triangles.size() * 100);  // four triangles take 384 B
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
  std::vector<std::vector<Hit>> expected(4), found(4);
  std::vector<std::thread> threads;
  for (size_t t = 0; t < found.size(); ++t)
    threads.emplace_back([&, t] {
      Random random(14 + t);
      std::vector<Ray> rays;
      for (int i = 0; i < 3000; ++i) rays.push_back({random.any(12), normalized(random.any(1))});
      expected[t].resize(rays.size());
      found[t].resize(rays.size());
      whole->nearest(rays, expected[t]);
      cached->nearest(rays, found[t]);
    });
  for (std::thread& t : threads) t.join();
  for (size_t t = 0; t < found.size(); ++t)
    for (size_t i = 0; i < found[t].size(); ++i) {
      ASSERT_EQ(found[t][i].triangle, expected[t][i].triangle) << i;
      ASSERT_EQ(found[t][i].point, expected[t][i].point) << i;
    }
  std::vector<uint32_t> near_whole, near_cached;
  whole->near({1, 2, 3}, 2, near_whole);
  cached->near({1, 2, 3}, 2, near_cached);
  EXPECT_EQ(near_cached, near_whole);
}

TEST(RayCaster, NearIsWhatBoxesAre) {
  const Scene scene = soup(3, {2, 3, 4}, 5, 300);
  const std::vector<RayCaster> all = casters(scene);
  Random random(2);
  for (int i = 0; i < 500; ++i) {
    const Vec3 at = Vec3{2, 3, 4} + random.any(6);
    const float reach = i % 10 == 0 ? 0 : std::abs(random.unit()) * 2;
    std::vector<uint32_t> found, expected;
    for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
      Box box;
      for (const Vec3& p : cornersOf(scene, t)) box.add(p);
      if (box.distance(at) <= reach) expected.push_back(t);
    }
    for (const RayCaster& caster : all) {
      caster.near(at, reach, found);
      ASSERT_EQ(found, expected) << i;
    }
  }
}

}  // namespace
}  // namespace ff::bake::test
