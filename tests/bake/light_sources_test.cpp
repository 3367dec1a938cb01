// What patches get of lamps and of the sky, against closed forms and against many more rays.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/analytic_scenes.h"

namespace ff::bake::test {
namespace {

// A floor of 8 x 8 m and a square lamp above its middle, facing down. edge_m: of the lamp.
Scene floorAndLamp(float edge_m, float height_m, float radiance) {
  Scene s;
  const uint32_t floor = addMaterial(s, {0, 0, 0}), lamp = addMaterial(s, {0, 0, 0}, {radiance, radiance / 2, 0});
  addQuad(s, {-4, 0, -4}, {-4, 0, 4}, {4, 0, 4}, {4, 0, -4}, floor);
  const float e = edge_m / 2;
  addQuad(s, {-e, height_m, -e}, {e, height_m, -e}, {e, height_m, e}, {-e, height_m, e}, lamp);
  return s;
}

// Irradiance of a patch of the floor from a lamp small beside its distance: L A cos cos / r^2 over the patch, by the midpoint
// rule at 16 x 16 points.
double expectedOf(const Patch& p, double area_m2, double height_m, double radiance) {
  double sum = 0;
  constexpr int kSide = 16;
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j) {
      const double x = static_cast<double>(p.bounds.lo.x) + (i + 0.5) / kSide * static_cast<double>(p.bounds.hi.x - p.bounds.lo.x);
      const double z = static_cast<double>(p.bounds.lo.z) + (j + 0.5) / kSide * static_cast<double>(p.bounds.hi.z - p.bounds.lo.z);
      const double r2 = x * x + height_m * height_m + z * z;
      sum += radiance * area_m2 * height_m * height_m / (r2 * r2);
    }
  return sum / (kSide * kSide);
}

double lampLight(const CastScene& c, uint32_t patch, size_t channel = 0) {
  double sum = 0;
  for (const LampIrradiance& l : c.rows.lamps[patch]) sum += l.rgb[channel];
  return sum;
}

TEST(LampLight, IsThatOfTheClosedFormHoweverSmallTheLamp) {
  for (const float edge : {0.2f, 0.02f, 0.002f}) {
    const CastScene c = cast(floorAndLamp(edge, 3, 1000), 1, 1024);
    uint32_t floors = 0;
    for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
      if (materialOf(c, i) != 0) continue;
      ++floors;
      const double expected = expectedOf(c.set.patches[i], static_cast<double>(edge) * static_cast<double>(edge), 3, 1000);
      // The light varies by a tenth over a patch (standard deviation); 64 rays leave an eighth of that even if they were not stratified.
      EXPECT_NEAR(lampLight(c, i, 0), expected, 0.02 * expected) << edge;
      EXPECT_NEAR(lampLight(c, i, 1), expected / 2, 0.01 * expected) << edge;
      EXPECT_EQ(lampLight(c, i, 2), 0);
    }
    EXPECT_EQ(floors, 64u);
  }
}

TEST(LampLight, DoesNotPassWhatStandsInItsWay) {
  Scene s = floorAndLamp(0.1f, 3, 1000);
  Material board;
  board.double_sided = true;
  board.metallic = 0;
  s.materials.push_back(board);
  addQuad(s, {-4, 1, 0}, {4, 1, 0}, {4, 1, 4}, {-4, 1, 4}, 2);  // over half of the floor, below the lamp
  const CastScene c = cast(std::move(s), 1, 1024);
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
    if (materialOf(c, i) != 0) continue;
    const Patch& p = c.set.patches[i];
    const double expected = expectedOf(p, 0.01, 3, 1000);
    if (p.centroid.z < 0) {
      EXPECT_NEAR(lampLight(c, i), expected, 0.02 * expected);
    } else if (p.centroid.z > 1) {
      EXPECT_EQ(lampLight(c, i), 0);
    }
  }
}

