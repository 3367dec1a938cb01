#include "bake/light/sky_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bake/rays/cosine_rays.h"

namespace ff::bake {
namespace {

constexpr double kEnough = 0.25;        // of the looking rays that see the sky: then the row's own rays are enough
constexpr uint32_t kGuidedShare = 4;    // of a row's rays: so many are guided
constexpr float kNeighbourCells = 4;
constexpr float kBeside = 0.25f;        // a bin around gets this much of what the one in the middle gets
constexpr float kBinRadians = 0.04f;    // about the width of a bin
constexpr int kMaxBeside = 4;          // bins
constexpr size_t kGuidingRays = 1000;   // of a neighbourhood, at most: evenly taken of all
constexpr float kHorizon = -0.1f;       // cosine
constexpr uint64_t kSeed = 0x736b7921;

// The octahedral map: Quirin Meyer et al. On floating-point normal vectors. 2010. x and y in [-1, 1].
std::array<float, 2> folded(Vec3 d) {
  const float sum = std::abs(d.x) + std::abs(d.y) + std::abs(d.z);
  const float x = d.x / sum, y = d.y / sum;
  if (d.z >= 0) return {x, y};
  return {std::copysign(1 - std::abs(y), x), std::copysign(1 - std::abs(x), y)};
}

Vec3 unfolded(float x, float y) {
  const float z = 1 - std::abs(x) - std::abs(y);
  if (z >= 0) return normalized({x, y, z});
  return normalized({std::copysign(1 - std::abs(y), x), std::copysign(1 - std::abs(x), y), z});
}

uint32_t binOf(float x, uint32_t bins = SkyGuide::kBins) {
  const auto n = static_cast<float>(bins);
  return static_cast<uint32_t>(std::clamp((x + 1) * 0.5f * n, 0.0f, n - 1));
}

// Any point of a bin.
float placeIn(uint32_t bin, float at) { return 2 * (static_cast<float>(bin) + at) / static_cast<float>(SkyGuide::kBins) - 1; }

}  // namespace

void SkySums::add(Vec3 direction, double weight) {
  const auto x = static_cast<double>(direction.x), y = static_cast<double>(direction.y), z = static_cast<double>(direction.z);
  const double terms[8] = {x, y, z, 2 * x * y, 2 * y * z, 2 * z * x, (3 * y * y - 1) / 2, x * x - z * z};
  weight_ += weight;
  for (size_t k = 0; k < 8; ++k) sums_[k] += weight * terms[k];
}

void SkySums::add(const SkyMeans& means, double weight) {
  weight_ += weight;
  for (size_t k = 0; k < 3; ++k) sums_[k] += weight * static_cast<double>(means.direction[static_cast<int>(k)]);
  for (size_t k = 0; k < 5; ++k) sums_[3 + k] += weight * static_cast<double>(means.quadratic[k]);
}

SkyMeans SkySums::means() const {
  SkyMeans m;
  if (!(weight_ > 0)) return m;
  for (size_t k = 0; k < 3; ++k) m.direction[static_cast<int>(k)] = static_cast<float>(sums_[k] / weight_);
  for (size_t k = 0; k < 5; ++k) m.quadratic[k] = static_cast<float>(sums_[3 + k] / weight_);
  return m;
}

void SightMap::clear() {
  std::fill(count_.begin(), count_.end(), 0u);
  std::fill(inverse_.begin(), inverse_.end(), 0.0f);
}

void SightMap::add(Vec3 direction, float distance_m) {
  const auto at = folded(direction);
  const size_t cell = binOf(at[1], kCells) * kCells + binOf(at[0], kCells);
  ++count_[cell];
  inverse_[cell] += 1 / std::max(distance_m, 1e-6f);
}

float SightMap::around(Vec3 direction) const {
  const auto at = folded(direction);
  const uint32_t x = binOf(at[0], kCells), y = binOf(at[1], kCells);
  float inverse = 0;
  uint32_t count = 0;
  for (uint32_t j = y > 0 ? y - 1 : 0; j <= std::min(y + 1, kCells - 1); ++j)
    for (uint32_t i = x > 0 ? x - 1 : 0; i <= std::min(x + 1, kCells - 1); ++i) {
      count += count_[j * kCells + i];
      inverse += inverse_[j * kCells + i];
    }
  return count > 0 ? static_cast<float>(count) / inverse : std::numeric_limits<float>::infinity();
}

void SkyGuide::clear() {
  std::fill(weight_.begin(), weight_.end(), 0.0f);
  bins_.clear();
  cumulative_.clear();
}

void SkyGuide::add(Vec3 direction, float radius) {
  const auto at = folded(direction);
  const auto x = static_cast<int>(binOf(at[0])), y = static_cast<int>(binOf(at[1])), n = static_cast<int>(kBins);
  const int reach = std::clamp(static_cast<int>(std::ceil(radius / kBinRadians)), 1, kMaxBeside);
  const auto bins = static_cast<float>(reach * reach);
  const int x0 = std::max(0, x - reach), x1 = std::min(n - 1, x + reach), y0 = std::max(0, y - reach), y1 = std::min(n - 1, y + reach);
  const size_t middle = static_cast<size_t>(y * n + x);
  const float before = weight_[middle];
  for (int j = y0; j <= y1; ++j)
    for (int i = x0; i <= x1; ++i) weight_[static_cast<size_t>(j * n + i)] += kBeside / bins;
  weight_[middle] = before + 1 / bins;
}

void SkyGuide::close(Vec3 up) {
  static const std::vector<Vec3> middle = [] {
    std::vector<Vec3> of;
    for (uint32_t b = 0; b < kBins * kBins; ++b) of.push_back(unfolded(placeIn(b % kBins, 0.5f), placeIn(b / kBins, 0.5f)));
    return of;
  }();
  double sum = 0;
  for (uint32_t b = 0; b < kBins * kBins; ++b) {
    if (!(weight_[b] > 0)) continue;
    if (dot(middle[b], up) < kHorizon) {
      weight_[b] = 0;
      continue;
    }
    bins_.push_back(b);
    cumulative_.push_back(sum += static_cast<double>(weight_[b]));
  }
}

Vec3 SkyGuide::direction(double choice, float u, float v) const {
  const auto found = std::min(std::upper_bound(cumulative_.begin(), cumulative_.end(), choice * cumulative_.back()), cumulative_.end() - 1);
  const uint32_t bin = bins_[static_cast<size_t>(found - cumulative_.begin())];
  // Off the bin's border by more than rounding, which could put it into a bin without a weight.
  const auto inside = [](float at) { return std::clamp(at, 1e-4f, 1 - 1e-4f); };
  return unfolded(placeIn(bin % kBins, inside(u)), placeIn(bin / kBins, inside(v)));
}

// An area dx dy of the map spans dx dy / |p|^3 steradians, where p = direction / (|x| + |y| + |z|) is the point on the octahedron.
double SkyGuide::density(Vec3 d) const {
  const auto at = folded(d);
  const double weight = static_cast<double>(weight_[binOf(at[1]) * kBins + binOf(at[0])]);
  const double sum = static_cast<double>(std::abs(d.x) + std::abs(d.y) + std::abs(d.z));
  return weight / cumulative_.back() * (kBins * kBins / 4.0) / (sum * sum * sum);
}

std::vector<SkySums> skyOf(const Scene& scene, const PatchSet& set, const RayCaster& caster, const SobolTable& sobol, uint64_t seed,
                           uint32_t first, std::span<SkyRays> found, uint32_t rays) {
  std::vector<SkySums> sky(found.size());
  SkyGuide guide;
  std::vector<SurfacePoint> points;
  std::vector<const SkyRays::Ray*> passed;
  std::vector<SightLine> ways;    // that are guided
  std::vector<float> cosines;  // of them, at the surface
  const uint32_t looking = lookingRays(rays), main = rays - looking, guided = rays / kGuidedShare;
  const auto isEnough = [&](const SkyRays& of) { return guided == 0 || static_cast<double>(of.look.size()) > kEnough * looking; };
  if (!std::all_of(found.begin(), found.end(), isEnough))
    for (SkyRays& of : found)
      for (auto* reached : {&of.look, &of.main})
        for (SkyRays::Ray& ray : *reached) ray.opening_m = of.sight.around(ray.direction);
  for (uint32_t i = 0; i < found.size(); ++i) {
    const Patch& patch = set.patches[first + i];
    const bool enough = isEnough(found[i]);
    const float radius = 0.5f * length(patch.bounds.hi - patch.bounds.lo);
    guide.clear();
    if (!enough) {
      passed.clear();
      for (uint32_t j = 0; j < found.size(); ++j) {
        if (length(set.patches[first + j].centroid - patch.centroid) > kNeighbourCells * set.cell_m) continue;
        for (const auto* rays_of : {&found[j].look, &found[j].main}) {
          if (j == i && rays_of == &found[j].main) continue;  // those are counted below
          for (const SkyRays::Ray& ray : *rays_of) passed.push_back(&ray);
        }
      }
      for (size_t k = 0; k < passed.size(); k += 1 + passed.size() / kGuidingRays) {
        const SkyRays::Ray& ray = *passed[k];
        const bool far = !std::isfinite(ray.opening_m);
        const Vec3 way = far ? ray.direction : ray.origin + ray.direction * ray.opening_m - patch.centroid;
        const float distance = length(way);
        if (distance > 0) guide.add(way / distance, far ? 0 : radius / distance);
      }
    }
    guide.close(patch.normal);
    if (guide.empty()) {  // all of the row's rays, or none that it could do better with
      const double weight = 1.0 / (enough ? rays : main);
      if (enough)
        for (const SkyRays::Ray& ray : found[i].look) sky[i].add(ray.direction, weight);
      for (const SkyRays::Ray& ray : found[i].main) sky[i].add(ray.direction, weight);
      continue;
    }
    for (const SkyRays::Ray& ray : found[i].main) {
      const double own = main * static_cast<double>(ray.cosine) * std::numbers::inv_pi;
      if (own > 0) sky[i].add(ray.direction, powerWeight(own, guided * guide.density(ray.direction)) / main);
    }
    points.resize(guided);
    surfacePoints(scene, set, first + i, sobol, seed ^ kSeed, caster, points);
    const double offset = unitOf(mix64(seed ^ kSeed) + patch.name);
    ways.clear();
    cosines.clear();
    for (uint32_t k = 0; k < guided; ++k) {
      const Vec3 direction = guide.direction((k + offset) / guided, points[k].u, points[k].v);
      const float cosine = dot(direction, points[k].normal);
      if (!(cosine > 0)) continue;
      ways.push_back({{points[k].position, direction}, std::numeric_limits<float>::infinity()});
      cosines.push_back(cosine);
    }
    caster.occlude(ways);
    for (size_t k = 0; k < ways.size(); ++k) {
      if (ways[k].occluded) continue;
      const Vec3 direction = ways[k].ray.direction;
      const double row = static_cast<double>(cosines[k]) * std::numbers::inv_pi, own = guided * guide.density(direction);
      sky[i].add(direction, row * powerWeight(own, main * row) / own);
    }
  }
  return sky;
}

}  // namespace ff::bake
