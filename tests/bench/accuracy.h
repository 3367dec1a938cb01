// What ff_bench_accuracy measures, scene by scene. Errors end up in main().
#pragma once
#include <filesystem>
#include <span>
#include <string>

#include "formats/result.h"
#include "tools/chart/sweep/seen.h"

namespace ff::bench {

struct AccuracyOptions {
  bool quick = false;
  int observers = 96;
  std::string world;               // the town of 60,000 patches, baked already
  std::filesystem::path shared;    // the shared scenes
  std::filesystem::path folder;    // for bakes
  uint32_t patch_budget = 60000;   // of the scenes that are not given a patch size
};

// A JSON line. limit: NaN if there is none.
void printFigure(const std::string& metric, const std::string& scene, const chart::Figure& figure, double limit, const std::string& note);
void say(const std::string& line);
// Whether the file is there; says so where it is not.
bool isThere(const std::filesystem::path& file);

chart::Lighting skyAlone();
chart::Lighting sunAndSky();
chart::Lighting lampsAlone();

struct SeenLimits {
  double median = chart::kNotMeasured, bias = chart::kNotMeasured, rel_l2 = chart::kNotMeasured;
};
chart::SeenSettings seenSettings(const AccuracyOptions& options);
// METRIC_median, METRIC_bias and METRIC_rel_l2 of what the eyes see in a light.
Result<void> printSeen(chart::MeasuredWorld& world, std::span<const Vec3> eyes, const chart::Lighting& light, const std::string& metric,
                       const std::string& scene, const SeenLimits& limits, const chart::SeenSettings& settings);

// The light at the default settings around observers that are spread over the surface.
Result<void> measureTown(const AccuracyOptions& options);
Result<void> measureStaircase(const AccuracyOptions& options);
// What eyes in the dining room see of it.
Result<void> measureDiningRoom(const AccuracyOptions& options);
// Small lamps in a large hall, against the closed form; with grey walls against path tracing.
Result<void> measureSmallLamps(const AccuracyOptions& options);
// The light in rooms that no light gets into.
Result<void> measureLeaks(const AccuracyOptions& options);

}  // namespace ff::bench
