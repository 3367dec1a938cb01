#include "bake/light/lamp_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "bake/rays/surface_sampling.h"

namespace ff::bake {
namespace {

// Of a row's rays: those that look around, and the least that are cast towards lamps.
constexpr uint32_t kLookShare = 32, kLeastShare = 16, kLeastLampRays = 16;
constexpr double kError = 0.02;  // relative, of a patch's light of lamps: more rays until then
// What is known of an aim before a ray was sent there: that it is seen by this much, with the weight of one ray.
constexpr double kSeenBefore = 0.25;

// Seeds of their own, so that these points have nothing to do with the row's.
constexpr uint64_t kLookSeed = 0x6c6f6f6b, kCastSeed = 0x63617374;

double luminance(Vec3 c) {
  return 0.2126 * static_cast<double>(c.x) + 0.7152 * static_cast<double>(c.y) + 0.0722 * static_cast<double>(c.z);
}

}  // namespace

LampIrradiance& entryOf(std::vector<LampIrradiance>& lamps, uint16_t group) {
  const auto at = std::lower_bound(lamps.begin(), lamps.end(), group, [](const LampIrradiance& l, uint16_t g) { return l.group < g; });
  return at != lamps.end() && at->group == group ? *at : *lamps.insert(at, {group, {}});
}

LampLight::LampLight(const Scene& scene, const PatchSet& set, const RayCaster& caster, const LampTree& tree, uint32_t most_rays,
                     uint64_t seed)
    : scene_(scene), set_(set), caster_(caster), tree_(tree), seed_(seed), sobol_(std::max(most_rays, kLeastLampRays)), aim_of_node_(tree.nodes()) {}

void LampLight::aim(uint32_t patch, uint32_t rays) {
  patch_ = patch;
  row_rays_ = rays;
  max_rays_ = std::max(rays, kLeastLampRays);
  count_ = 0;
  light_.clear();
  tree_.aimsOf(receiverOf(set_, patch), aims_);
  chance_.clear();
  if (aims_.empty()) return;
  double all = 0;
  for (const LampTree::Aim& a : aims_) all += static_cast<double>(a.importance);
  const auto setChances = [&] {
    cumulative_.resize(aims_.size());
    double sum = 0;
    for (size_t a = 0; a < aims_.size(); ++a) cumulative_[a] = sum += chance_[a];
  };
  for (size_t a = 0; a < aims_.size(); ++a) {
    chance_.push_back(static_cast<double>(aims_[a].importance) / all);
    aim_of_node_[aims_[a].node] = static_cast<uint32_t>(a);
  }
  setChances();

  points_.resize(std::max(kLeastLampRays, max_rays_ / kLookShare));
  surfacePoints(scene_, set_, patch, sobol_, seed_ ^ kLookSeed, caster_, points_);
  std::vector<double> seen(aims_.size(), kSeenBefore), cast(aims_.size(), 1), square(aims_.size());
  double mean = 0;
  castTowards(0.5);
  for (const Sample& s : samples_) {
    cast[s.aim] += 1;
    if (!(s.arriving > 0)) continue;
    seen[s.aim] += 1;
    const double light = luminance(tree_.emission(s.to.leaf)) * s.arriving / s.density;
    mean += light;
    square[s.aim] += light * light;
  }
  const auto n = static_cast<double>(points_.size());
  mean /= n;
  all = 0;
  for (size_t a = 0; a < aims_.size(); ++a) all += chance_[a] * seen[a] / cast[a];
  double second = 0;  // moment, of a ray's light by the chances from now on
  for (size_t a = 0; a < aims_.size(); ++a) {
    const double change = seen[a] / cast[a] / all;
    chance_[a] *= change;
    second += square[a] / n / change;
  }
  setChances();
  const double wanted = mean > 0 ? std::max(0.0, second / (mean * mean) - 1) / (kError * kError) : 0;
  count_ = std::max({kLeastLampRays, max_rays_ / kLeastShare, static_cast<uint32_t>(std::min<double>(max_rays_, wanted))});
}

LampTree::Choice LampLight::choose(double choice, size_t& aim) const {
  const double x = choice * cumulative_.back();
  const auto found = std::min(std::upper_bound(cumulative_.begin(), cumulative_.end(), x), cumulative_.end() - 1);
  aim = static_cast<size_t>(found - cumulative_.begin());
  const double before = aim > 0 ? cumulative_[aim - 1] : 0;
  return tree_.choose(aims_[aim].node, chance_[aim] > 0 ? std::clamp((x - before) / chance_[aim], 0.0, 0x1.fffffep-1) : 0.5);
}

LampLight::Sample LampLight::sample(const SurfacePoint& from, size_t aim, const LampTree::Choice& choice) const {
  Sample s;
  s.aim = aim;
  s.to = tree_.point(choice, from.u, from.v);
  const Vec3 way = s.to.position - from.position;
  const double square = static_cast<double>(dot(way, way)), distance = std::sqrt(square);
  if (!(distance > 0)) return s;
  const double leaving = -static_cast<double>(dot(s.to.normal, way)) / distance;
  if (!(leaving > 0)) return s;
  s.arriving = std::max(0.0, static_cast<double>(dot(from.normal, way)) / distance);
  s.density = chance_[aim] * tree_.density(aims_[aim].node, s.to.leaf) * square / leaving;
  return s;
}

void LampLight::castTowards(double offset) {
  samples_.clear();
  ways_.clear();
  way_to_.clear();
  constexpr size_t kAtOnce = 16;
  std::array<LampTree::Choice, kAtOnce> choices;
  std::array<size_t, kAtOnce> aims;
  for (size_t k = 0; k < points_.size(); ++k) {
    if (k % kAtOnce == 0) {
      const size_t end = std::min(kAtOnce, points_.size() - k);
      for (size_t i = 0; i < end; ++i) choices[i] = choose((static_cast<double>(k + i) + offset) / static_cast<double>(points_.size()), aims[i]);
      for (size_t i = 0; i < end; ++i) tree_.fetch(choices[i]);
    }
    const SurfacePoint& from = points_[k];
    Sample& s = samples_.emplace_back(sample(from, aims[k % kAtOnce], choices[k % kAtOnce]));
    if (!(s.arriving > 0)) continue;
    const LampTree::Point& to = s.to;
    bool hole = false;  // points are spread over the whole, holes included
    if (to.cutout) {
      const auto [b, c] = barycentric(scene_, to.triangle, to.position);
      hole = isHole(scene_, to.triangle, b, c);
    }
    const Vec3 end = to.position + to.normal * to.offset_m, way = end - from.position;
    const float distance = length(way);
    if (hole || !(distance > 0)) {
      s.arriving = 0;
      continue;
    }
    ways_.push_back({{from.position, way / distance}, distance});
    way_to_.push_back(k);
  }
  caster_.occlude(ways_);
  for (size_t w = 0; w < ways_.size(); ++w)
    if (ways_[w].occluded) samples_[way_to_[w]].arriving = 0;
}

void LampLight::add(uint32_t leaf, double weight) {
  LampIrradiance& light = entryOf(light_, tree_.group(leaf));
  const Vec3 emission = tree_.emission(leaf);
  for (int c = 0; c < 3; ++c) light.rgb[static_cast<size_t>(c)] += weight * static_cast<double>(emission[c]);
}

// With p the density of the row's rays (cosine / pi) and q that of rays towards lamps, both per steradian, N and K their numbers,
// and P = N p, Q = K q: a ray of the row that arrives counts with the weight P^2 / (P^2 + Q^2), one towards a lamp with
// Q^2 / (P^2 + Q^2), the power heuristic; and stands for p / P or p / Q of the emission.
void LampLight::hit(uint32_t emitter, const Hit& hit, const Ray& ray, float cosine) {
  const uint32_t leaf = tree_.leafOf(emitter);
  if (leaf == kNone) return;
  double density = 0;
  for (uint32_t node = leaf; node != kNone; node = tree_.parent(node)) {
    const uint32_t a = aim_of_node_[node];
    if (a >= aims_.size() || aims_[a].node != node) continue;
    const auto& v = scene_.triangles[hit.triangle].v;
    const Vec3 corner = scene_.positions[v[0]];
    const Vec3 normal = normalized(cross(scene_.positions[v[1]] - corner, scene_.positions[v[2]] - corner)) * (hit.front ? 1.0f : -1.0f);
    const Vec3 way = hit.point - ray.origin;
    const double leaving = -static_cast<double>(dot(normal, ray.direction));
    if (leaving > 0) density = chance_[a] * tree_.density(node, leaf) * static_cast<double>(dot(way, way)) / leaving;
    break;
  }
  const double own = static_cast<double>(cosine) * std::numbers::inv_pi;
  if (own > 0) add(leaf, powerWeight(row_rays_ * own, count_ * density) / row_rays_);
}

std::vector<LampIrradiance> LampLight::finish() {
  points_.resize(count_);
  if (count_ > 0) surfacePoints(scene_, set_, patch_, sobol_, seed_ ^ kCastSeed, caster_, points_);
  castTowards(unitOf(mix64(seed_ ^ kCastSeed) + set_.patches[patch_].name));
  for (const Sample& s : samples_) {
    if (!(s.arriving > 0)) continue;
    const double own = s.arriving * std::numbers::inv_pi;
    add(s.to.leaf, own * powerWeight(count_ * s.density, row_rays_ * own) / (count_ * s.density));
  }
  return light_;
}

}  // namespace ff::bake
