#include "runtime/probes/probes.h"

#include <algorithm>
#include <bit>
#include <cmath>

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
      tree_(world, kMaxSlots),
      rays_(cosineRays(std::clamp(settings.rays, 1u, 65535u))),
      tile_of_slot_(kMaxSlots, kFree),
      hidden_(kMaxSlots),
      seen_(kMaxSlots),
      changed_(kMaxSlots),
      kept_((std::max(settings.max_kept, 1u) + kWays - 1) / kWays * kWays),
      places_(kept_.size() * rays_.size()),
      met_(rays_.size()),
      facets_(world, settings.facet_bytes) {}

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
  for (uint32_t slot = 0; slot < kMaxSlots; ++slot)
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
    }
    if (!leaf[slot])
      tree_.remove(slot);
    else if (!tree_.holds(slot))
      tree_.insert(slot, tile.id.level, tile.nodes[i]);
  }
}

void Probes::leave(uint32_t slot) {
  tree_.remove(slot);
  changed_[slot] = state_;
  tile_of_slot_[slot] = kFree;
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
  const Place* const places = &places_[kept * rays_.size()];
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

void Probes::trace(size_t at, Vec3 point, Vec3 normal) {
  Kept& kept = kept_[at];
  kept = {point, normal, state_, samples_, 0, 0, {}, {}};
  // Duff et al. Building an Orthonormal Basis, Revisited. 2017.
  const float sign = std::copysign(1.0f, normal.z), a = -1 / (sign + normal.z), b = normal.x * normal.y * a;
  const Vec3 x{1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x};
  const Vec3 y{b, sign + normal.y * normal.y * a, -normal.y};
  size_t met = 0;
  const FacetScene* const facets = facets_.scene();
  for (uint32_t r = 0; r < rays_.size(); ++r) {
    const RayLine ray(point, rays_[r].x * x + rays_[r].y * y + rays_[r].z * normal);
    const FacetScene::Hit facet = facets ? facets->nearest(ray) : FacetScene::Hit{};
    ProbeTree::Hit plane;
    if (!facets)
      plane = tree_.nearest(ray, r, facet.distance_m, {});
    else if (!facets->complete)
      plane = tree_.nearest(ray, r, facet.distance_m, hidden_);
    const bool sky = facet.distance_m >= FacetScene::Hit{}.distance_m;
    if (plane.slot == kNoSlot && sky) {
      ++kept.sky;
      kept.sky_directions += ray.direction;
      const std::array<float, 5> quadratics = skyQuadratics(ray.direction);
      for (size_t k = 0; k < quadratics.size(); ++k) kept.sky_quadratics[k] += quadratics[k];
    } else if (plane.slot != kNoSlot ? plane.front : facet.front) {
      const uint32_t slot =
          plane.slot != kNoSlot
              ? plane.slot
              : slots_.slotOf(facet.tile->tile, facet.patch);
      if (slot != kNoSlot) met_[met++] = static_cast<uint16_t>(slot);
    }
  }
  std::sort(met_.begin(), met_.begin() + static_cast<std::ptrdiff_t>(met));
  Place* const places = &places_[at * rays_.size()];
  for (size_t i = 0; i < met; ++i) {
    if (i == 0 || met_[i] != met_[i - 1]) places[kept.places++] = {met_[i], 0};
    ++places[kept.places - 1].rays;
  }
}

// A ray that meets radiosity B carries radiance B / pi, and stands for pi / rays of the cosine-weighted hemisphere.
Vec3 Probes::evaluate(size_t at, std::span<const Vec4> radiosity, const Sky& sky) const {
  const Kept& kept = kept_[at];
  const Place* const places = &places_[at * rays_.size()];
  Vec3 sum;
  for (uint32_t i = 0; i < kept.places; ++i) {
    const Vec4& b = radiosity[places[i].slot];
    sum += static_cast<float>(places[i].rays) * Vec3{b.x, b.y, b.z};
  }
  Sky open = sky;
  open.l0 *= static_cast<float>(kept.sky);
  sum += kPi * skyRadiance(open, kept.sky_directions, kept.sky_quadratics);
  return sum / static_cast<float>(rays_.size());
}

ProbeStats Probes::stats() const {
  ProbeStats stats = stats_;
  stats.facet_tiles = facets_.tiles();
  stats.starved = facets_.starved();
  return stats;
}

}  // namespace ff::runtime
