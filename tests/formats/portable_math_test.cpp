// Against the C library's functions, which are right to a unit of 2^-53.
#include "formats/portable_math.h"

#include <gtest/gtest.h>

#include <limits>

namespace ff {
namespace {

constexpr double kUnit = std::numeric_limits<double>::epsilon();

TEST(PortableMath, SineAndCosineAreRightToAFewUnits) {
  for (int i = -100000; i <= 100000; ++i) {
    const double turns = i / 49999.0, radians = turns * 2 * std::numbers::pi;
    const auto [s, c] = sineCosineOfTurns(turns);
    // What is asked of the library is rounded to a unit of the angle, up to 13.
    ASSERT_NEAR(s, std::sin(radians), 16 * kUnit) << turns;
    ASSERT_NEAR(c, std::cos(radians), 16 * kUnit) << turns;
    const auto [sr, cr] = sineCosine(radians);
    ASSERT_NEAR(sr, std::sin(radians), 16 * kUnit) << radians;
    ASSERT_NEAR(cr, std::cos(radians), 16 * kUnit) << radians;
  }
  for (int i = 0; i < 1 << 16; ++i) {  // within a turn nothing but the functions errs
    const double turns = i * 0x1p-16, radians = turns * 2 * std::numbers::pi;
    ASSERT_NEAR(sineCosineOfTurns(turns).sine, std::sin(radians), 6 * kUnit) << turns;
  }
}

TEST(PortableMath, QuartersOfATurnAreExact) {
  const double sines[] = {0, 1, 0, -1};
  for (int i = -8; i <= 8; ++i) {
    const auto [s, c] = sineCosineOfTurns(i / 4.0);
    EXPECT_EQ(s, sines[(i + 8) % 4]) << i;
    EXPECT_EQ(c, sines[(i + 9) % 4]) << i;
  }
  EXPECT_EQ(sineCosine(std::numbers::pi / 2).cosine, 0);
}

TEST(PortableMath, ArcTangentIsRightToAFewUnitsInEveryQuadrant) {
  for (int i = 0; i < 100000; ++i) {
    const auto [y, x] = sineCosineOfTurns(i / 99999.0);
    for (const double size : {1e-9, 1.0, 3e7}) ASSERT_NEAR(arcTangent(size * y, size * x), std::atan2(size * y, size * x), 4 * kUnit) << i;
  }
  for (const double y : {-2.0, 0.0, 2.0})
    for (const double x : {-2.0, 0.0, 2.0}) EXPECT_DOUBLE_EQ(arcTangent(y, x), std::atan2(y, x)) << y << " " << x;
  for (double q = 1; q > 1e-300; q /= 3) ASSERT_DOUBLE_EQ(arcTangent(q, 1), std::atan(q)) << q;
}

TEST(PortableMath, SrgbIsTheNearestFloat) {
  for (unsigned i = 0; i < 256; ++i) {
    const double v = i / 255.0;
    EXPECT_EQ(srgbToLinear(i), static_cast<float>(v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4))) << i;
  }
}

// The very bits, which change with no processor, compiler or C library.
TEST(PortableMath, BitsAreAlwaysThese) {
  const struct {
    double turns, sine, cosine;
  } turned[] = {{0x1.999999999999ap-4, 0x1.2cf2304755a5ep-1, 0x1.9e3779b97f4a8p-1},
                {0x1.5555555555555p-2, 0x1.bb67ae8584cabp-1, -0x1.ffffffffffffdp-2},
                {-0x1.7333333333333p+1, 0x1.2cf2304755a62p-1, 0x1.9e3779b97f4a5p-1}};
  for (const auto& t : turned) {
    EXPECT_EQ(sineCosineOfTurns(t.turns).sine, t.sine);
    EXPECT_EQ(sineCosineOfTurns(t.turns).cosine, t.cosine);
  }
  EXPECT_EQ(sineCosine(2).sine, 0x1.d18f6ead1b446p-1);
  EXPECT_EQ(sineCosine(-100).cosine, 0x1.b981dbf665fd8p-1);
  EXPECT_EQ(arcTangent(1, 3), 0x1.4978fa3269ee1p-2);
  EXPECT_EQ(arcTangent(-2, 0x1.6666666666666p-1), -0x1.3bef63199bba3p+0);
  EXPECT_EQ(arcTangent(-0x1.12e0be826d695p-30, -4), -0x1.921fb543b9612p+1);
  EXPECT_EQ(srgbToLinear(11), 0x1.b6a31cp-9f);
  EXPECT_EQ(srgbToLinear(200), 0x1.27b8ap-1f);
}

}  // namespace
}  // namespace ff
