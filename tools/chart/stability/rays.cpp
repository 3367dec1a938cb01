// Too few rays: form factors against closed forms, and the light of a town against rows of many other rays.
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "bake/light/form_factor.h"
#include "tools/chart/patch_rows.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/stability/parts.h"
#include "tools/scene/analytic.h"
#include "tools/scene/town.h"

namespace ff::chart {

using namespace bake;

namespace {

// A scene whose light exchange is known. The first material sends, the last receives (both may be one).
struct ClosedForm {
  std::string name;
  Scene scene;
  float cell_m;
  double exact;
};

std::vector<ClosedForm> closedForms() {
  constexpr float kHalfAngle = 60;
  // Howell. A Catalog of Radiation Heat Transfer Configuration Factors. C-11, C-14.
  return {{"parallel squares", sceneOf(tools::parallelPlates(1, 0.5f, 1)), 4, 0.199824895698},
          {"perpendicular squares", sceneOf(tools::perpendicularPlates(0.5f, 1)), 4, 0.200043776075},
          {"spherical cap", sceneOf(tools::sphericalCap(kHalfAngle, 256, 0.5f, 1)), 4,
           (1 - std::cos(static_cast<double>(kHalfAngle) * std::numbers::pi / 180)) / 2}};
}

uint32_t materialOf(const Scene& scene, const PatchSet& set, uint32_t patch) {
  return scene.triangles[set.triangles[set.patches[patch].first_triangle].source].material;
}

// The area-weighted form factor from the first material's patches to the last one's.
double formFactor(const Scene& scene, const PatchSet& set, const PatchRows& rows) {
  const auto last = static_cast<uint32_t>(scene.materials.size()) - 1;
  double area = 0, exchange = 0;
  for (uint32_t i = 0; i < set.patches.size(); ++i) {
    if (materialOf(scene, set, i) != 0) continue;
    const auto a = static_cast<double>(set.patches[i].area_m2);
    area += a;
    for (uint64_t k = rows.start[i]; k < rows.start[i + 1]; ++k)
      if (materialOf(scene, set, rows.column[k]) == last) exchange += a * static_cast<double>(rows.f[k]);
  }
  return exchange / area;
}

struct Cast {
  PatchSet set;
  std::optional<RayCaster> caster;
};
Result<Cast> prepare(const Scene& scene, float cell_m) {
  auto caster = RayCaster::create(scene);
  if (!caster) return caster.error();
  auto set = makePatches(scene, {.cell_m = cell_m}, &*caster);
  if (!set) return set.error();
  return Cast{std::move(*set), std::move(*caster)};
}

PatchRows rowsOf(const Scene& scene, const Cast& cast, uint32_t rays, uint32_t quanta, uint64_t seed) {
  WorkCount done;
  return pooledRows(cast.set, castRows(scene, cast.set, *cast.caster, rays, seed, done), quanta);
}

std::vector<uint32_t> raysOf(uint32_t most) {
  std::vector<uint32_t> rays;
  for (uint32_t r = 16; r <= most; r *= 2) rays.push_back(r);
  return rays;
}

// From hard to easy in the measuring, from easy to hard in the table.
Measured easyFirst(Measured m) {
  std::reverse(m.points.begin(), m.points.end());
  return m;
}

// As 1 / sqrt(rays), through the first point of a line.
Series rootLine(const Measured& through) {
  Series line{.name = "1 / sqrt(rays)", .points = {}, .dots = false};
  if (through.points.empty()) return line;
  const Measured::Point& first = through.points.front();
  for (const Measured::Point& p : through.points)
    line.points.push_back({.x = p.at, .y = first.error * std::sqrt(first.at / p.at), .hover = {}});
  return line;
}

Chart raysChart(std::string id, std::string title, std::string y_label, std::string note) {
  Chart chart;
  chart.id = std::move(id);
  chart.title = std::move(title);
  chart.x_label = "rays a patch";
  chart.y_label = std::move(y_label);
  chart.note = std::move(note);
  chart.log_x = chart.log_y = true;
  chart.y_marks = {{0.01, "1 %"}, {0.05, "5 %"}};
  return chart;
}

constexpr uint32_t kMaxRays = 16384;

Result<Measured> closedFormErrors(const ClosedForm& form, const std::vector<uint32_t>& counts, uint32_t seeds,
                                  uint64_t first_seed, Series& series) {
  const auto cast = prepare(form.scene, form.cell_m);
  if (!cast) return cast.error();
  Measured m{.scene = form.name + " against the closed form",
             .method = "pooled rays",
             .knob = "rays a patch",
             .unit = "",
             .points = {},
             .then = {}};
  series.name = form.name;
  for (const uint32_t rays : counts) {
    double squares = 0, fourth = 0;
    for (uint32_t s = 0; s < seeds; ++s) {
      const double f = formFactor(form.scene, cast->set, rowsOf(form.scene, *cast, rays, 0, first_seed + s));
      const double square = (f / form.exact - 1) * (f / form.exact - 1);
      squares += square;
      fourth += square * square;
    }
    const double mean = squares / seeds, rms = std::sqrt(mean);
    // The mean square's standard error, carried over to its root.
    const double spread = std::sqrt(std::max(0.0, fourth / seeds - mean * mean) / seeds) / (2 * rms);
    m.points.push_back({static_cast<double>(rays), rms});
    series.points.push_back({.x = static_cast<double>(rays),
                             .y = std::max(rms, kLeastDrawn),
                             .y_error = std::isfinite(spread) ? spread : 0,
                             .hover = form.name + ", " + numberText(rays) + " rays: " + percentText(rms) + " rms of " +
                                      numberText(seeds) + " seeds"});
  }
  const double slope =
      std::log(m.points.back().error / m.points.front().error) / std::log(m.points.back().at / m.points.front().at);
  m.then = "nothing: noise; it falls with rays to the power " + numberText(std::round(100 * slope) / 100) +
           " (rms of " + numberText(seeds) +
           " seeds, patches: " + numberText(static_cast<double>(cast->set.patches.size())) + ")";
  return m;
}

}  // namespace

Result<StabilityPart> stabilityOfRays(const StabilityOptions& options, const StabilityProgress& progress) {
  StabilityPart part;
  const std::vector<uint32_t> counts = raysOf(kMaxRays);
  const uint32_t seeds = options.quick ? 8 : 64;
  Chart forms =
      raysChart("error-rays-closed-forms", "Error against rays: closed forms", "relative error of the form factor",
                "Each surface is one patch, the cap a few; rays from both ends are pooled; root mean square over " +
                    numberText(seeds) + " seeds, with its standard error.");
  for (const ClosedForm& form : closedForms()) {
    if (progress) progress("rays: " + form.name);
    Series series;
    auto m = closedFormErrors(form, counts, seeds, options.seed, series);
    if (!m) return m.error();
    if (forms.series.empty()) forms.series.push_back(rootLine(*m));
    forms.series.push_back(std::move(series));
    part.measured.push_back(easyFirst(std::move(*m)));
  }
  // A furnace's rows sum to 1 whatever their noise.
  if (progress) progress("rays: furnace");
  const Scene furnace = sceneOf(tools::furnaceBox(0.5f, 1));
  const auto box = prepare(furnace, 0.125f);
  if (!box) return box.error();
  Measured exact{.scene = "furnace against B = M / (1 - albedo)",
                 .method = "pooled rays, Q = 512",
                 .knob = "rays a patch",
                 .unit = "",
                 .points = {},
                 .then = "nothing to do: every row is a whole number of counts that add up to Q"};
  for (const uint32_t rays : counts) {
    if (rays > 1024) break;
    const PatchRows rows = rowsOf(furnace, *box, rays, 512, options.seed);
    const std::vector<double> source(3 * box->set.patches.size(), 1.0), closed(source.size(), 2.0);
    const std::vector<double> b = solveRows(box->set, rows, source, 1e-14, 1000);
    double error = 0;
    for (const double x : b) error = std::max(error, std::abs(x / 2 - 1));
    exact.points.push_back({static_cast<double>(rays), error});
  }
  forms.series.push_back(seriesOf(exact, "furnace"));
  part.measured.push_back(easyFirst(std::move(exact)));

  if (progress) progress("rays: town");
  const auto town = tools::makeTown({.patches = options.quick ? tools::kMinTownPatches : 8000u, .seed = options.seed});
  if (!town) return town.error();
  const Scene scene = sceneOf(tools::townModel(*town, false));
  const auto cast = prepare(scene, 1);
  if (!cast) return cast.error();
  const std::vector<double> sun = sunOnPatches(cast->set, *cast->caster);
  const auto light = [&](uint32_t rays, uint32_t quanta, uint64_t seed) {
    const PatchRows rows = rowsOf(scene, *cast, rays, quanta, seed);
    return solveRows(cast->set, rows, sunAndSky(cast->set, rows, sun), 1e-9);
  };
  const uint32_t truth_rays = options.quick ? 4096 : kMaxRays;
  const std::vector<double> truth = light(truth_rays, 0, options.seed + 77);
  const std::string patches = numberText(static_cast<double>(cast->set.patches.size()));
  Measured all{.scene = "town of " + patches + " patches, sun and sky",
               .method = "pooled rows",
               .knob = "rays a patch",
               .unit = "",
               .points = {},
               .then = "nothing: noise that stays still"};
  Measured sampled = all;
  sampled.method = "rows sampled at Q = 512";
  for (const uint32_t rays : counts) {
    if (options.quick && rays > 2048) break;
    if (progress) progress("rays: town, " + numberText(rays));
    all.points.push_back(
        {static_cast<double>(rays), reflectedDifference(light(rays, 0, options.seed), truth)});
    sampled.points.push_back(
        {static_cast<double>(rays), reflectedDifference(light(rays, 512, options.seed), truth)});
  }
  Chart noise = raysChart("error-rays-town", "Error against rays: a town of " + patches + " patches",
                          "relative L2 error of reflected radiosity",
                          "Sun and sky, against pooled rows of " + numberText(truth_rays) +
                              " other rays, whose own noise is part of what is seen at the right end.");
  noise.series = {rootLine(all), seriesOf(all, all.method), seriesOf(sampled, sampled.method)};
  part.lead = "In a town " + numberText(sampled.points.front().at) + " rays a patch err by " +
              percentText(sampled.points.front().error) + ", " + numberText(sampled.points.back().at) + " by " +
              percentText(sampled.points.back().error) + ".";
  part.measured.push_back(easyFirst(std::move(all)));
  part.measured.push_back(easyFirst(std::move(sampled)));
  part.charts = {std::move(forms), std::move(noise)};
  return part;
}

}  // namespace ff::chart
