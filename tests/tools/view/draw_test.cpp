// Sun and pictures on scenes whose answer is known; the validation layers must stay silent.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/tools/view/view_scenes.h"
#include "tools/view/renderer.h"

namespace ff::view {
namespace {

class Drawing : public testing::Test {
 protected:
  void SetUp() override {
    auto c = runtime::openVulkan({.device = "auto", .validate = true, .gpu_assisted = false});
    if (!c) GTEST_SKIP() << "no Vulkan device with validation layers, nothing was tested: " << c.error().line();
    context_ = *c;
    auto raster = SunRaster::create(*context_, 512);
    ASSERT_TRUE(raster) << raster.error().line();
    raster_ = std::move(*raster);
  }
  void TearDown() override {
    if (!context_) return;
    for (const std::string& message : runtime::validationMessages(*context_)) ADD_FAILURE() << message;
  }
  std::vector<float> exposure(const ViewScene& scene, Vec3 to_sun) {
    auto geometry = uploadGeometry(*context_, scene, weldScene(scene));
    EXPECT_TRUE(geometry);
    auto e = raster_.exposure(*geometry, scene, normalized(to_sun));
    EXPECT_TRUE(e);
    return e ? *e : std::vector<float>(scene.patches.size());
  }

  std::shared_ptr<runtime::VkContext> context_;  // first: outlives the raster
  SunRaster raster_;
};

// A patch covers 32 x 32 texels when it faces the sun; a row and a column more or less at its rim are 2/32.
constexpr float kTexelError = 2.0f / 32 + 1e-3f;

TEST_F(Drawing, SunFallsOnASheetWithTheCosine) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 8}, {8, 0, 0}, 8, 8);
  for (const Vec3 sun : {Vec3{0, 1, 0}, Vec3{1, 1, 0}, Vec3{0.3f, 0.5f, -0.6f}}) {
    const auto e = exposure(scene, sun);
    double mean = 0;
    for (const float x : e) {
      EXPECT_NEAR(x, normalized(sun).y, kTexelError);
      mean += static_cast<double>(x) / 64;
    }
    EXPECT_NEAR(mean, static_cast<double>(normalized(sun).y), static_cast<double>(kTexelError) / 8);  // the rims between patches cancel
  }
  for (const float x : exposure(scene, {0, -1, 0})) EXPECT_EQ(x, 0);  // its back
}

TEST_F(Drawing, SunIsBlockedByFrontsAndBacks) {
  for (const bool front : {true, false}) {
    ViewScene scene;
    addSheet(scene, {0, 0, 0}, {0, 0, 8}, {8, 0, 0}, 8, 8);
    const uint32_t roof = front ? addSheet(scene, {0, 3, 0}, {0, 0, 8}, {4, 0, 0}, 8, 4)   // faces up
                                : addSheet(scene, {0, 3, 0}, {4, 0, 0}, {0, 0, 8}, 4, 8);  // faces down
    const auto e = exposure(scene, {0, 1, 0});
    for (uint32_t p = 0; p < 64; ++p) {
      const bool shaded = scene.patches[p].centroid.x < 4;
      EXPECT_NEAR(e[p], shaded ? 0 : 1, kTexelError) << "patch " << p;
    }
    for (uint32_t p = roof; p < roof + 32; ++p) EXPECT_NEAR(e[p], front ? 1 : 0, kTexelError);
  }
}

TEST_F(Drawing, SunLightsOneSideOfASheetWithTwo) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 8}, {8, 0, 0}, 8, 8);
  addSheet(scene, {0, 0, 0}, {8, 0, 0}, {0, 0, 8}, 8, 8);  // the same place, facing down
  for (const Vec3 sun : {Vec3{0.4f, 1, 0.2f}, Vec3{0.4f, -1, 0.2f}}) {
    const auto e = exposure(scene, sun);
    const float cosine = std::abs(normalized(sun).y);
    for (uint32_t p = 0; p < 128; ++p) EXPECT_NEAR(e[p], (p < 64) == (sun.y > 0) ? cosine : 0, kTexelError);
  }
}

TEST_F(Drawing, SunTakesWorldsOfManyTiles) {
  ViewScene scene;
  addSheet(scene, {0, 0, 0}, {0, 0, 70}, {90, 0, 0}, 70, 90);  // 2240 x 2880 texels on tiles of 512
  const auto e = exposure(scene, {0.2f, 1, 0.1f});
  const float cosine = normalized({0.2f, 1, 0.1f}).y;
  for (const float x : e) EXPECT_NEAR(x, cosine, kTexelError);
}

