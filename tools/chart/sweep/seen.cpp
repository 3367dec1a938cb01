#include "tools/chart/sweep/seen.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

constexpr uint32_t kPilotPaths = 2048, kMaxPaths = 1u << 20;  // a surface

// What each surface is given, 3 each; nothing where nothing is drawn.
std::vector<double> ofSurfaces(const SeenPixels& seen, std::span<const double> of_patches) {
  std::vector<double> given;
  for (const SeenSurface& s : seen.surfaces) {
    const uint32_t patch = s.points.front().patch;
    for (size_t c = 0; c < 3; ++c) given.push_back(patch == PathTracer::kNoPatch ? 0.0 : of_patches[3 * size_t{patch} + c]);
  }
  return given;
}

// Over the truth of each; the dark counts as the bright does.
double ownMedian(std::span<const Compared> pixels) {
  std::vector<double> errors;
  for (const Compared& p : pixels) {
    double wrong = 0, truth = 0;
    for (size_t c = 0; c < 3; ++c) wrong += (p.got[c] - p.truth[c]) * (p.got[c] - p.truth[c]), truth += p.truth[c] * p.truth[c];
    if (truth > 0) errors.push_back(std::sqrt(wrong / truth));
  }
  return medianOf(std::move(errors)).value;
}

// irradiance: of the surfaces, 3 each; full: of the full solve, likewise.
std::vector<Compared> comparePixels(const SeenPixels& seen, size_t eye, std::span<const PatchTruth> truth,
                                    std::span<const double> irradiance, std::span<const double> full) {
  std::vector<Compared> samples;
  for (const uint32_t k : seen.pixels[eye]) {
    Compared s;
    for (size_t c = 0; c < 3; ++c) {
      s.got[c] = irradiance[3 * size_t{k} + c];
      s.full[c] = full[3 * size_t{k} + c];
      s.truth[c] = static_cast<double>(truth[k].irradiance[static_cast<int>(c)]);
      s.noise[c] = static_cast<double>(truth[k].irradiance_error[static_cast<int>(c)]);
    }
    samples.push_back(s);
  }
  return samples;
}

double lengthOf(Vec3 v) { return static_cast<double>(length(v)); }

}  // namespace

size_t SeenPixels::count() const {
  size_t all = 0;
  for (const auto& of_eye : pixels) all += of_eye.size();
  return all;
}

SeenPixels lookAround(const PathTracer& tracer, std::span<const Vec3> eyes, const SeenSettings& settings) {
  SeenPixels seen;
  std::vector<EyeView> views;
  for (const Vec3 eye : eyes) {
    EyeView view = tracer.lookFrom(eye, settings.rays);
    if (view.points.empty() || 2 * view.backs > settings.rays) continue;
    seen.eyes.push_back(eye);
    views.push_back(std::move(view));
  }
  if (views.empty()) return seen;
  std::map<uint32_t, std::vector<SeenPoint>> of_patch;
  size_t points = 0;
  for (const EyeView& view : views)
    for (const SeenPoint& p : view.points) of_patch[p.patch].push_back(p), ++points;
  if (const auto none = of_patch.find(PathTracer::kNoPatch); none != of_patch.end())
    seen.not_drawn = static_cast<double>(none->second.size()) / static_cast<double>(points);

  std::map<uint32_t, uint32_t> number;
  const size_t an_eye = std::max<size_t>(1, settings.pixels / views.size());
  for (const EyeView& view : views) {
    // In the order of patches: each has its share of the pixels, to within one.
    std::vector<uint32_t> patches;
    for (const SeenPoint& p : view.points) patches.push_back(p.patch);
    std::sort(patches.begin(), patches.end());
    seen.pixels.emplace_back();
    const size_t count = std::min(an_eye, patches.size());
    for (size_t k = 0; k < count; ++k) {
      const uint32_t patch = patches[patches.size() * (2 * k + 1) / (2 * count)];
      const auto [at, fresh] = number.try_emplace(patch, static_cast<uint32_t>(seen.surfaces.size()));
      if (fresh) seen.surfaces.push_back({std::move(of_patch[patch])});
      seen.pixels.back().push_back(at->second);
    }
  }
  return seen;
}

