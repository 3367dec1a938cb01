// Errors of light over patches and places, with their standard errors.
//
// Relative L2 is ||X - T|| / ||T|| over samples and channels, patches by their area: the norm of functions on
// surfaces, which does not change when a patch is cut in two. The tracer's noise adds its variance to both norms on
// average, so it is taken off both. Standard errors are the jackknife's over places (Efron, Tibshirani. An Introduction
// to the Bootstrap. 1993, chapter 11).
#pragma once
#include <array>
#include <span>
#include <string>
#include <vector>

#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

// One sample of a result beside the truth, by channel.
struct Compared {
  double weight = 1;  // in sums: the area of a patch, the pixels that show it
  std::array<double, 3> got{}, truth{}, noise{}, full{};  // noise: the truth's standard error; full: of the full solve
};

class Comparison {
 public:
  void addPlace(std::span<const Compared> samples);
  // got: reflected radiosity, 3 per patch of `numbers` (numbers in world.lookedAt()).
  void addPlace(const MeasuredWorld& world, const LitWorld& light, std::span<const uint32_t> numbers,
                std::span<const double> got);
  // rel_l2 and the rest against the path tracer, full_solve_rel_l2 against the full solve. The mean truth, the floor of
  // per-patch figures, is that of all patches added.
  Accuracy accuracy(const std::string& light) const;
  // ||full solve - traced|| / ||traced||: what is left when the run time is exact.
  Figure fullSolveAgainstTraced() const;
  // Standard error of the tracer itself, relative.
  double tracerNoise() const;

 private:
  struct Place {
    double traced = 0, full = 0, bake = 0;  // squared differences: got - traced, got - full, full - traced
    double traced_truth = 0, full_truth = 0, noise = 0;
    double power = 0, true_power = 0;       // sums of weight times value
  };
  struct Length {
    double difference, truth;  // over the channels
  };
  std::vector<Place> places_;
  std::vector<Length> lengths_;  // of all samples
};

// sqrt(numerator / denominator) over all places, with its jackknife error: not known where one place has nearly all of
// the denominator. Spans of equal length.
Figure relativeNorm(std::span<const double> numerators, std::span<const double> denominators);
// Median and half the range from the 25th to the 75th of a hundred.
Figure medianOf(std::vector<double> samples);

}  // namespace ff::chart
