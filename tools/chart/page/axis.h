// One axis of a chart: its range, and where its lines and numbers are.
#pragma once
#include <span>
#include <string>
#include <vector>

namespace ff::chart {

class Axis {
 public:
  struct Tick {
    double at = 0;
    std::string label;  // empty: a line without a number
  };

  // Holds all values that it can show, with a margin. One value, or none, still makes an axis of some width.
  Axis(std::span<const double> values, bool log);

  // Finite, and above zero on a logarithmic axis.
  bool shows(double value) const;
  // 0 at the low end, 1 at the high end; past the ends for values outside.
  double share(double value) const;
  // Steps of 1, 2 or 5 times a power of ten; over many decades the decades alone.
  const std::vector<Tick>& ticks() const { return ticks_; }
  double lo() const { return lo_; }
  double hi() const { return hi_; }

 private:
  void linearTicks();
  void logTicks();
  bool log_ = false;
  double lo_ = 0, hi_ = 1;
  std::vector<Tick> ticks_;
};

}  // namespace ff::chart
