#include "tools/chart/sweep/heat_picture.h"

#include <fmt/core.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <thread>

#include "tools/chart/sweep/comparison.h"
#include "tools/chart/sweep/running_cut.h"

namespace ff::chart {
namespace {

constexpr float kHalfHeight = 0.57735f;  // tan 30 degrees

struct Frame {
  Vec3 right, up, forward;
  explicit Frame(const Viewpoint& v) {
    forward = normalized(v.target - v.eye);
    const Vec3 vertical = std::abs(forward.y) > 0.99f ? Vec3{0, 0, 1} : Vec3{0, 1, 0};
    right = normalized(cross(forward, vertical));
    up = cross(right, forward);
  }
  Vec3 through(float x, float y, float aspect) const {  // -1..1, y upwards
    return normalized(forward + right * (x * kHalfHeight * aspect) + up * (y * kHalfHeight));
  }
};

// How much of a view is surface at a good distance: a share of its rays.
double worthOf(const PathTracer& tracer, const Viewpoint& view, float cell) {
  constexpr int kAcross = 16, kUp = 10;
  const Frame frame(view);
  double worth = 0;
  for (int y = 0; y < kUp; ++y)
    for (int x = 0; x < kAcross; ++x) {
      const auto s = tracer.sight(view.eye, frame.through((2 * static_cast<float>(x) + 1) / kAcross - 1,
                                                          (2 * static_cast<float>(y) + 1) / kUp - 1, 1.6f));
      if (s.patch == PathTracer::kNoPatch) continue;
      worth += s.distance_m < cell ? 0.3 : 1;  // a wall in one's face
    }
  return worth / (kAcross * kUp);
}

double lengthOf(const double* v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

// The difference of a patch's light from the traced, over the larger of its own and the mean; the tracer's noise is
// taken off.
double errorOf(const double* got, const PatchTruth& truth, double mean) {
  double difference[3], own[3], noise = 0;
  for (int c = 0; c < 3; ++c) {
    own[c] = static_cast<double>(truth.reflected[c]);
    difference[c] = got[c] - own[c];
    noise += static_cast<double>(truth.error[c]) * static_cast<double>(truth.error[c]);
  }
  const double squared = std::max(0.0, lengthOf(difference) * lengthOf(difference) - noise);
  return std::sqrt(squared) / std::max(lengthOf(own), mean);
}

struct Worst {
  size_t place = 0, light = 0;
  std::vector<uint32_t> patches{};  // looked at there, by error
  double rel_l2 = 0, mean = 0;      // mean: of the truth's lengths, W/m2
};

// What a picture of errors goes to: the first of these that no more than a twentieth of the samples exceeds.
float scaleFor(std::vector<float> seen) {
  std::erase_if(seen, [](float e) { return e < 0; });
  if (seen.empty()) return 1;
  const auto at = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() * 19 / 20);
  std::nth_element(seen.begin(), at, seen.end());
  for (const float scale : {0.05f, 0.1f, 0.2f, 0.5f})
    if (*at <= scale) return scale;
  return 1;
}

class PlaceErrors {
 public:
  PlaceErrors(MeasuredWorld& world, std::span<const Place> places, std::span<const Lighting> lights, const Knobs& knobs,
              RunningCut& cut)
      : world_(world), places_(places), lights_(lights), knobs_(knobs), cut_(cut) {}

  // Each place in its worst light, the worst first.
  Result<std::vector<Worst>> ranked(const TraceSettings& chosen) {
    std::vector<Worst> worst;
    for (size_t at = 0; at < places_.size(); ++at) {
      if (auto moved = cut_.moveTo(places_[at].observer); !moved) return moved.error();
      Worst here;
      bool any = false;
      for (size_t l = 0; l < lights_.size(); ++l) {
        if (!isSeen(places_, at, lights_[l])) continue;
        const auto w = judge(at, l, chosen);
        if (!w) return w.error();
        if (!std::isfinite(w->rel_l2) || (any && w->rel_l2 <= here.rel_l2)) continue;
        here = *w;
        any = true;
      }
      if (any) worst.push_back(here);
    }
    std::stable_sort(worst.begin(), worst.end(), [](const Worst& a, const Worst& b) { return a.rel_l2 > b.rel_l2; });
    return worst;
  }