TEST(LampLight, OfAClosedBoxThatEmitsAlikeIsItsEmission) {
  // Every point sees the box alone: its irradiance is the radiosity, 2 pi. Both kinds of rays meet emitters, next to the corners
  // at no distance: only their right weights together give 1. 1024 rays a patch, of which some thousandth of noise is left.
  const CastScene c = cast(closedBox({0, 0, 0}, {2, 2, 2}), 0.25f, 1024);
  double sum = 0;
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
    EXPECT_NEAR(lampLight(c, i), 2 * std::numbers::pi, 0.02 * 2 * std::numbers::pi);
    sum += lampLight(c, i);
  }
  EXPECT_NEAR(sum / static_cast<double>(c.set.patches.size()), 2 * std::numbers::pi, 0.002 * 2 * std::numbers::pi);
}

TEST(LampLight, IsUnbiasedAtFewRaysBesideALargeLamp) {
  // Unit squares at a right angle: the mean form factor is 0.20004 (Howell. A catalog of radiation heat transfer configuration
  // factors, C-14). 32 rays a patch, 400 seeds: the mean's own error is measured, and four of them are allowed.
  Scene s = perpendicularSquares();
  s.materials[1].emission = {1, 1, 1};
  double sum = 0, square = 0;
  constexpr int kSeeds = 400;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    const CastScene c = cast(s, 1, 32, static_cast<uint64_t>(seed));
    for (uint32_t i = 0; i < c.set.patches.size(); ++i)
      if (materialOf(c, i) == 0) {
        const double f = lampLight(c, i) / std::numbers::pi;
        sum += f;
        square += f * f;
      }
  }
  const double mean = sum / kSeeds, error = std::sqrt((square / kSeeds - mean * mean) / kSeeds);
  EXPECT_LT(error, 0.004);
  EXPECT_NEAR(mean, 0.20004, 4 * error);
}

TEST(LampLight, GroupsAreMaterialsOrNames) {
  Scene s;
  for (const char* name : {"bulb", "neon", "bulb", "", "dark"}) {
    addMaterial(s, {0, 0, 0}, std::string(name) == "dark" ? Vec3{} : Vec3{1, 1, 1});
    s.materials.back().name = name;
  }
  s.materials[1].lamp_group = "sign";
  const LampGroups groups = groupLamps(s);
  EXPECT_EQ(groups.name, (std::vector<std::string>{"bulb", "sign", "material 3"}));
  EXPECT_EQ(groups.of_material, (std::vector<uint16_t>{0, 1, 0, 2, formats::kNoLampGroup}));
}

