#include "tools/view/picture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

namespace ff::view {
namespace {

using runtime::Vec4;

std::vector<Vec4> grey(std::initializer_list<float> values) {
  std::vector<Vec4> out;
  for (const float v : values) out.push_back({v, v, v, 1});
  return out;
}

TEST(Picture, ExposesTheMeanToMiddleGreyWhateverTheUnit) {
  for (const float unit : {1e-3f, 1.0f, 1e4f}) {
    std::vector<Vec4> pixels(1000, Vec4{0.5f * unit, 0.5f * unit, 0.5f * unit, 1});
    EXPECT_NEAR(std::exp2(exposureStops(pixels)) * 0.5f * unit, 0.18f, 1e-4);
    pixels.insert(pixels.end(), 4000, Vec4{1e6f * unit, 0, 0, 0});  // sky does not count
    EXPECT_NEAR(std::exp2(exposureStops(pixels)) * 0.5f * unit, 0.18f, 1e-4);
    pixels.insert(pixels.end(), 20, Vec4{1e6f * unit, 1e6f * unit, 1e6f * unit, 1});  // nor do a few lamps
    EXPECT_NEAR(std::exp2(exposureStops(pixels)) * 0.5f * unit, 0.18f, 1e-4);
  }
  EXPECT_EQ(exposureStops(grey({0, 0, 0})), 0);
}

TEST(Picture, DoesNotBurnMoreThanATenthOfTheSurfaces) {
  std::vector<Vec4> pixels(800, Vec4{0.01f, 0.01f, 0.01f, 1});
  pixels.insert(pixels.end(), 200, Vec4{2, 2, 2, 1});
  EXPECT_NEAR(std::exp2(exposureStops(pixels)) * 2, 0.9f, 1e-3);
}

TEST(Picture, ToneCurveRisesFromBlackToWhite) {
  int last = -1;
  for (float x = 0; x < 20; x = x * 1.3f + 0.001f) {
    const Picture p = toneMapped(grey({x, x, x, x}), 1, 1, 2, 1);
    EXPECT_GE(p.rgb[0] + 1, last);  // the dither is at most half a step
    last = p.rgb[0];
  }
  EXPECT_EQ(toneMapped(grey({0}), 1, 1, 1, 1).rgb[1], 0);
  EXPECT_GE(toneMapped(grey({1e5f}), 1, 1, 1, 1).rgb[1], 254);
  const int middle = toneMapped(grey({0.18f}), 1, 1, 1, 1).rgb[1];
  EXPECT_GT(middle, 90);
  EXPECT_LT(middle, 150);
}

TEST(Picture, SurvivesRadiosityThatIsNotANumber) {
  const float nan = std::nanf("");
  EXPECT_EQ(toneMapped(grey({nan}), 1, 1, 1, 1).rgb[0], 0);
}

TEST(Picture, HeatMapTellsSkyFromSmallAndLargeDifferences) {
  const uint32_t w = 200, h = 100;
  std::vector<float> difference(w * h, 0.0f);
  for (uint32_t y = 0; y < h; ++y)
    for (uint32_t x = 0; x < w; ++x) difference[y * w + x] = x < 60 ? -1.0f : x < 120 ? 0.0f : 0.2f;
  const Picture p = heatMap(difference, w, h, 1, 0.1f, "title");
  const auto sum = [&](uint32_t x) { return p.rgb[3 * (5 * w + x)] + p.rgb[3 * (5 * w + x) + 1] + p.rgb[3 * (5 * w + x) + 2]; };
  EXPECT_LT(sum(90), sum(30));
  EXPECT_LT(sum(30), sum(150));
}

TEST(Picture, WritesPngAndSaysWhyItCannot) {
  const Picture p = toneMapped(grey({0.1f, 0.2f, 0.3f, 0.4f}), 2, 2, 1, 1);
  const std::string path = testing::TempDir() + "/picture.png";
  ASSERT_TRUE(writePng(p, path));
  std::ifstream in(path, std::ios::binary);
  char head[8] = {};
  in.read(head, 8);
  EXPECT_EQ(std::string(head, 8), "\x89PNG\r\n\x1a\n");
  const auto failed = writePng(p, "/nonexistent/picture.png");
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace ff::view
