#include "tools/chart/page/axis.h"

#include <algorithm>
#include <cmath>

#include "tools/chart/page/figure_text.h"

namespace ff::chart {
namespace {

constexpr double kMargin = 0.05;      // of the range, on either side
constexpr double kLargest = 1e150;    // differences and ratios of such numbers are finite
constexpr double kLinearSteps = 6;    // at most, about
constexpr double kLabelledDecades = 9;

double step125(double range) {
  const double raw = range / kLinearSteps;
  const double power = std::pow(10.0, std::floor(std::log10(raw)));
  for (const double m : {1.0, 2.0, 5.0})
    if (m * power >= raw * 0.999) return m * power;
  return 10 * power;
}

}  // namespace

Axis::Axis(std::span<const double> values, bool log) : log_(log) {
  double lo = kLargest, hi = -kLargest;
  for (const double v : values) {
    if (!shows(v)) continue;
    lo = std::min(lo, v);
    hi = std::max(hi, v);
  }
  if (lo > hi) lo = log_ ? 1 : 0, hi = log_ ? 10 : 1;
  if (log_) {
    if (hi / lo < 1.02) lo /= 3, hi *= 3;
    const double margin = std::pow(hi / lo, kMargin);
    lo_ = lo / margin;
    hi_ = hi * margin;
    logTicks();
    return;
  }
  if (hi - lo <= 1e-9 * std::max(std::abs(lo), std::abs(hi))) {
    const double half = hi == 0 ? 1 : 0.5 * std::abs(hi);
    lo -= half;
    hi += half;
  }
  const double margin = kMargin * (hi - lo);
  // Zero belongs to an axis that comes near it.
  if (lo >= 0 && lo < 0.4 * hi)
    lo_ = 0;
  else
    lo_ = lo - margin;
  hi_ = hi <= 0 && -hi < 0.4 * -lo ? 0 : hi + margin;
  linearTicks();
}

bool Axis::shows(double v) const {
  return std::abs(v) <= kLargest && (!log_ || v >= 1 / kLargest);  // false for NaN
}

double Axis::share(double v) const {
  return log_ ? std::log(v / lo_) / std::log(hi_ / lo_) : (v - lo_) / (hi_ - lo_);
}

void Axis::linearTicks() {
  const double step = step125(hi_ - lo_);
  const double largest = std::max(std::abs(lo_), std::abs(hi_));
  const int digits = std::clamp(static_cast<int>(std::floor(std::log10(largest)) - std::floor(std::log10(step))) + 1, 6, 12);
  for (double k = std::ceil(lo_ / step - 1e-9); k * step <= hi_ + 1e-9 * step; ++k)
    ticks_.push_back({k * step, axisNumber(std::abs(k) < 0.5 ? 0 : k * step, digits)});
}

void Axis::logTicks() {
  const double decades = std::log10(hi_ / lo_);
  if (decades < 0.7) return linearTicks();
  const int first = static_cast<int>(std::floor(std::log10(lo_))), last = static_cast<int>(std::ceil(std::log10(hi_)));
  // Either all numbers in full or all as powers.
  const bool powers = lo_ < 0.9e-3 || hi_ > 1.1e6;
  const int stride = static_cast<int>(std::ceil(decades / kLabelledDecades));
  for (int p = first; p <= last; ++p) {
    for (const double m : {1.0, 2.0, 5.0}) {
      const double at = m * std::pow(10.0, p);
      if (at < lo_ * 0.9999 || at > hi_ * 1.0001 || (m > 1 && decades > 4)) continue;
      const bool labelled = m > 1 ? decades <= 3.2 : p % stride == 0;
      ticks_.push_back({at, labelled ? powers ? axisPower(at) : axisNumber(at) : std::string()});
    }
  }
}

}  // namespace ff::chart
