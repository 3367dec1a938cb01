#include "tools/chart/run_settings_json.h"

#include <charconv>
#include <nlohmann/json.hpp>

namespace ff::chart {
namespace {

// As short as the float that the run time makes of it: 1.6, not 1.600000023841858.
double asShortAsAFloat(double v) {
  char text[64];
  const auto end = std::to_chars(text, text + sizeof text, static_cast<float>(v)).ptr;
  double shortest = v;
  std::from_chars(text, end, shortest);
  return shortest;
}

}  // namespace

nlohmann::ordered_json jsonOf(const RunSettings& run) {
  nlohmann::ordered_json json;
  json["solver"] = run.solver;
  json["storage"] = run.storage;
  json["luminance"] = run.luminance;
  json["places"] = run.places;
  json["iterations"] = run.iterations;
  if (run.radius_m > 0) json["radius_m"] = asShortAsAFloat(run.radius_m);
  if (run.growth > 0) json["growth"] = asShortAsAFloat(run.growth);
  if (run.max_patches > 0) json["max_patches"] = run.max_patches;
  return json;
}

}  // namespace ff::chart
