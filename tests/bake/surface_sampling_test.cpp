// What a material is like over a piece, against closed forms: vertex colours, emissive pictures, surfaces that let light pass.
#include "bake/rays/surface_sampling.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "bake/rays/sobol.h"
#include "tests/support/analytic_scenes.h"

namespace ff::bake {
namespace {

using test::addMaterial;
using test::addQuad;

// The square 0..1 in the plane z = 0, by a map into the world.
template <class Map>
Scene square(const Map& map) {
  Scene s;
  addMaterial(s, {0.8f, 0.8f, 0.8f});
  addQuad(s, map(Vec3{0, 0, 0}), map(Vec3{1, 0, 0}), map(Vec3{1, 1, 0}), map(Vec3{0, 1, 0}), 0);
  s.uv0 = s.uv1 = {{0, 0}, {1, 0}, {1, 1}, {0, 0}, {1, 1}, {0, 1}};
  return s;
}
Scene square() { return square([](Vec3 p) { return p; }); }

// Turned, scaled and mirrored (which swaps the corners, as the importer does).
std::vector<Scene> variants() {
  std::vector<Scene> all;
  for (const float scale : {0.01f, 1.0f, 300.0f})
    for (const bool turned : {false, true})
      all.push_back(square([=](Vec3 p) { return (turned ? Vec3{p.y * 0.6f, p.x, -p.y * 0.8f} : p) * scale + Vec3{scale, 0, 7}; }));
  Scene mirrored = square([](Vec3 p) { return Vec3{-p.x, p.y, p.z}; });
  for (Triangle& t : mirrored.triangles) std::swap(t.v[1], t.v[2]);
  all.push_back(mirrored);
  return all;
}

SurfaceMean meanOf(const Scene& s, double* solid_m2 = nullptr) {
  SurfaceMean mean(1);
  for (uint32_t t = 0; t < s.triangles.size(); ++t) {
    const auto& v = s.triangles[t].v;
    const float area = triangleArea(s, t);
    const float share = mean.add(s, t, s.positions[v[0]], s.positions[v[1]], s.positions[v[2]], area);
    if (solid_m2) *solid_m2 += static_cast<double>(area * share);
  }
  return mean;
}

TEST(SurfaceMean, OfVertexColoursIsExact) {
  for (Scene s : variants()) {
    // Red rises with x; green is one corner's of the square: a sixth of it in the mean over two triangles, each a third.
    s.colors = {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 0, 1}, {1, 1, 1}, {0, 0, 1}};
    const Vec3 albedo = meanOf(s).albedo();
    EXPECT_NEAR(albedo.x, 0.8f * 0.5f, 1e-4f);
    EXPECT_NEAR(albedo.y, 0.8f / 3, 1e-4f);
    EXPECT_NEAR(albedo.z, 0.8f, 1e-4f);
    // A quarter of the first triangle, near corner 1: red is linear, its mean that of the quarter's corners.
    SurfaceMean part(1);
    const Vec3 a = s.positions[s.triangles[0].v[0]], b = s.positions[s.triangles[0].v[1]], c = s.positions[s.triangles[0].v[2]];
    part.add(s, 0, (a + b) / 2.0f, b, (b + c) / 2.0f, triangleArea(s, 0) / 4);
    const auto red = [&](uint32_t k) { return s.colors[s.triangles[0].v[k]].r; };
    EXPECT_NEAR(part.albedo().x, 0.8f * ((red(0) + red(1)) / 2 + red(1) + (red(1) + red(2)) / 2) / 3, 1e-4f);
  }
}

TEST(SurfaceMean, VertexColoursMultiplyThePicture) {
  Scene s = square();
  s.images.push_back({2, 1, {255, 255, 255, 255, 0, 0, 0, 255}});  // white where x < 1/2
  s.materials[0].base_image = 0;
  s.colors = {{0, 1, 1}, {1, 1, 1}, {1, 1, 1}, {0, 1, 1}, {1, 1, 1}, {0, 1, 1}};  // red = x
  // 0.8 times the integral of x from 0 to 1/2; two triangles of at least 4 points each: a point's worth of error.
  for (uint32_t size = 64; size <= 256; size *= 4) {
    Image& image = s.images[0];
    image.width = image.height = size;
    image.rgba.clear();
    for (uint32_t i = 0; i < size * size; ++i)
      for (int c = 0; c < 4; ++c) image.rgba.push_back(c == 3 || i % size < size / 2 ? 255 : 0);
    EXPECT_NEAR(meanOf(s).albedo().x, 0.8f / 8, 0.01f);
    EXPECT_NEAR(meanOf(s).albedo().y, 0.8f / 2, 0.02f);
  }
}

// Two texels: pieces whose sides lie on the border between them, or on the picture's, are of one colour, and of a piece across it no more
// points are on the wrong side than fit along the border: of 16 and of 64 well spread ones one in eight, one in twenty.
TEST(SurfaceMean, OfACoarsePictureIsThatOfTheTexelsThatAPieceLiesIn) {
  for (Scene s : variants()) {
    s.images.push_back({2, 1, {255, 255, 255, 255, 0, 0, 0, 255}});  // white where x < 1/2
    s.materials[0].base_image = s.materials[0].emission_image = 0;
    s.materials[0].emission = {1, 1, 1};
    const Vec3 o = s.positions[0], x = s.positions[1] - o, y = s.positions[5] - o;
    const uint32_t t = 0;
    const auto means = [&](float from, float to) {
      SurfaceMean mean(1);
      mean.add(s, t, o + x * from + y * 0.1f, o + x * to + y * 0.1f, o + x * to + y * (to - 0.05f), 1);
      return mean;
    };
    EXPECT_FLOAT_EQ(means(0.25f, 0.5f).albedo().x, 0.8f);
    EXPECT_FLOAT_EQ(means(0.25f, 0.5f).emission().x, std::numbers::pi_v<float>);
    EXPECT_EQ(means(0.6f, 1).albedo().x, 0);
    EXPECT_EQ(means(0.6f, 1).emission().x, 0);
    EXPECT_NEAR(meanOf(s).albedo().x, 0.8f / 2, 0.8f / 8);
    EXPECT_NEAR(meanOf(s).emission().x, std::numbers::pi / 2, std::numbers::pi / 20);
  }
}

// A lamp of 16 x 16 texels in a black picture of 512 x 512: the mean radiance is 1/1024 of the lamp's. About 256 of the
// points meet it, on a border of 64: R2 puts fewer than one of three of them on the wrong side.
TEST(SurfaceMean, FindsASmallLampInAPicture) {
  for (Scene s : variants()) {
    Image image{512, 512, std::vector<uint8_t>(512 * 512 * 4, 0)};
    for (size_t i = 0; i < image.rgba.size() / 4; ++i) {
      const bool lit = i % 512 / 16 == 20 && i / 512 / 16 == 9;
      for (size_t c = 0; c < 4; ++c) image.rgba[4 * i + c] = lit || c == 3 ? 255 : 0;
    }
    s.images.push_back(image);
    s.materials[0].emission_image = 0;
    s.materials[0].emission = {1024, 0, 2048};
    const Vec3 m = meanOf(s).emission();
    EXPECT_NEAR(m.x, std::numbers::pi, 0.08 * std::numbers::pi);
    EXPECT_EQ(m.y, 0.0f);
    EXPECT_NEAR(m.z, 2 * m.x, 1e-3f);
  }
}

TEST(SurfaceMean, LargerPictureDecidesHowManyPointsThereAre) {
  Scene s = square();
  Image small{1, 1, {255, 255, 255, 255}}, fine{256, 256, {}};
  for (int i = 0; i < 256 * 256; ++i)
    for (int c = 0; c < 4; ++c) fine.rgba.push_back(c == 3 || i % 256 == 17 ? 255 : 0);  // one bright column
  s.images = {small, fine};
  s.materials[0].base_image = 0;
  s.materials[0].emission_image = 1;
  s.materials[0].emission = {256, 0, 0};
  EXPECT_NEAR(meanOf(s).emission().x, std::numbers::pi, 0.05 * std::numbers::pi);
}

// Light that a surface lets pass, against what it stops: as large a share of the area, and of the rays.
TEST(SurfaceSampling, TheRightShareOfLightPasses) {
  struct Case {
    const char* what;
    float alpha, transmission;
    bool blend;
    float vertex_alpha;  // at the corners where x = 1; 1 at the others
    double stops;
  };
  for (const Case& c : {Case{"opaque", 1, 0, false, 1, 1}, Case{"blend", 0.3f, 0, true, 1, 0.3}, Case{"glass", 1, 0.75f, false, 1, 0.25},
                        Case{"tinted blend", 0.5f, 0.5f, true, 1, 0.25}, Case{"fading", 1, 0, true, 0, 0.5}})
    for (Scene s : variants()) {
      SCOPED_TRACE(c.what);
      Material& m = s.materials[0];
      m.cutout = true;
      m.alpha = c.alpha;
      m.transmission = c.transmission;
      m.blend = c.blend;
      m.alpha_cutoff = 0.5f;
      if (c.vertex_alpha < 1) {
        const float a = c.vertex_alpha;
        s.colors = {{1, 1, 1, 1}, {1, 1, 1, a}, {1, 1, 1, a}, {1, 1, 1, 1}, {1, 1, 1, a}, {1, 1, 1, 1}};
      }
      double solid = 0, area = 0;
      const Vec3 albedo = meanOf(s, &solid).albedo();
      for (uint32_t t = 0; t < 2; ++t) area += static_cast<double>(triangleArea(s, t));
      EXPECT_NEAR(solid / area, c.stops, 0.01);
      EXPECT_NEAR(albedo.x, 0.8f, 1e-4f) << "of what is solid";
      const auto caster = RayCaster::create(s);
      ASSERT_TRUE(caster);
      const Vec3 p = s.positions[0], e1 = s.positions[1] - p, e2 = s.positions[5] - p, n = cross(e1, e2) / length(e1);
      int hits = 0;
      constexpr int kRays = 20000;
      for (int i = 0; i < kRays; ++i) {
        const float u = static_cast<float>(mix64(2 * static_cast<uint64_t>(i)) >> 40) * 0x1p-24f;
        const float v = static_cast<float>(mix64(2 * static_cast<uint64_t>(i) + 1) >> 40) * 0x1p-24f;
        const float side = i % 2 ? 1.0f : -1.0f;
        const Vec3 at = p + e1 * (0.001f + 0.998f * u) + e2 * (0.001f + 0.998f * v);
        hits += caster->nearest({at + n * side, normalized(n) * -side}).triangle != kNone;
      }
      // Four standard deviations of a binomial share.
      EXPECT_NEAR(static_cast<double>(hits) / kRays, c.stops, 4 * std::sqrt(c.stops * (1 - c.stops) / kRays) + 1e-9);
    }
}

TEST(SurfaceSampling, PanesAreSeenThroughAndLeavesAreNot) {
  Material m;
  m.cutout = true;
  m.alpha = 0.2f;
  EXPECT_FALSE(isSeenThrough(m)) << "a mask's alpha is not a share";
  m.blend = true;
  EXPECT_TRUE(isSeenThrough(m));
  m.alpha = 1;
  EXPECT_FALSE(isSeenThrough(m));
  m.transmission = 0.6f;
  EXPECT_TRUE(isSeenThrough(m));
}

}  // namespace
}  // namespace ff::bake
