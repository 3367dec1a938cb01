// Albedo towards 1. Light in a closed box is multiplied by 1 / (1 - albedo): errors of rounding, of too few iterations
// and of truncated series come back as many times larger.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "runtime/solver/solver.h"
#include "tools/chart/stability/albedo_axis.h"
#include "tools/chart/stability/parts.h"
#include "tools/chart/stability/walk_matrix.h"

namespace ff::chart {

using namespace runtime;
using namespace walks;

namespace {

constexpr double kReached = 0.01;

// Iterations of gather from dark until reflected radiosity is within kReached; the error after three and after as many
// as the viewer makes.
struct Gathered {
  int reached = 0;  // 0: not within kMaxIterations
  double after_three = 0, after_viewers = 0, settled = 0;
};

Result<Gathered> gatherFromDark(const SceneRows& set, std::span<const uint32_t> present, std::span<const Vec4> light,
                                std::span<const Rgb> exact, int threads) {
  WalkMatrix rows(set);
  rows.set(present, {}, present);
  const auto solver = makeCpuGather(threads);
  if (auto taken = solver->update(rows.matrix(), {.any = true, .renumbered = true}); !taken) return taken.error();
  if (auto lit = solver->setSource(light); !lit) return lit.error();
  if (auto lit = solver->setRadiosity(light); !lit) return lit.error();
  std::vector<Vec4> b(set.patches());
  const auto error = [&] {
    (void)solver->radiosity(b);
    std::vector<Rgb> reflected(set.patches(), Rgb{});
    for (const uint32_t p : present)
      reflected[p] = {static_cast<double>(b[p].x) - static_cast<double>(light[p].x),
                      static_cast<double>(b[p].y) - static_cast<double>(light[p].y),
                      static_cast<double>(b[p].z) - static_cast<double>(light[p].z)};
    return relativeDifference(reflected, exact, present);
  };
  Gathered g;
  int done = 0;
  const auto upTo = [&](int iterations) -> Result<void> {
    auto ok = solver->iterate(iterations - done);
    done = iterations;
    return ok;
  };
  double before = 1;
  for (int next = 1; next <= kMaxIterations; next = std::max(next + 1, next + next / 20)) {
    for (const auto& [at, to] : {std::pair{3, &g.after_three}, {kViewerIterations, &g.after_viewers}})
      if (done < at && next >= at) {
        if (auto ok = upTo(at); !ok) return ok.error();
        *to = error();
        if (g.reached == 0 && *to <= kReached) g.reached = at;
      }
    if (next > done)
      if (auto ok = upTo(next); !ok) return ok.error();
    const double now = error();
    if (g.reached == 0 && now <= kReached) g.reached = done;
    g.settled = now;
    const bool still = done > kViewerIterations && std::abs(now - before) < 1e-7;
    if (still || (g.reached > 0 && done > kViewerIterations && now < 1e-5)) break;
    before = now;
  }
  return g;
}

}  // namespace

Result<StabilityPart> stabilityOfAlbedo(const StabilityOptions& options, const StabilityProgress& progress) {
  const uint32_t swaps = options.swaps > 0 ? options.swaps / 10 : options.quick ? 512u : 10000u;
  StabilityPart part;
  Chart errors = albedoChart("error-albedo", "Error against albedo: a closed box after " + numberText(swaps) + " swaps",
                             "relative L2 error of reflected radiosity",
                             "256 patches that see each other at random, all rows sum to 1; the worst over the walk. "
                             "Gather starts from dark and stops "
                             "after 3 products (plain local radiosity) or " +
                                 std::to_string(kViewerIterations) + ".");
  errors.y_marks = {{0.01, "1 %"}, {0.05, "5 %"}};
  Chart iterations = albedoChart("iterations-albedo", "Iterations of gather from dark to within 1 %", "iterations",
                                 "Closed box of 256 patches, uneven light. The line is log(0.01) / log(albedo).");
  Series needed{.name = "gather", .points = {}}, expected{.name = "log 0.01 / log albedo", .points = {}, .dots = false};
  std::vector<Measured> by_method;
  const auto add = [&](const std::string& method, double albedo, double error, const std::string& then) {
    addPoint(by_method, "closed box, " + numberText(swaps) + " swaps", method, albedo, error, then);
  };
  for (const float albedo : albedosOf(options.quick)) {
    const double rho = rounded(albedo);
    if (progress) progress("albedo " + numberText(rho));
    const SceneSettings scene{
        .kind = SceneKind::kClosedBox, .patches = 256, .entries_per_row = 60, .albedo = albedo, .seed = options.seed};
    auto walked = measureWalk({"", scene, WalkKind::kRandom, 256, 32, swaps, swaps}, 1);
    if (!walked) return walked.error();
    for (const Measured& m : *walked) {
      double most = m.points.empty() ? std::numeric_limits<double>::infinity() : 0;
      for (const Measured::Point& p : m.points) most = std::max(most, p.error);
      add(m.method, rho, most, "at albedo " + numberText(rho) + ": " + m.then);
    }
    const SceneRows set = quantisedScene(scene);
    const std::vector<Vec4> light = randomLight(set.patches(), options.seed + 7);
    std::vector<uint32_t> present(set.patches());
    for (uint32_t p = 0; p < set.patches(); ++p) present[p] = p;
    const std::vector<Rgb> exact = exactReflected(set, present, light);
    const auto gathered = gatherFromDark(set, present, light, exact, 1);
    if (!gathered) return gathered.error();
    const std::string reached = gathered->reached > 0
                                    ? "1 % after " + numberText(gathered->reached) + " iterations"
                                    : "not within 1 % after " + numberText(kMaxIterations) + " iterations";
    add("plain local, 3 products", rho, gathered->after_three, "nothing: three bounces are all it makes");
    add("gather, " + std::to_string(kViewerIterations) + " from dark", rho, gathered->after_viewers,
        "goes on from the last frame: at albedo " + numberText(rho) + " " + reached);
    add("gather, settled", rho, gathered->settled, "at albedo " + numberText(rho) + " " + reached);
    const double x = 1 / (1 - rho);
    if (gathered->reached > 0)
      needed.points.push_back({.x = x, .y = static_cast<double>(gathered->reached), .hover = {}});
    expected.points.push_back({.x = x, .y = std::max(1.0, std::log(kReached) / std::log(rho)), .hover = {}});
  }
  for (const Measured& m : by_method) errors.series.push_back(overMultiplication(m));
  iterations.series = {needed, expected};
  if (!needed.points.empty())
    part.lead = "From dark, gather needs " + numberText(needed.points.front().y) +
                " iterations to 1 % in a closed box of albedo " + numberText(1 - 1 / needed.points.front().x) +
                " and " + numberText(needed.points.back().y) + " at " + numberText(1 - 1 / needed.points.back().x) +
                ".";
  part.charts = {std::move(errors), std::move(iterations)};
  part.measured = std::move(by_method);
  return part;
}

}  // namespace ff::chart
