// Energy of a closed room that shines alike everywhere: B = M / (1 - albedo), through the bake and every solver.
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "runtime/dense/cpu_multibounce.h"
#include "runtime/dense/cpu_seed.h"
#include "runtime/dense/dense_solver.h"
#include "runtime/full_solve.h"
#include "stream/streamer.h"
#include "tools/chart/baked_scene.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/stability/albedo_axis.h"
#include "tools/chart/stability/parts.h"
#include "tools/scene/analytic.h"

namespace ff::chart {

using namespace runtime;

namespace {

// One baked furnace, all of it in the cut.
struct Furnace {
  BakedScene baked;
  std::unique_ptr<stream::Streamer> streamer;
  LocalMatrix matrix;
  std::vector<Vec4> source;
  double closed_form = 0;  // of A R over all patches and channels: what is reflected, B - M
};

Result<Furnace> furnaceOf(float albedo, const StabilityOptions& options) {
  auto baked = BakedScene::bake(sceneOf(tools::furnaceBox(albedo, 1)), {.cell_m = 0.125f,
                                                                        .rays = options.quick ? 256u : 1024u,
                                                                        .seed = options.seed,
                                                                        .threads = options.threads,
                                                                        .geometry = false});
  if (!baked) return baked.error();
  Furnace f{std::move(*baked), nullptr, {}, {}, 0};
  auto streamer = stream::Streamer::create(f.baked.world(), {.radius_m = 10});
  if (!streamer) return streamer.error();
  f.streamer = std::move(*streamer);
  f.streamer->update({0.5f, 0.5f, 0.5f}, {});
  if (auto settled = f.streamer->settle(); !settled) return settled.error();
  auto matrix = buildLocalMatrix(f.baked.world(), f.streamer->active());
  if (!matrix) return matrix.error();
  f.matrix = std::move(*matrix);
  f.source.assign(f.matrix.slots(), {});
  const Lamps all(f.baked.world().info());
  std::vector<Vec3> lamps;
  for (const auto& strip : f.streamer->active()) {
    lamps.resize(strip->nodes.size());
    all.irradiance(strip->lamps, lamps);
    for (uint32_t i = 0; i < strip->nodes.size(); ++i) {
      const uint32_t slot = f.matrix.slotOf(strip->id.level, strip->first_node + i);
      const Vec3 m = strip->nodes[i].emission, lit = strip->nodes[i].albedo * lamps[i];
      f.source[slot] = {lit.x, lit.y, lit.z, 0};
      if (strip->id.level == 0)
        f.closed_form += static_cast<double>(f.matrix.area_m2[slot]) *
                         (static_cast<double>(m.x) + static_cast<double>(m.y) + static_cast<double>(m.z)) *
                         static_cast<double>(albedo) / (1 - static_cast<double>(albedo));
    }
  }
  return f;
}

// Sum of A R over the closed form, minus 1.
Result<double> energyOf(const Furnace& f, Solver& solver, int iterations) {
  if (auto taken = solver.update(f.matrix, {.any = true, .renumbered = true}); !taken) return taken.error();
  if (auto lit = solver.setSource(f.source); !lit) return lit.error();
  if (auto lit = solver.setRadiosity(f.source); !lit) return lit.error();
  if (auto done = solver.iterate(iterations); !done) return done.error();
  std::vector<Vec4> b(f.source.size());
  if (auto read = solver.radiosity(b); !read) return read.error();
  double sum = 0;
  for (const uint32_t s : f.matrix.leaves)
    sum += static_cast<double>(f.matrix.area_m2[s]) *
           (static_cast<double>(b[s].x) + static_cast<double>(b[s].y) + static_cast<double>(b[s].z));
  return sum / f.closed_form - 1;
}

}  // namespace

Result<StabilityPart> stabilityOfEnergy(const StabilityOptions& options, const StabilityProgress& progress) {
  StabilityPart part;
  std::vector<Measured> by_method;
  std::vector<std::string> lowered;
  for (const float albedo : albedosOf(options.quick)) {
    const double rho = rounded(albedo);
    if (progress) progress("furnace of albedo " + numberText(rho));
    const auto furnace = furnaceOf(albedo, options);
    if (!furnace) return furnace.error();
    const auto places = static_cast<uint32_t>(furnace->matrix.leaves.size());
    const std::string clamped = "the bake lowered " +
                                numberText(static_cast<double>(furnace->baked.stats().clamped_nodes)) + " albedos to " +
                                numberText(std::round(static_cast<double>(bake::kMaxReflected) * 1e4) / 1e4);
    const auto add = [&](const std::string& method, Result<double> energy) {
      addPoint(by_method, "energy of a furnace (share gained or lost)", method, rho,
               energy && std::isfinite(*energy) ? *energy : std::numeric_limits<double>::infinity(),
               energy ? "at albedo " + numberText(rho) + " " + clamped : energy.error().message);
    };
    const auto source = fullSource(furnace->baked.world(), {}, {}, Lamps(furnace->baked.world().info()));
    if (!source) return source.error();
    const auto full = solveFullWorld(furnace->baked.world(), *source,
                                     {.tolerance = 1e-10, .max_iterations = kMaxIterations, .threads = 1});
    if (!full) return full.error();
    double sum = 0;
    for (const formats::TileInfo& info : furnace->baked.world().tiles(0)) {
      const uint32_t slot = furnace->matrix.slotOf(0, info.first_node);
      for (uint32_t i = 0; i < info.nodes; ++i)
        for (size_t c = 0; c < 3; ++c)
          sum += static_cast<double>(furnace->matrix.area_m2[slot + i]) *
                 full->radiosity[3 * size_t{info.first_node + i} + c];
    }
    add("full solve, double precision", sum / furnace->closed_form - 1);
    const auto gather = makeCpuGather(1);
    add("gather, " + std::to_string(kViewerIterations) + " from dark", energyOf(*furnace, *gather, kViewerIterations));
    // What is left then is e^-14 of it. The box is small: threads would wait for each other.
    const double kept = std::min(rho, static_cast<double>(bake::kMaxReflected));
    const int enough = static_cast<int>(std::ceil(-14 / std::log(kept)));
    add("gather, settled", energyOf(*furnace, *makeCpuGather(1), enough));
    const MultibounceSettings fp32{.places = places, .threads = options.threads};
    MultibounceSettings fp16 = fp32;
    fp16.storage = Storage::kFloat16;
    const auto dense = [&](Result<std::unique_ptr<BounceMatrix>> matrix, bool correct, int steps) -> Result<double> {
      if (!matrix) return matrix.error();
      const auto solver = makeDenseSolver(std::move(*matrix), {.correct = correct, .threads = options.threads});
      return energyOf(*furnace, *solver, steps);
    };
    add("seed", dense(makeCpuSeed(fp32), false, 1));
    add("multibounce fp32", dense(makeCpuMultibounce(fp32), false, 1));
    add("multibounce fp16", dense(makeCpuMultibounce(fp16), false, 1));
    add("dense solver, fp32", dense(makeCpuMultibounce(fp32), true, 4));
    add("dense solver, fp16", dense(makeCpuMultibounce(fp16), true, 4));
  }
  Chart chart = albedoChart(
      "energy-albedo", "Energy of a furnace against B = M / (1 - albedo)", "share of energy gained or lost",
      "A closed cube of 384 patches, baked; every wall shines alike. The amount; the hover says whether gained or "
      "lost. Past " +
          numberText(std::round(static_cast<double>(bake::kMaxReflected) * 1e4) / 1e4) +
          " the bake lowers albedos, which costs energy on purpose; before it, albedos are stored in steps of 1 / "
          "65535, and "
          "that is multiplied as light is.");
  for (Measured& m : by_method) {
    std::vector<double> signs;
    for (Measured::Point& p : m.points) {
      signs.push_back(p.error);
      p.error = std::abs(p.error);
    }
    Series series = overMultiplication(m);
    for (size_t i = 0; i < series.points.size(); ++i) series.points[i].hover += signs[i] > 0 ? " gained" : " lost";
    chart.series.push_back(std::move(series));
    if (m.method == "full solve, double precision")
      part.lead = "In a baked furnace the double-precision solve is within " + percentText(m.points.front().error) +
                  " of B = M / (1 - albedo) at albedo " + numberText(m.points.front().at) + ".";
  }
  part.charts = {std::move(chart)};
  part.measured = std::move(by_method);
  return part;
}

}  // namespace ff::chart