struct Drawn {
  Rendered picture;
  runtime::Vec4 direct(uint32_t x, uint32_t y) const { return picture.direct[size_t{y} * picture.width + x]; }
  runtime::Vec4 bounced(uint32_t x, uint32_t y) const { return picture.bounced[size_t{y} * picture.width + x]; }
};

class Pictures : public Drawing {
 protected:
  Drawn draw(const ViewScene& scene, const View& view, const Sun& sun, const runtime::Sky& sky,
             const std::vector<shaders::vec4>& reflected) {
    const Weld weld = weldScene(scene);
    auto geometry = uploadGeometry(*context_, scene, weld);
    EXPECT_TRUE(geometry);
    auto renderer = Renderer::create(*context_, scene, weld, *geometry, sky, {160, 120});
    EXPECT_TRUE(renderer) << renderer.error().line();
    const std::vector<float> difference(scene.patches.size(), 0.25f);
    std::vector<float> lit(scene.patches.size());
    if (sun.shines()) lit = *raster_.exposure(*geometry, scene, sun.to_sun);
    auto drawn = renderer->render(raster_, *geometry, view, sun, {reflected, difference, lit});
    EXPECT_TRUE(drawn) << drawn.error().line();
    return {std::move(*drawn)};
  }
};

// Under a roof with a hole over the middle of a patch: what rounding at an edge may let through is no sunlight, an eighth of a metre is.
TEST_F(Pictures, LeaveOutSunlightOfAFewTexelsOfAPatch) {
  for (const float half_m : {1.1f / 32, 4.0f / 32}) {
    ViewScene scene;
    addSheet(scene, {0, 0, 0}, {0, 0, 8}, {8, 0, 0}, 8, 8);
    const float lo = 4.5f - half_m, hi = 4.5f + half_m;
    addSheet(scene, {0, 3, 0}, {0, 0, 8}, {lo, 0, 0}, 1, 1);
    addSheet(scene, {hi, 3, 0}, {0, 0, 8}, {8 - hi, 0, 0}, 1, 1);
    addSheet(scene, {lo, 3, 0}, {0, 0, lo}, {hi - lo, 0, 0}, 1, 1);
    addSheet(scene, {lo, 3, hi}, {0, 0, 8 - hi}, {hi - lo, 0, 0}, 1, 1);
    const Drawn d = draw(scene, {{4.5f, 1, 5.5f}, {4.5f, 0, 4.5f}, 0.1f}, {{0, 1, 0}, {8, 8, 8}}, {}, std::vector<shaders::vec4>(scene.patches.size()));
    EXPECT_EQ(d.direct(80, 60).x > 0, half_m > 0.1f) << half_m;
  }
}

TEST_F(Pictures, ShowEmissionAndAlbedoTimesIrradiance) {
  ViewScene scene;
  addSheet(scene, {-20, 0, -20}, {0, 0, 40}, {40, 0, 0}, 40, 40, {0.5f, 0.25f, 0.125f}, {3, 2, 1});
  for (formats::Node& n : scene.patches) n.sky_fraction = 1;
  scene.lamps.assign(scene.patches.size(), {8, 8, 8});
  const float sky_irradiance = 3.14159265f * 2;
  const Drawn d = draw(scene, {{0, 5, 0}, {0, 0, 0.1f}, 1}, {}, {{2, 2, 2}, {}},
                       std::vector<shaders::vec4>(scene.patches.size(), {8, 8, 8, 0}));
  for (const auto& [x, y] : {std::pair{80u, 60u}, {10u, 10u}, {150u, 110u}}) {
    EXPECT_NEAR(d.direct(x, y).x, 3 + 0.5f * (8 + sky_irradiance), 1e-3);
    EXPECT_NEAR(d.bounced(x, y).x, 3 + 0.5f * (16 + sky_irradiance), 1e-3);
    EXPECT_NEAR(d.bounced(x, y).y, 2 + 0.25f * (16 + sky_irradiance), 1e-3);
    EXPECT_EQ(d.bounced(x, y).w, 1);
    EXPECT_EQ(d.picture.difference[y * 160 + x], 0.25f);
  }
}