  Result<Illustration> draw(const Worst& w, size_t number, const std::string& folder, const WorstPlaces& options) {
    const Place& place = places_[w.place];
    const Lighting& light = lights_[w.light];
    const auto lit = world_.lit(light, knobs_.shadow_rays, nullptr);
    if (!lit) return lit.error();
    const Viewpoint view = chooseView(w, place.observer);
    const SeenPatches seen = lookFrom(world_.tracer(), view);
    const std::vector<uint32_t> patches = seen.distinct();
    if (auto moved = cut_.moveTo(place.observer); !moved) return moved.error();
    const auto got = settledAt(**lit, patches);
    if (!got) return got.error();
    const TraceSettings trace{
        .paths = std::clamp(options.paths / std::max(1u, static_cast<uint32_t>(patches.size())) / kBatches * kBatches, 64u, 4096u),
        .seed = options.seed};
    const std::vector<PatchTruth> truth = world_.tracer().trace(patches, light, trace);

    std::vector<float> errors(world_.patches().size(), -1);
    std::vector<Vec3> radiosity(errors.size());
    for (size_t k = 0; k < patches.size(); ++k) {
      const double* mine = got->data() + 3 * k;
      if (!truth[k].buried) errors[patches[k]] = static_cast<float>(errorOf(mine, truth[k], w.mean));
      radiosity[patches[k]] = Vec3{static_cast<float>(mine[0]), static_cast<float>(mine[1]), static_cast<float>(mine[2])} +
                              (*lit)->lamps.emission(world_.patches()[patches[k]]);
    }
    double noise = 0, light_of_all = 0;
    for (const PatchTruth& t : truth)
      for (int c = 0; c < 3; ++c) {
        noise += static_cast<double>(t.error[c]) * static_cast<double>(t.error[c]);
        light_of_all += static_cast<double>(t.reflected[c]) * static_cast<double>(t.reflected[c]);
      }
    std::vector<float> shown;
    for (const uint32_t p : seen.patch) shown.push_back(p == PathTracer::kNoPatch ? -1 : errors[p]);
    const float scale = scaleFor(shown);
    const std::string title = fmt::format("{}: error of a patch", light.name);
    Illustration picture;
    picture.file = fmt::format("worst-{}.png", number);
    picture.title = fmt::format("Worst place {}: {}, error {:.1f} %", number, light.name, 100 * w.rel_l2);
    picture.note = fmt::format(
        "Around the observer at ({:.1f}, {:.1f}, {:.1f}). Left: the error of each patch against {} paths of its own (their "
        "noise: {:.0f} %), over the larger of its light and the place's mean; grey is the sky, or a back. Right: the light "
        "itself.",
        static_cast<double>(place.observer.x), static_cast<double>(place.observer.y), static_cast<double>(place.observer.z),
        trace.paths, light_of_all > 0 ? 100 * std::sqrt(noise / light_of_all) : 0.0);
    const auto written = view::writePng(sideBySide(heatOf(seen, errors, scale, title), litOf(seen, radiosity, light.sky)),
                                        (std::filesystem::path(folder) / picture.file).string());
    if (!written) return written.error();
    return picture;
  }

 private:
  Result<std::vector<double>> settledAt(const LitWorld& lit, std::span<const uint32_t> patches) {
    if (auto set = cut_.setLight(lit); !set) return set.error();
    if (auto settled = cut_.settle(); !settled) return settled.error();
    return cut_.reflected(lit, patches);
  }