std::vector<PatchTruth> truthOfSeen(const PathTracer& tracer, const SeenPixels& seen, const Lighting& light,
                                    const SeenSettings& settings) {
  std::vector<SeenSurface> surfaces = seen.surfaces;
  for (SeenSurface& s : surfaces) s.paths = kPilotPaths;
  const std::vector<PatchTruth> pilot = tracer.traceSeen(surfaces, light, settings.seed + 1, settings.threads);
  double mean = 0;
  for (const auto& of_eye : seen.pixels)
    for (const uint32_t k : of_eye) mean += lengthOf(pilot[k].irradiance) / static_cast<double>(seen.count());
  // The same relative noise everywhere, as far as the paths go round.
  std::vector<double> need;
  double sum = 0;
  for (const PatchTruth& t : pilot) {
    const double scale = std::max(lengthOf(t.irradiance), mean), noise = scale > 0 ? lengthOf(t.irradiance_error) / scale : 0;
    need.push_back(noise * noise);
    sum += need.back();
  }
  for (size_t k = 0; k < surfaces.size(); ++k) {
    const double share = sum > 0 ? need[k] / sum * static_cast<double>(settings.paths) : 0;
    surfaces[k].paths = static_cast<uint32_t>(std::clamp<double>(share, kPilotPaths, kMaxPaths));
  }
  return tracer.traceSeen(surfaces, light, settings.seed, settings.threads);
}

Result<SeenScore> scoreSeen(MeasuredWorld& world, const SeenPixels& seen, const Lighting& light, const Knobs& standard,
                            const SeenSettings& settings) {
  if (seen.count() == 0)
    return Error{ErrorCode::kUsage, world.world().path(), "eyes", "none sees a surface from the air", "put them inside the rooms"};
  const auto lit = world.lit(light, standard.shadow_rays, nullptr);
  if (!lit) return lit.error();
  const std::vector<PatchTruth> truth = truthOfSeen(world.tracer(), seen, light, settings);
  const std::vector<double> full = ofSurfaces(seen, (*lit)->irradiance);
  auto cut = RunningCut::create(world, standard);
  if (!cut) return cut.error();
  std::vector<uint32_t> drawn;  // patches
  for (const SeenSurface& s : seen.surfaces)
    if (s.points.front().patch != PathTracer::kNoPatch) drawn.push_back(s.points.front().patch);
  Comparison streamed, solved;
  std::vector<Compared> all;
  std::vector<double> of_patches(3 * world.patches().size());
  for (size_t eye = 0; eye < seen.eyes.size(); ++eye) {
    if (auto moved = cut->moveTo(seen.eyes[eye]); !moved) return moved.error();
    if (auto set = cut->setLight(**lit); !set) return set.error();
    if (auto settled = cut->settle(); !settled) return settled.error();
    const auto got = cut->irradiance(**lit, drawn);
    if (!got) return got.error();
    for (size_t k = 0; k < drawn.size(); ++k)
      std::copy_n(got->begin() + static_cast<std::ptrdiff_t>(3 * k), 3, of_patches.begin() + static_cast<std::ptrdiff_t>(3 * drawn[k]));
    const std::vector<Compared> pixels = comparePixels(seen, eye, truth, ofSurfaces(seen, of_patches), full);
    streamed.addPlace(pixels);
    solved.addPlace(comparePixels(seen, eye, truth, full, full));
    all.insert(all.end(), pixels.begin(), pixels.end());
  }
  SeenScore score;
  score.light = light.name;
  score.streamed = streamed.accuracy(light.name);
  score.full_solve = solved.accuracy(light.name);
  score.own_median = ownMedian(all);
  score.tracer_noise = solved.tracerNoise();
  score.not_drawn = seen.not_drawn;
  score.eyes = seen.eyes.size();
  score.pixels = seen.count();
  score.patches = seen.surfaces.size();
  if (std::none_of(truth.begin(), truth.end(), [](const PatchTruth& t) { return lengthOf(t.irradiance) > 0; }))
    score.note = "nothing of this light reaches what the eyes see";
  return score;
}

Table tableOf(std::span<const SeenScore> scores) {
  Table t;
  t.id = "seen";
  t.title = "What is seen";
  t.note = "Irradiance of pixels against path tracing at the points of their patch that are seen; of the full solve in brackets.";
  if (!scores.empty())
    t.note += fmt::format(" {} pixels of {} patches from {} eyes; {:.2g} % of them show surface without a patch, taken as unlit.",
                          scores[0].pixels, scores[0].patches, scores[0].eyes, 100 * scores[0].not_drawn);
  t.columns = {"light", "median of a pixel", "over its own truth", "bias", "relative L2", "tracer's own noise, taken off"};
  const auto percent = [](const Figure& streamed, const Figure& full, const char* sign) {
    return fmt::format(fmt::runtime(fmt::format("{{:{}.2f}} % ({{:{}.2f}})", sign, sign)), 100 * streamed.value, 100 * full.value);
  };
  for (const SeenScore& s : scores)
    if (!s.note.empty()) t.rows.push_back({s.light, s.note, "", "", "", ""});
    else t.rows.push_back({s.light, percent(s.streamed.median, s.full_solve.median, ""), fmt::format("{:.2f} %", 100 * s.own_median), percent(s.streamed.energy, s.full_solve.energy, "+"),
                      percent(s.streamed.rel_l2, s.full_solve.rel_l2, ""), fmt::format("{:.2f} %", 100 * s.tracer_noise)});
  return t;
}

}  // namespace ff::chart