// A dark room of 4 x 3 x 4 m with a square window in its wall at x = 4, seen from inside.
Scene roomWithWindow(float edge_m) {
  Scene s;
  const uint32_t m = addMaterial(s, {0, 0, 0});
  addQuad(s, {0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, m);
  addQuad(s, {0, 3, 0}, {4, 3, 0}, {4, 3, 4}, {0, 3, 4}, m);
  addQuad(s, {0, 0, 0}, {0, 3, 0}, {0, 3, 4}, {0, 0, 4}, m);
  addQuad(s, {0, 0, 0}, {4, 0, 0}, {4, 3, 0}, {0, 3, 0}, m);
  addQuad(s, {0, 0, 4}, {0, 3, 4}, {4, 3, 4}, {4, 0, 4}, m);
  const float lo = 2 - edge_m / 2, hi = 2 + edge_m / 2;
  addQuad(s, {4, 0, 0}, {4, 0, 4}, {4, 1, 4}, {4, 1, 0}, m);
  addQuad(s, {4, 1 + edge_m, 0}, {4, 1 + edge_m, 4}, {4, 3, 4}, {4, 3, 0}, m);
  addQuad(s, {4, 1, 0}, {4, 1, lo}, {4, 1 + edge_m, lo}, {4, 1 + edge_m, 0}, m);
  addQuad(s, {4, 1, hi}, {4, 1, 4}, {4, 1 + edge_m, 4}, {4, 1 + edge_m, hi}, m);
  return s;
}

TEST(SkyLight, ThroughASmallWindowIsFoundAndUnbiased) {
  // Against 65,535 rays a patch. 1024 rays a patch alone meet a window of half a metre some 3 times; with the guided ones the error
  // is half at most. Over 12 seeds the mean is right within four of its own errors and those of the truth, patch by patch
  // (but for one in 50: errors are estimated, too), and in all.
  const Scene s = roomWithWindow(0.5f);
  const CastScene truth = cast(s, 0.5f, 65535, 99);
  const size_t n = truth.set.patches.size();
  std::vector<double> sum(n), square(n), plain_square(n), want(n);
  constexpr int kSeeds = 12;
  constexpr uint32_t kRays = 1024;
  for (size_t i = 0; i < n; ++i) want[i] = truth.rows.sky[i] / 65535.0;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    const CastScene c = cast(s, 0.5f, kRays, static_cast<uint64_t>(seed));
    for (size_t i = 0; i < n; ++i) {
      const auto f = static_cast<double>(c.rows.sky_fraction[i]);
      sum[i] += f;
      square[i] += (f - want[i]) * (f - want[i]);
      plain_square[i] += std::pow(c.rows.sky[i] / static_cast<double>(kRays) - want[i], 2);
    }
  }
  double guided = 0, plain = 0, total = 0, wanted = 0;
  size_t seen = 0, off = 0;
  for (size_t i = 0; i < n; ++i) {
    guided += square[i];
    plain += plain_square[i];
    total += sum[i] / kSeeds;
    wanted += want[i];
    if (!(want[i] > 0)) continue;
    ++seen;
    const double error = std::sqrt(square[i] / kSeeds / kSeeds) + std::sqrt(want[i] / 65535);
    off += std::abs(sum[i] / kSeeds - want[i]) > 4 * error;
  }
  EXPECT_GT(seen, 250u);
  EXPECT_LE(off, seen / 50);
  EXPECT_NEAR(total, wanted, 0.01 * wanted);
  EXPECT_LT(std::sqrt(guided), 0.5 * std::sqrt(plain)) << std::sqrt(guided / plain);
}

TEST(SkyLight, TheGuidesDensityIsThatOfItsDirections) {
  // Directions drawn from a guide: the mean of 1 / density over them is the solid angle it covers, and is so for each octant.
  SkyGuide guide;
  for (const Vec3 d : {Vec3{0.1f, 0.9f, 0.3f}, Vec3{-0.7f, 0.4f, -0.6f}, Vec3{0.5f, 0.1f, -0.8f}}) guide.add(normalized(d), 0.1f);
  guide.close({0, 1, 0});
  ASSERT_FALSE(guide.empty());
  for (int k = 0; k < 4000; ++k)  // on the very border of a bin rounding may not put them where the density is 0
    for (const float u : {0.0f, 0x1.fffffep-1f})
      for (const float v : {0.0f, 0x1.fffffep-1f}) ASSERT_GT(guide.density(guide.direction((k + 0.5) / 4000, u, v)), 0);
  double covered = 0, grid = 0;
  constexpr int kDraws = 40000;
  for (int k = 0; k < kDraws; ++k) {
    const Vec3 d = guide.direction((k + 0.5) / kDraws, static_cast<float>(unitOf(2 * static_cast<uint64_t>(k))), static_cast<float>(unitOf(2 * static_cast<uint64_t>(k) + 1)));
    ASSERT_GT(guide.density(d), 0);
    covered += 1 / guide.density(d) / kDraws;
  }
  constexpr int kSide = 1000;  // of a grid of directions of equal solid angle
  double whole = 0;
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j) {
      const double y = 2 * (i + 0.5) / kSide - 1, phi = 2 * std::numbers::pi * (j + 0.5) / kSide, r = std::sqrt(1 - y * y);
      const double p = guide.density({static_cast<float>(r * std::cos(phi)), static_cast<float>(y), static_cast<float>(r * std::sin(phi))});
      grid += p > 0 ? 4 * std::numbers::pi / kSide / kSide : 0;
      whole += p * 4 * std::numbers::pi / kSide / kSide;
    }
  EXPECT_NEAR(whole, 1, 0.01);
  EXPECT_NEAR(covered, grid, 0.02 * grid);
}

}  // namespace
}  // namespace ff::bake::test