  // Of the worst patch that can be looked at from where surface fills most of the picture.
  Viewpoint chooseView(const Worst& w, Vec3 observer) const {
    Viewpoint best{observer, observer + Vec3{1, 0, 0}};
    double most = 0;
    for (size_t i = 0; i < std::min<size_t>(16, w.patches.size()); ++i) {
      const Viewpoint view = viewpointOf(world_, w.patches[i], observer);
      const double worth = worthOf(world_.tracer(), view, world_.world().info().cell_m);
      if (worth > most) most = worth, best = view;
      if (worth > 0.6) break;
    }
    return best;
  }

  Result<Worst> judge(size_t at, size_t l, const TraceSettings& chosen) {
    const auto lit = world_.lit(lights_[l], knobs_.shadow_rays, &chosen);
    if (!lit) return lit.error();
    const std::vector<uint32_t>& numbers = world_.ofPlace(at);
    const std::vector<uint32_t> patches = world_.patchesOf(at);
    const auto got = settledAt(**lit, patches);
    if (!got) return got.error();
    Comparison comparison;
    comparison.addPlace(world_, **lit, numbers, *got);
    Worst w{at, l, {}, comparison.accuracy("").rel_l2.value, 0};
    double counted = 0;
    for (const uint32_t n : numbers) {
      const PatchTruth& t = (*lit)->traced[n];
      if (t.buried) continue;
      w.mean += static_cast<double>(length(t.reflected));
      ++counted;
    }
    w.mean = counted > 0 ? w.mean / counted : 0;
    // By area as well: a crumb's error is hard to see.
    std::vector<std::pair<double, uint32_t>> by_error;
    for (size_t k = 0; k < numbers.size(); ++k) {
      const PatchTruth& t = (*lit)->traced[numbers[k]];
      if (t.buried) continue;
      const auto area = static_cast<double>(world_.patches()[patches[k]].area_m2);
      by_error.emplace_back(-errorOf(got->data() + 3 * k, t, w.mean) * std::sqrt(area), patches[k]);
    }
    std::sort(by_error.begin(), by_error.end());
    for (const auto& [error, patch] : by_error) w.patches.push_back(patch);
    return w;
  }