TEST_F(Pictures, ShowASharpShadowAndNoneOnItself) {
  ViewScene scene;
  addSheet(scene, {-20, 0, -20}, {0, 0, 40}, {40, 0, 0}, 40, 40, {1, 1, 1});
  addSheet(scene, {-2, 4, -2}, {0, 0, 4}, {4, 0, 0}, 4, 4, {1, 1, 1});  // faces up, unseen from below
  // From under the roof, straight down; half of the view's height is 3 * tan(0.5) = 1.64 m, of its width 2.19 m.
  for (const Vec3 to_sun : {Vec3{0, 1, 0}, normalized({1, 1, 0})}) {
    const Drawn d = draw(scene, {{0, 3, 0}, {0, 0, 0.001f}, 1}, {to_sun, {2, 2, 2}}, {},
                         std::vector<shaders::vec4>(scene.patches.size()));
    int lit = 0, dark = 0, between = 0;
    for (const runtime::Vec4& b : d.picture.bounced) {
      const float share = b.x / (2 * to_sun.y);
      lit += share > 0.98f;
      dark += share < 0.02f;
      between += share >= 0.02f && share <= 0.98f;
    }
    if (to_sun.x > 0.1f) {  // the shadow has moved by 4 m: all of this view is lit, but for a strip
      EXPECT_GT(lit, 160 * 120 * 9 / 10);
    } else {
      EXPECT_GT(dark, 160 * 120 * 87 / 100);  // 2 of 2.19 m, all of the height, less the soft edge
      EXPECT_GT(lit, 300);
    }
    // The filter is 3 texels of 80 m / 4096 wide, 2.1 pixels of 2.7 cm, on two edges of 120 pixels.
    EXPECT_LE(between, 2 * 120 * 3);
  }
}

// Two sheets that meet in a corner and face the eye, with sheets in the same place that face the sun: near the corner a point lies within
// the shadow map's bias of what shades it.
TEST_F(Pictures, ShowNoSunInTheCornerOfADarkRoom) {
  ViewScene scene;
  for (const bool out : {false, true}) {
    const Vec3 up{0, 4, 0}, x{4, 0, 0}, z{0, 0, 4};
    addSheet(scene, {-4, -2, 0}, out ? up : x, out ? x : up, 4, 4, {1, 1, 1});  // z = 0, inside faces +z
    addSheet(scene, {0, -2, 0}, out ? up : z, out ? z : up, 4, 4, {1, 1, 1});   // x = 0, inside faces -x
  }
  const Drawn d = draw(scene, {{-1, 0, 1}, {0, 0, 0}, 0.5f}, {normalized({0.51f, 0.5f, 0.38f}), {2, 2, 2}}, {},
                       std::vector<shaders::vec4>(scene.patches.size()));
  for (size_t i = 0; i < d.picture.direct.size(); ++i) EXPECT_EQ(d.picture.direct[i].x, 0) << "pixel " << i % 160 << ", " << i / 160;
}

TEST_F(Pictures, ShowTheSkyWhereThereIsNoSurface) {
  ViewScene scene;
  addSheet(scene, {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}, 2, 2);
  const runtime::Sky sky{{1, 1, 1}, {{0, 0.5f, 0}, {0, 0, 0}, {0, 0, 0}}, {{0, 0, 0, 2, 0}, {}, {}}};
  const Drawn d = draw(scene, {{0, 3, 0}, {0, 9, 0.001f}, 1}, {}, sky, std::vector<shaders::vec4>(scene.patches.size()));
  EXPECT_NEAR(d.direct(80, 60).x, 3.14159265f * 3.5f, 1e-2);  // straight up
  EXPECT_NEAR(d.direct(80, 60).y, 3.14159265f, 1e-3);
  EXPECT_EQ(d.direct(80, 60).w, 0);
  EXPECT_EQ(d.picture.difference[60 * 160 + 80], -1);
}

// Left half lit by 10, right half by 0: between the two rows of patches light must fall steadily, not in a step.
TEST_F(Pictures, InterpolateBetweenPatches) {
  ViewScene scene;
  addSheet(scene, {-8, 0, -8}, {0, 0, 16}, {16, 0, 0}, 16, 16, {1, 1, 1});
  std::vector<shaders::vec4> reflected;
  for (const formats::Node& n : scene.patches) reflected.push_back(n.centroid.x < 0 ? shaders::vec4{10, 10, 10, 0} : shaders::vec4{});
  const Drawn d = draw(scene, {{0, 6, 0}, {0, 0, 0.001f}, 1}, {}, {}, reflected);
  float largest_step = 0, lowest = 1e9f, highest = -1e9f;
  for (uint32_t x = 0; x + 1 < 160; ++x) {
    const float a = d.bounced(x, 60).x, b = d.bounced(x + 1, 60).x;
    largest_step = std::max(largest_step, std::abs(a - b));
    lowest = std::min(lowest, a);
    highest = std::max(highest, a);
  }
  EXPECT_NEAR(highest, 10, 1e-3);
  EXPECT_NEAR(lowest, 0, 1e-3);
  EXPECT_LT(largest_step, 1);  // a pixel is 0.05 cells wide
}

}  // namespace
}  // namespace ff::view
