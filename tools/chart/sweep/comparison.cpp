#include "tools/chart/sweep/comparison.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace ff::chart {
namespace {

// f(without) for each place left out; the jackknife's standard error.
template <class Statistic>
double jackknife(size_t places, const Statistic& statistic) {
  if (places < 2) return kNotMeasured;
  double sum = 0, squares = 0;
  for (size_t out = 0; out < places; ++out) {
    const double v = statistic(out);
    sum += v;
    squares += v * v;
  }
  const auto n = static_cast<double>(places);
  return std::sqrt(std::max(0.0, (n - 1) * (squares / n - sum * sum / (n * n))));
}

constexpr size_t kAll = ~size_t{0};

double ratio(std::span<const double> a, std::span<const double> b, size_t without) {
  double x = 0, y = 0;
  for (size_t i = 0; i < a.size(); ++i)
    if (i != without) x += a[i], y += b[i];
  return y > 0 ? x / y : kNotMeasured;
}

// Whether one place carries nearly all: leaving it out says nothing about the rest.
bool hangsOnOne(std::span<const double> weights) {
  double sum = 0, largest = 0;
  for (const double w : weights) sum += w, largest = std::max(largest, w);
  return largest > 0.9 * sum;
}

double quantile(std::vector<double>& sorted, double q) {
  if (sorted.empty()) return kNotMeasured;
  return sorted[std::min(sorted.size() - 1, static_cast<size_t>(q * static_cast<double>(sorted.size())))];
}

}  // namespace

Figure relativeNorm(std::span<const double> numerators, std::span<const double> denominators) {
  const auto norm = [&](size_t without) { return std::sqrt(std::max(0.0, ratio(numerators, denominators, without))); };
  // max() would turn "not finite" into 0.
  const double all = ratio(numerators, denominators, kAll);
  if (!std::isfinite(all) || hangsOnOne(denominators)) return {std::isfinite(all) ? norm(kAll) : all, kNotMeasured};
  return {norm(kAll), jackknife(numerators.size(), norm)};
}

Figure medianOf(std::vector<double> samples) {
  if (samples.empty()) return {};
  std::sort(samples.begin(), samples.end());
  return {quantile(samples, 0.5), 0.5 * (quantile(samples, 0.75) - quantile(samples, 0.25))};
}

void Comparison::addPlace(std::span<const Compared> samples) {
  Place place;
  for (const Compared& s : samples) {
    double difference = 0, length = 0;
    for (size_t c = 0; c < 3; ++c) {
      const double x = s.got[c], t = s.truth[c], noise = s.noise[c], full = s.full[c], w = s.weight;
      place.traced += w * ((x - t) * (x - t) - noise * noise);
      place.full += w * (x - full) * (x - full);
      place.bake += w * ((full - t) * (full - t) - noise * noise);
      place.traced_truth += w * (t * t - noise * noise);
      place.full_truth += w * full * full;
      place.noise += w * noise * noise;
      place.power += w * x;
      place.true_power += w * t;
      difference += (x - t) * (x - t);
      length += t * t;
    }
    lengths_.push_back({std::sqrt(difference), std::sqrt(length)});
  }
  places_.push_back(place);
}

void Comparison::addPlace(const MeasuredWorld& world, const LitWorld& light, std::span<const uint32_t> numbers,
                          std::span<const double> got) {
  std::vector<Compared> samples;
  for (size_t k = 0; k < numbers.size(); ++k) {
    const PatchTruth& truth = light.traced[numbers[k]];
    if (truth.buried) continue;
    const uint32_t patch = world.lookedAt()[numbers[k]];
    Compared s{.weight = static_cast<double>(world.patches()[patch].area_m2)};
    for (int c = 0; c < 3; ++c) {
      const auto channel = static_cast<size_t>(c);
      s.got[channel] = got[3 * k + channel];
      s.truth[channel] = static_cast<double>(truth.reflected[c]);
      s.noise[channel] = static_cast<double>(truth.error[c]);
      s.full[channel] = light.full[3 * size_t{patch} + channel];
    }
    samples.push_back(s);
  }
  addPlace(samples);
}

Accuracy Comparison::accuracy(const std::string& light) const {
  const auto column = [&](double Place::*member) {
    std::vector<double> values;
    for (const Place& p : places_) values.push_back(p.*member);
    return values;
  };
  Accuracy a;
  a.light = light;
  const auto truth = column(&Place::traced_truth);
  a.rel_l2 = relativeNorm(column(&Place::traced), truth);
  a.full_solve_rel_l2 = relativeNorm(column(&Place::full), column(&Place::full_truth));
  const auto power = column(&Place::power), true_power = column(&Place::true_power);
  const auto gain = [&](size_t without) { return ratio(power, true_power, without) - 1; };
  a.energy = {gain(kAll), hangsOnOne(true_power) ? kNotMeasured : jackknife(places_.size(), gain)};
  double mean = 0;
  for (const Length& l : lengths_) mean += l.truth / static_cast<double>(lengths_.size());
  std::vector<double> errors;
  for (const Length& l : lengths_)
    if (mean > 0) errors.push_back(l.difference / std::max(l.truth, mean));
  std::sort(errors.begin(), errors.end());
  // Of a quantile, the error of its rank: half the distance between the values one standard deviation of it apart.
  const auto at = [&](double q) {
    const double half = std::sqrt(q * (1 - q) / std::max(1.0, static_cast<double>(errors.size())));
    return Figure{quantile(errors, q), 0.5 * (quantile(errors, std::min(1.0, q + half)) - quantile(errors, std::max(0.0, q - half)))};
  };
  a.median = at(0.5);
  a.p95 = at(0.95);
  a.p99 = at(0.99);
  return a;
}

Figure Comparison::fullSolveAgainstTraced() const {
  std::vector<double> bake, truth;
  for (const Place& p : places_) bake.push_back(p.bake), truth.push_back(p.traced_truth);
  return relativeNorm(bake, truth);
}

double Comparison::tracerNoise() const {
  double noise = 0, truth = 0;
  for (const Place& p : places_) noise += p.noise, truth += p.traced_truth;
  return truth > 0 ? std::sqrt(noise / truth) : kNotMeasured;
}

}  // namespace ff::chart