  MeasuredWorld& world_;
  std::span<const Place> places_;
  std::span<const Lighting> lights_;
  const Knobs& knobs_;
  RunningCut& cut_;
};

}  // namespace

std::vector<uint32_t> SeenPatches::distinct() const {
  std::vector<uint32_t> all = patch;
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  if (!all.empty() && all.back() == PathTracer::kNoPatch) all.pop_back();
  return all;
}

SeenPatches lookFrom(const PathTracer& tracer, const Viewpoint& view, uint32_t width, uint32_t height, uint32_t samples) {
  SeenPatches seen{width, height, samples, {}, {}};
  const uint32_t across = width * samples, down = height * samples;
  seen.patch.resize(size_t{across} * down);
  seen.direction.resize(seen.patch.size());
  const Frame frame(view);
  const float aspect = static_cast<float>(width) / static_cast<float>(height);
  std::atomic<uint32_t> next{0};
  const auto run = [&] {
    for (uint32_t y = next++; y < down; y = next++)
      for (uint32_t x = 0; x < across; ++x) {
        const size_t i = size_t{y} * across + x;
        seen.direction[i] = frame.through((2 * static_cast<float>(x) + 1) / static_cast<float>(across) - 1,
                                          1 - (2 * static_cast<float>(y) + 1) / static_cast<float>(down), aspect);
        seen.patch[i] = tracer.patchSeen(view.eye, seen.direction[i]);
      }
  };
  std::vector<std::jthread> others;
  for (unsigned k = 1; k < std::thread::hardware_concurrency(); ++k) others.emplace_back(run);
  run();
  others.clear();
  return seen;
}

Viewpoint viewpointOf(const MeasuredWorld& world, uint32_t patch, Vec3 fallback) {
  constexpr int kAround = 12;
  constexpr float kCells = 12;
  const formats::Node& node = world.patches()[patch];
  const float cell = world.world().info().cell_m;
  const Vec3 n = node.normal, c = node.centroid;
  const Vec3 other = std::abs(n.y) > 0.7f ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const Vec3 t = normalized(cross(n, other)), b = cross(n, t);
  Viewpoint best{fallback, c};
  double most = 0;
  for (const float slant : {0.0f, 0.7f, 1.2f, 2.0f})  // of the tangent
    for (int i = 0; i < (slant > 0 ? kAround : 1); ++i) {
      const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / kAround;
      const Vec3 w = normalized(n + (t * std::cos(angle) + b * std::sin(angle)) * slant);
      const Vec3 start = c + n * (0.02f * cell);
      const float free = world.tracer().sight(start, w).distance_m;
      const float distance = std::min(kCells * cell, 0.85f * free);
      if (!(distance > 0.5f * cell)) continue;
      const Viewpoint view{start + w * distance, c};
      if (world.tracer().patchSeen(view.eye, normalized(c - view.eye)) != patch) continue;
      // Farther is better; straight down or up is how nobody looks.
      const double steep = std::max(0.0, std::abs(static_cast<double>(w.y)) - 0.5);
      const double worth = worthOf(world.tracer(), view, cell) *
                           std::sqrt(static_cast<double>(distance / (kCells * cell))) * (1 - steep);
      if (worth > most) most = worth, best = view;
    }
  return best;
}

view::Picture heatOf(const SeenPatches& seen, std::span<const float> errors, float full_scale, const std::string& title) {
  std::vector<float> shown;
  shown.reserve(seen.patch.size());
  for (const uint32_t p : seen.patch) shown.push_back(p == PathTracer::kNoPatch ? -1 : errors[p]);
  return view::heatMap(shown, seen.width, seen.height, seen.samples, full_scale, title);
}

view::Picture litOf(const SeenPatches& seen, std::span<const Vec3> radiosity, const runtime::Sky& sky) {
  std::vector<runtime::Vec4> shown;
  shown.reserve(seen.patch.size());
  for (size_t i = 0; i < seen.patch.size(); ++i) {
    const uint32_t p = seen.patch[i];
    const Vec3 w = seen.direction[i];
    const Vec3 b = p != PathTracer::kNoPatch
                       ? radiosity[p]
                       : max(runtime::skyRadiance(sky, w) * std::numbers::pi_v<float>, {});
    shown.push_back({b.x, b.y, b.z, p != PathTracer::kNoPatch ? 1.0f : 0.0f});
  }
  return view::toneMapped(shown, seen.width, seen.height, seen.samples, std::exp2(view::exposureStops(shown)));
}

view::Picture sideBySide(const view::Picture& left, const view::Picture& right) {
  FF_CHECK_EQ(left.height, right.height);
  view::Picture both{left.width + right.width, left.height, {}};
  both.rgb.reserve(left.rgb.size() + right.rgb.size());
  for (uint32_t y = 0; y < both.height; ++y)
    for (const view::Picture* p : {&left, &right}) {
      const auto row = p->rgb.begin() + std::ptrdiff_t{3} * p->width * y;
      both.rgb.insert(both.rgb.end(), row, row + std::ptrdiff_t{3} * p->width);
    }
  return both;
}

Result<std::vector<Illustration>> worstPlaces(MeasuredWorld& world, std::span<const Place> places,
                                              std::span<const Lighting> lights, const Knobs& knobs,
                                              const TraceSettings& chosen, const std::string& folder,
                                              const WorstPlaces& options) {
  if (places.size() != world.placesLookedAt())
    return Error{ErrorCode::kUsage, world.world().path(), "", "the places are not those that the world looks at", ""};
  auto cut = RunningCut::create(world, knobs);
  if (!cut) return cut.error();
  PlaceErrors errors(world, places, lights, knobs, *cut);
  const auto ranked = errors.ranked(chosen);
  if (!ranked) return ranked.error();
  std::vector<Illustration> pictures;
  for (size_t i = 0; i < std::min(options.most, ranked->size()); ++i) {
    auto drawn = errors.draw((*ranked)[i], i + 1, folder, options);
    if (!drawn) return drawn.error();
    pictures.push_back(std::move(*drawn));
  }
  return pictures;
}

}  // namespace ff::chart
