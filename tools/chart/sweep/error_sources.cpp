#include "tools/chart/sweep/error_sources.h"

#include <fmt/core.h>

#include <cmath>

#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {

Result<Rows> rowsOf(MeasuredWorld& world, const Sweep& sweep) {
  Rows rows;
  for (uint32_t p = 0; p < world.patches().size(); ++p) rows.patch_at[Rows::keyOf(world.patches()[p])] = p;
  for (const Lighting& light : sweep.lights) {
    const auto lit = world.lit(light, sweep.standard.shadow_rays, nullptr);
    if (!lit) return lit.error();
    rows.reflected.push_back((*lit)->full);
  }
  return rows;
}

namespace {

std::string percent(const Figure& f) {
  if (!std::isfinite(f.value)) return "\u2014";
  return std::isfinite(f.error) && f.error > 0 ? fmt::format("{:.2f} \u00b1 {:.2f} %", 100 * f.value, 100 * f.error)
                                               : fmt::format("{:.2f} %", 100 * f.value);
}

}  // namespace

Result<void> splitSources(const TraceSettings& trace, Sweep& sweep, const Rows* reference) {
  MeasuredWorld& world = *sweep.world;
  auto cut = RunningCut::create(world, sweep.standard);
  if (!cut) return cut.error();
  for (size_t l = 0; l < sweep.lights.size(); ++l) {
    const auto lit = world.lit(sweep.lights[l], sweep.standard.shadow_rays, &trace);
    if (!lit) return lit.error();
    Comparison total, exact;  // the default; with reference rows and a full solve
    std::vector<double> rows, more_steps, sun, truth;
    for (size_t at = 0; at < sweep.places.size(); ++at) {
      if (!isSeen(sweep.places, at, sweep.lights[l])) continue;
      const std::vector<uint32_t> patches = world.patchesOf(at);
      if (auto moved = cut->moveTo(sweep.places[at].observer); !moved) return moved;
      if (auto set = cut->setLight(**lit); !set) return set;
      if (auto settled = cut->settle(); !settled) return settled.error();
      const auto got = cut->reflected(**lit, patches);
      if (!got) return got.error();
      if (auto stepped = cut->step(200); !stepped) return stepped;
      const auto later = cut->reflected(**lit, patches);
      if (!later) return later.error();
      total.addPlace(world, **lit, world.ofPlace(at), *got);
      double row = 0, more = 0, direct = 0, power = 0;
      std::vector<double> best;
      for (size_t k = 0; k < patches.size(); ++k) {
        const formats::Node& node = world.patches()[patches[k]];
        const auto area = static_cast<double>(node.area_m2);
        const PatchTruth& traced = (*lit)->traced[world.ofPlace(at)[k]];
        uint32_t other = bake::kNone;
        if (reference)
          if (const auto found = reference->patch_at.find(Rows::keyOf(node)); found != reference->patch_at.end())
            other = found->second;
        for (int c = 0; c < 3; ++c) {
          const size_t i = 3 * k + static_cast<size_t>(c), from = 3 * size_t{patches[k]} + static_cast<size_t>(c);
          const double full = (*lit)->full[from];
          const double better = other == bake::kNone ? full : reference->reflected[l][3 * size_t{other} + static_cast<size_t>(c)];
          const double s = static_cast<double>(node.albedo[c] * ((*lit)->sun.mean[0][patches[k]][c] - traced.sun[c]));
          best.push_back(better);
          row += area * (full - better) * (full - better);
          more += area * ((*later)[i] - (*got)[i]) * ((*later)[i] - (*got)[i]);
          direct += area * s * s;
          power += area * full * full;
        }
      }
      exact.addPlace(world, **lit, world.ofPlace(at), best);
      rows.push_back(row);
      more_steps.push_back(more);
      sun.push_back(direct);
      truth.push_back(power);
    }
    const Accuracy all = total.accuracy(""), floor = exact.accuracy("");
    ErrorSources split{sweep.lights[l].name, truth.size(), {}};
    const auto source = [&](const std::string& name, const Figure& error, const std::string& measured_as) {
      split.sources.push_back({name, error, measured_as});
    };
    source("all together", all.rel_l2, "the default against the path tracer");
    if (reference) {
      source("patches", floor.rel_l2,
             fmt::format("full solve, {} rays and {} quanta, against the path tracer", kReferenceRays, kReferenceQuanta));
      source("rows", relativeNorm(rows, truth), "full solve of the default's rows against that of the reference rows");
    } else {
      source("patches and rows", floor.rel_l2, "full solve of the default's rows against the path tracer");
    }
    source("cut", all.full_solve_rel_l2, "streamed against the full solve of the same rows");
    source("solver", relativeNorm(more_steps, truth), "what 200 more steps change");
    if (sweep.lights[l].hasSun())
      source("of which shadow rays", relativeNorm(sun, truth),
             fmt::format("sun by {} rays a patch against the path tracer's (its noise included)", sweep.standard.shadow_rays));
    sweep.sources.push_back(std::move(split));
  }
  return {};
}

Table tableOf(const ErrorSources& split, size_t number) {
  Table t;
  t.id = "sources-" + std::to_string(number);
  t.title = "Where the error comes from: " + split.light;
  t.note = fmt::format("Relative L2 over {} places. Each line is measured by taking its source away and nothing else; squares of "
                       "the four lines would add up to the square of the whole if they were independent.",
                       split.places);
  t.columns = {"source", "error", "measured as"};
  for (const ErrorSources::Source& s : split.sources) t.rows.push_back({s.source, percent(s.error), s.measured_as});
  return t;
}

}  // namespace ff::chart
