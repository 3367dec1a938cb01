#include "runtime/probes/probes.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <tuple>
#include <utility>

namespace ff::runtime {
namespace {

constexpr float kPi = 3.14159265358979f;
constexpr size_t kWays = 8;  // of the table of kept probes
constexpr formats::TileId kFree{~0u, ~0u};

// Directions around +z by the cosine: the Hammersley set on a disc, lifted. Shirley and Chiu. A Low Distortion Map
// between Disk and Square. 1997. Malley's method (Pharr et al. Physically Based Rendering. 2016, 13.6.3).
std::vector<Vec3> cosineRays(uint32_t count) {
  std::vector<Vec3> rays;
  for (uint32_t i = 0; i < count; ++i) {
    uint32_t reversed = 0;
    for (uint32_t bit = 0; bit < 32; ++bit) reversed |= (i >> bit & 1) << (31 - bit);
    const float a = 2 * (static_cast<float>(i) + 0.5f) / static_cast<float>(count) - 1;
    const float b = 2 * static_cast<float>(reversed >> 8) * 0x1p-24f - 1 + 1 / static_cast<float>(count);
    const bool wide = std::abs(a) > std::abs(b);
    const float r = wide ? a : b;
    const float angle = r == 0 ? 0 : wide ? kPi / 4 * (b / a) : kPi / 2 - kPi / 4 * (a / b);
    const float x = r * std::cos(angle), y = r * std::sin(angle);
    rays.push_back({x, y, std::sqrt(std::max(0.0f, 1 - x * x - y * y))});
  }
  return rays;
}

Vec3 facetNormal(const Facet& f) { return normalized(cross(f.to_second, f.to_third)); }
float luminance(Vec3 c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }  // Rec. ITU-R BT.709
float areaOf(const Facet& f) { return 0.5f * length(cross(f.to_second, f.to_third)); }

// Weights of the corners of a triangle at the k-th of `points` points: one in its middle, or about those of a rule that integrates polynomials of degree 4.
// D. A. Dunavant. High degree efficient symmetrical Gaussian quadrature rules for the triangle. 1985.
std::array<float, 3> pointOfTriangle(uint32_t k, uint32_t points) {
  if (points == 1) return {1 / 3.0f, 1 / 3.0f, 1 / 3.0f};
  const bool at_corner = k % 6 < 3;
  const float own = points <= 3 ? 2 / 3.0f : at_corner ? 0.816848f : 0.108103f;
  std::array<float, 3> at;
  at.fill((1 - own) / 2);
  at[k % 3] = own;
  return at;
}

bool isFinite(Vec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

// Of unit length, whatever its own; zero: it has none. A unit vector stays as it is, so that it is found again.
Vec3 direction(Vec3 v) {
  const float largest = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
  if (!isFinite(v) || largest == 0) return {};
  if (std::abs(dot(v, v) - 1) < 1e-6f) return v;
  const Vec3 scaled = v / largest;  // its square neither overflows nor vanishes
  return scaled / std::sqrt(dot(scaled, scaled));
}

}  // namespace

Probes::Probes(const formats::World& world, const SlotMap& slots, const ProbeSettings& settings)
    : world_(world),
      slots_(slots),
      settings_(settings),
      tree_(world, slots.maxSlots()),
      rays_(cosineRays(std::clamp(settings.rays, 1u, 65535u))),
      tile_of_slot_(slots.maxSlots(), kFree),
      hidden_(slots.maxSlots()),
      seen_(slots.maxSlots()),
      changed_(slots.maxSlots()),
      kept_((std::max(settings.max_kept, 1u) + kWays - 1) / kWays * kWays),
      max_places_(rays_.size() + settings.max_lamps),
      lamp_of_slot_(slots.maxSlots()),
      aim_of_slot_(slots.maxSlots()),
      facets_(world, settings.facet_bytes) {
  places_.resize(kept_.size() * max_places_);
  met_.reserve(rays_.size() + size_t{settings.max_lamps} * settings.lamp_rays);
  lamps_.reserve(slots.maxSlots());
  aims_.reserve(settings.max_lamps);
}

void Probes::follow(const stream::Observers& observers, std::span<const ProbeTile> tiles, std::span<const uint8_t> leaf, uint64_t cut) {
  facets_.moveTo(observers);
  const bool fresh = facets_.update();
  if (fresh) ++state_;
  if (fresh || cut != cut_) hideCovered();
  if (cut == cut_) return;
  cut_ = cut;
  ++state_;
  ++follows_;
  for (const ProbeTile& tile : tiles) enter(tile, leaf);
  for (uint32_t slot = 0; slot < tile_of_slot_.size(); ++slot)
    if (tile_of_slot_[slot] != kFree && seen_[slot] != follows_) leave(slot);
}

void Probes::enter(const ProbeTile& tile, std::span<const uint8_t> leaf) {
  for (uint32_t i = 0; i < tile.nodes.size(); ++i) {
    const uint32_t slot = tile.first_slot + i;
    seen_[slot] = follows_;
    if (tile_of_slot_[slot] != tile.id) {
      leave(slot);
      tile_of_slot_[slot] = tile.id;
      changed_[slot] = state_;
      if (tile.id.level == 0) addLamp(slot, i, tile.nodes[i]);
    }
    if (!leaf[slot])
      tree_.remove(slot);
    else if (!tree_.holds(slot))
      tree_.insert(slot, tile.id.level, tile.nodes[i]);
  }
}

void Probes::leave(uint32_t slot) {
  tree_.remove(slot);
  removeLamp(slot);
  changed_[slot] = state_;
  tile_of_slot_[slot] = kFree;
}

void Probes::addLamp(uint32_t slot, uint32_t index, const formats::Node& node) {
  const float power = node.area_m2 * luminance(node.emission);
  if (!(power > 0)) return;
  lamps_.push_back({slot, index, node.centroid, node.normal, node.area_m2, power});
  lamp_of_slot_[slot] = static_cast<uint32_t>(lamps_.size());
}

void Probes::removeLamp(uint32_t slot) {
  const uint32_t number = std::exchange(lamp_of_slot_[slot], 0u);
  if (number == 0) return;
  lamps_[number - 1u] = lamps_.back();
  lamps_.pop_back();
  if (number <= lamps_.size()) lamp_of_slot_[lamps_[number - 1u].slot] = number;
}

void Probes::settle() {
  facets_.settle();
  hideCovered();
  ++state_;
}

void Probes::hideCovered() {
  const FacetScene* const facets = facets_.scene();
  std::ranges::fill(hidden_, uint8_t{0});
  if (!facets || facets->complete) return;
  for (const SlotRange& tile : slots_.tiles())
    if (facets->covered.contains(tile.id)) std::fill_n(hidden_.begin() + tile.first_slot, tile.nodes, uint8_t{1});
}

size_t Probes::find(Vec3 point, Vec3 normal) const {
  uint64_t h = 0;
  for (const float x : {point.x, point.y, point.z, normal.x, normal.y, normal.z})
    h = (h ^ std::bit_cast<uint32_t>(x)) * 0x9e3779b97f4a7c15ull, h ^= h >> 29;
  const size_t first = static_cast<size_t>(h % (kept_.size() / kWays)) * kWays;
  size_t oldest = first;
  for (size_t i = first; i < first + kWays; ++i) {
    if (kept_[i].state != 0 && kept_[i].point == point && kept_[i].normal == normal) return i;
    if (kept_[i].used < kept_[oldest].used) oldest = i;
  }
  return oldest;
}

// Whether every slot that the probe met still stands for what it stood for then. One that has been refined since does:
// its radiosity is the mean of its children's.
bool Probes::standsStill(size_t kept) const {
  const Place* const places = &places_[kept * max_places_];
  for (uint32_t i = 0; i < kept_[kept].places; ++i)
    if (changed_[places[i].slot] > kept_[kept].state) return false;
  return true;
}

void Probes::sample(std::span<const Vec3> points, std::span<const Vec3> normals, std::span<const Vec4> radiosity,
                    const Sky& sky, std::span<Vec3> irradiance) {
  ++samples_;
  uint32_t refreshed = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    const Vec3 normal = direction(normals[i]);
    if (!isFinite(points[i]) || normal == Vec3{}) {
      ++stats_.refused;
      irradiance[i] = {};
      continue;
    }
    const size_t at = find(points[i], normal);
    Kept& kept = kept_[at];
    const bool known = kept.state != 0 && kept.point == points[i] && kept.normal == normal;
    const bool usable = known && (kept.state == state_ || standsStill(at));
    const bool refresh = usable && kept.state != state_ && refreshed < settings_.max_refreshed;
    refreshed += refresh;
    if (!usable || refresh) trace(at, points[i], normal);
    ++(usable && !refresh ? stats_.kept : stats_.traced);
    kept.used = samples_;
    irradiance[i] = evaluate(at, radiosity, sky);
  }
}

// The most important of those in front of the point that face it, whatever lies between.
void Probes::aimAtLamps(Vec3 point, Vec3 normal) {
  aims_.clear();
  const FacetScene* const facets = facets_.scene();
  if (!facets || settings_.max_lamps == 0) return;
  const auto isMore = [&](const Aim& a, const Aim& b) {
    const auto key = [&](const Aim& aim) { return std::tuple(-aim.importance, tile_of_slot_[aim.lamp->slot], aim.lamp->index); };
    return key(a) < key(b);
  };
  for (const Lamp& lamp : lamps_) {
    if (!tree_.holds(lamp.slot)) continue;  // no leaf
    const Vec3 way = lamp.centroid - point;
    const float square = std::max(dot(way, way), lamp.area_m2), distance = std::sqrt(square), reach = std::sqrt(lamp.area_m2);
    const float arriving = (dot(normal, way) + reach) / distance, leaving = (reach - dot(lamp.normal, way)) / distance;
    if (!(arriving > 0 && leaving > 0)) continue;
    const Aim aim{&lamp, lamp.power * std::min(arriving, 1.0f) * std::min(leaving, 1.0f) / square};
    if (aims_.size() == settings_.max_lamps) {
      if (!isMore(aim, aims_.front())) continue;
      std::ranges::pop_heap(aims_, isMore);
      aims_.pop_back();
    }
    aims_.push_back(aim);
    std::ranges::push_heap(aims_, isMore);
  }
  std::erase_if(aims_, [&](Aim& aim) {
    aim.tile = facets->facetsOf(tile_of_slot_[aim.lamp->slot].tile);
    if (!aim.tile) return true;
    for (const uint32_t f : aim.tile->ofPatch(aim.lamp->index)) aim.area_m2 += areaOf(aim.tile->facets[f]);
    return !(aim.area_m2 > 0);
  });
}

Probes::Met Probes::meet(const RayLine& ray, uint32_t number) const {
  const FacetScene* const facets = facets_.scene();
  const FacetScene::Hit facet = facets ? facets->nearest(ray) : FacetScene::Hit{};
  ProbeTree::Hit plane;
  if (!facets)
    plane = tree_.nearest(ray, number, facet.distance_m, {});
  else if (!facets->complete)
    plane = tree_.nearest(ray, number, facet.distance_m, hidden_);
  if (plane.slot != kNoSlot) return {plane.slot, nullptr, plane.distance_m, plane.front, false};
  if (!facet.facet) return {.sky = true};
  return {slots_.slotOf(facet.tile->tile, facet.facet->patch), facet.facet, facet.distance_m, facet.front, false};
}

// What a ray that meets a lamp stands for, of the cosine-weighted hemisphere. With p the density of the probe's own rays (cosine / pi) and q that of rays to the lamp,
// both per steradian, P and Q these times their numbers: P p / (P^2 + Q^2) of its own rays, Q p / (P^2 + Q^2) of the others.
float Probes::weight(const Aim& aim, const Facet& facet, Vec3 direction, float cosine, float distance_m, bool own) const {
  const float p = cosine / kPi, leaving = std::abs(dot(facetNormal(facet), direction));
  if (!(p > 0 && leaving > 0)) return 0;
  const float of_own = static_cast<float>(rays_.size()) * p, of_lamps = static_cast<float>(settings_.lamp_rays) * distance_m * distance_m / (leaving * aim.area_m2);
  return (own ? of_own : of_lamps) * p / (of_own * of_own + of_lamps * of_lamps);
}

// Points of each lamp, triangle by triangle by their areas.
void Probes::castAtLamps(Vec3 point, Vec3 normal) {
  for (const Aim& aim : aims_) {
    const float of_ray = aim.area_m2 / static_cast<float>(settings_.lamp_rays);
    const auto raysBefore = [&](float area_m2) { return static_cast<uint32_t>(std::clamp(std::ceil(area_m2 / of_ray - 0.5f), 0.0f, static_cast<float>(settings_.lamp_rays))); };
    float before = 0;  // area of the triangles before
    for (const uint32_t number : aim.tile->ofPatch(aim.lamp->index)) {
      const Facet& facet = aim.tile->facets[number];
      const uint32_t first = raysBefore(before), rays = raysBefore(before += areaOf(facet)) - first;
      for (uint32_t k = 0; k < rays; ++k) {
        const std::array<float, 3> at = pointOfTriangle(k, rays);
        const Vec3 way = facet.corner + at[1] * facet.to_second + at[2] * facet.to_third - point;
        const float distance = length(way);
        if (!(distance > 0)) continue;
        const Vec3 direction = way / distance;
        const float cosine = dot(normal, direction);
        if (!(cosine > 0)) continue;
        const Met met = meet(RayLine(point, direction), static_cast<uint32_t>(rays_.size()) + first + k);
        if (met.slot == aim.lamp->slot && met.front && met.facet)
          met_.push_back({met.slot, weight(aim, *met.facet, direction, cosine, met.distance_m, false)});
      }
    }
  }
}

void Probes::trace(size_t at, Vec3 point, Vec3 normal) {
  Kept& kept = kept_[at];
  kept = {point, normal, state_, samples_, 0, 0, {}, {}};
  aimAtLamps(point, normal);
  for (size_t a = 0; a < aims_.size(); ++a) aim_of_slot_[aims_[a].lamp->slot] = static_cast<uint32_t>(a + 1);
  // Duff et al. Building an Orthonormal Basis, Revisited. 2017.
  const float sign = std::copysign(1.0f, normal.z), a = -1 / (sign + normal.z), b = normal.x * normal.y * a;
  const Vec3 x{1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x};
  const Vec3 y{b, sign + normal.y * normal.y * a, -normal.y};
  met_.clear();
  for (uint32_t r = 0; r < rays_.size(); ++r) {
    const RayLine ray(point, rays_[r].x * x + rays_[r].y * y + rays_[r].z * normal);
    const Met met = meet(ray, r);
    if (met.sky) {
      ++kept.sky;
      kept.sky_directions += ray.direction;
      const std::array<float, 5> quadratics = skyQuadratics(ray.direction);
      for (size_t k = 0; k < quadratics.size(); ++k) kept.sky_quadratics[k] += quadratics[k];
    } else if (met.front && met.slot != kNoSlot) {
      const uint32_t aim = met.facet ? aim_of_slot_[met.slot] : 0;
      const float share = aim == 0 ? 1 / static_cast<float>(rays_.size()) : weight(aims_[aim - 1u], *met.facet, ray.direction, rays_[r].z, met.distance_m, true);
      met_.push_back({met.slot, share});
    }
  }
  castAtLamps(point, normal);
  for (const Aim& aim : aims_) aim_of_slot_[aim.lamp->slot] = 0;
  std::ranges::sort(met_, {}, [](const Place& p) { return std::pair(p.slot, p.weight); });
  Place* const places = &places_[at * max_places_];
  for (size_t i = 0; i < met_.size(); ++i) {
    if (i == 0 || met_[i].slot != met_[i - 1].slot) places[kept.places++] = {met_[i].slot, 0};
    places[kept.places - 1].weight += met_[i].weight;
  }
}

// A ray that meets radiosity B carries radiance B / pi, and stands for pi times its weight.
Vec3 Probes::evaluate(size_t at, std::span<const Vec4> radiosity, const Sky& sky) const {
  const Kept& kept = kept_[at];
  const Place* const places = &places_[at * max_places_];
  Vec3 sum;
  for (uint32_t i = 0; i < kept.places; ++i) {
    const Vec4& b = radiosity[places[i].slot];
    sum += places[i].weight * Vec3{b.x, b.y, b.z};
  }
  Sky open = sky;
  open.l0 *= static_cast<float>(kept.sky);
  return sum + kPi * skyRadiance(open, kept.sky_directions, kept.sky_quadratics) / static_cast<float>(rays_.size());
}

ProbeStats Probes::stats() const {
  ProbeStats stats = stats_;
  stats.facet_tiles = facets_.tiles();
  stats.starved = facets_.starved();
  return stats;
}

}  // namespace ff::runtime
