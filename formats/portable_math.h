// Functions that give the same bits on every processor. Those of the C library do not: glibc picks variants with and without fused
// operations at run time. Here are plain IEEE operations alone (our code is built with -ffp-contract=off); std::sqrt, floor, fmod, ldexp,
// frexp and ilogb are exact and stay. Errors are a few units of 2^-53, of the result or of 1.
#pragma once
#include <cmath>
#include <cstdint>
#include <numbers>

namespace ff {

struct SineCosine {
  double sine, cosine;
};

// Of x radians and so many quarters of a turn; |x| <= pi / 4. Without a branch, so that loops of it become vector instructions.
[[gnu::always_inline]] inline SineCosine sineCosineBeyond(int quarters, double x) {
  const double x2 = x * x;
  double s = 0, c = 0;
  for (int n = 16; n > 0; n -= 2) {  // Taylor's series of both; pi / 4 ^ 18 / 18! < 2^-58
    s = (1 - s) * x2 * (1.0 / (n * (n + 1)));
    c = (1 - c) * x2 * (1.0 / (n * (n - 1)));
  }
  s = (1 - s) * x;
  c = 1 - c;
  const double sine = quarters & 1 ? c : s, cosine = quarters & 1 ? s : c;
  return {quarters & 2 ? -sine : sine, (quarters + 1) & 2 ? -cosine : cosine};
}

// Of an angle in turns: 1 is 360 degrees. Exact at multiples of a quarter.
inline SineCosine sineCosineOfTurns(double turns) {
  if (!(std::abs(turns) < 0x1p60)) turns = 0;  // whole turns, or no number
  const auto quarters = static_cast<int64_t>(4 * turns + std::copysign(0.5, turns));
  return sineCosineBeyond(static_cast<int>(quarters & 3), (turns - static_cast<double>(quarters) / 4) * (2 * std::numbers::pi));
}

// The same of turns in [0, 1].
[[gnu::always_inline]] inline SineCosine sineCosineOfTurn(double turns) {
  const auto quarters = static_cast<int>(4 * turns + 0.5);
  return sineCosineBeyond(quarters, (turns - quarters / 4.0) * (2 * std::numbers::pi));
}

inline SineCosine sineCosine(double radians) { return sineCosineOfTurns(radians / (2 * std::numbers::pi)); }

// As std::atan2, but 0 where both are 0, and for finite values only.
inline double arcTangent(double y, double x) {
  const double least = std::fmin(std::abs(x), std::abs(y)), most = std::fmax(std::abs(x), std::abs(y));
  if (!(most > 0)) return 0;
  double q = least / most;
  for (int halved = 0; halved < 2; ++halved) q /= 1 + std::sqrt(1 + q * q);
  double sum = 0;  // of q <= tan(pi / 16): q^25 / 25 < 2^-62
  for (int n = 23; n > 0; n -= 2) sum = 1.0 / n - q * q * sum;
  double angle = 4 * q * sum;
  if (std::abs(y) > std::abs(x)) angle = std::numbers::pi / 2 - angle;
  if (x < 0) angle = std::numbers::pi - angle;
  return std::copysign(angle, y);
}

// Linear light of a channel stored in eight bits, IEC 61966-2-1:1999. 0 to 1.
inline float srgbToLinear(unsigned stored) {
  const double v = stored / 255.0;
  if (v <= 0.04045) return static_cast<float>(v / 12.92);
  const double x = (v + 0.055) / 1.055, square = x * x;
  double root = 1;  // the fifth one of x^2, by Newton, from above
  for (int i = 0; i < 16; ++i) root -= (root - square / (root * root * root * root)) / 5;
  return static_cast<float>(square * root);
}

}  // namespace ff
