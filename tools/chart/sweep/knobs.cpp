#include "tools/chart/sweep/knobs.h"

#include <fmt/core.h>

namespace ff::chart {

const char* nameOf(Method m) {
  switch (m) {
    case Method::kGather: return "gather";
    case Method::kMultibounce: return "multibounce fp32";
    case Method::kMultibounceHalf: return "multibounce fp16";
    case Method::kMultibounceLuminance: return "multibounce luminance";
    case Method::kSeed: return "seed";
    case Method::kPlainLocal: return "plain local";
  }
  return "";
}

std::vector<std::pair<std::string, std::string>> described(const Knobs& k) {
  const auto number = [](double x) { return fmt::format("{:.4g}", x); };
  const auto metres = [&](float x) { return number(static_cast<double>(x)) + " m"; };
  return {{"patch size", metres(k.bake.cell_m)},
          {"rays", number(k.bake.rays)},
          {"quanta", number(k.bake.quanta)},
          {"shadow rays", number(k.shadow_rays)},
          {"solver", nameOf(k.method)},
          {"steps a frame", number(k.iterations)},
          {"places", isDense(k.method) ? number(k.places) : "any"},
          {"radius", metres(k.radius_m)},
          {"growth", number(static_cast<double>(k.growth))},
          {"most patches", number(k.max_patches)},
          {"far light", k.pyramid ? "pyramid" : "constant"},
          {"cut follows every", k.every == 1 ? "frame" : number(k.every) + " frames"}};
}

RunSettings runSettings(const Knobs& k) {
  RunSettings run;
  // What the run time can be told. The baselines are for charts.
  if (k.every != 1 || !k.pyramid || k.method == Method::kSeed || k.method == Method::kPlainLocal) return run;
  run.solver = k.method == Method::kGather ? "gather" : "multibounce";
  run.storage = k.method == Method::kMultibounceHalf ? "fp16" : "fp32";
  run.luminance = k.method == Method::kMultibounceLuminance;
  run.places = k.places;
  run.iterations = k.iterations;
  run.radius_m = static_cast<double>(k.radius_m);
  run.growth = static_cast<double>(k.growth);
  run.max_patches = k.max_patches;
  return run;
}

}  // namespace ff::chart
