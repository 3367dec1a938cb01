#include "bake/cleanup/lamps_in_plane.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "bake/cleanup/coincident.h"
#include "bake/rays/ray_caster.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/polygon.h"

namespace ff::bake {
namespace {

// Of the largest coordinate. Surface less than kPlane apart is in one plane. A lamp is lifted by kLift: it then lies above what Fences take for one with it, and
// kMostAbove lamps on each other still within a hair, which is four times as far as rays start off a surface.
constexpr double kPlane = 1e-6, kLift = 2e-6;
constexpr uint32_t kMostAbove = 5;
constexpr double kLeastShared = 1e-3;  // of the smaller one's area: less is rounding

bool shines(const Material& m) { return !(m.emission == Vec3{}) && !m.occlude_only; }

class Flat {
 public:
  Flat(const Scene& scene, uint32_t t) : material_(scene.materials[scene.triangles[t].material]), largest_(static_cast<double>(largestCoordinate(scene, t))) {
    for (const uint32_t v : scene.triangles[t].v) corners_.push_back(pointOf(scene.positions[v]));
    const Point area = vectorArea(corners_);
    area_ = length(area);
    if (area_ > 0) normal_ = area * (1 / area_);
  }
  const Material& material() const { return material_; }
  double largest() const { return largest_; }
  Point normal() const { return normal_; }

  bool sharesPlane(const Flat& other) const {
    if (!(area_ > 0 && other.area_ > 0)) return false;
    if (!material_.double_sided && !other.material_.double_sided && dot(normal_, other.normal_) < 0) return false;
    const Flat &large = area_ > other.area_ ? *this : other, &small = &large == this ? other : *this;
    for (const Point& p : small.corners_)
      if (std::abs(dot(large.normal_, p - large.corners_[0])) > kPlane * std::max(largest_, other.largest_)) return false;
    Polygon shared = small.corners_, beyond, inside;
    for (size_t k = 0; k < 3 && shared.size() >= 3; ++k) {
      const Point out = cross(large.corners_[(k + 1) % 3] - large.corners_[k], large.normal_);
      const auto distance = [&](const Point& p) { return dot(out, p - large.corners_[k]); };
      const auto crossing = [&](const Point& lo, const Point& hi) { return lo + (hi - lo) * (distance(lo) / (distance(lo) - distance(hi))); };
      split(shared, distance, crossing, 0, inside, beyond);
      std::swap(shared, inside);
    }
    return shared.size() >= 3 && length(vectorArea(shared)) > kLeastShared * small.area_;
  }

 private:
  const Material& material_;
  double largest_, area_ = 0;
  Polygon corners_;
  Point normal_{0, 1, 0};
};

}  // namespace

Result<std::vector<Lift>> findLampsInPlane(const Scene& scene) {
  Scene lamps;
  std::vector<uint32_t> triangle_of;  // by number in `lamps`
  lamps.materials.resize(1);
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    if (!shines(scene.materials[scene.triangles[t].material])) continue;
    triangle_of.push_back(t);
    const auto first = static_cast<uint32_t>(lamps.positions.size());
    for (const uint32_t v : scene.triangles[t].v) lamps.positions.push_back(scene.positions[v]);
    lamps.triangles.push_back({{first, first + 1, first + 2}, 0});
  }
  std::vector<Lift> lifts;
  if (triangle_of.empty()) return lifts;
  const auto caster = RayCaster::create(lamps);
  if (!caster) return caster.error();

  struct Pair {
    uint32_t above, below;
  };
  // Of two lamps in one plane.
  const auto comesAbove = [&](uint32_t t, uint32_t u) {
    const auto bright = [&](uint32_t i) { return brightness(scene.materials[scene.triangles[i].material]); };
    return bright(t) != bright(u) ? bright(t) > bright(u) : t < u;
  };
  tbb::enumerable_thread_specific<std::vector<Pair>> found;
  tbb::enumerable_thread_specific<std::vector<uint32_t>> near;
  tbb::parallel_for(uint32_t{0}, static_cast<uint32_t>(scene.triangles.size()), [&](uint32_t t) {
    Box box;
    for (const uint32_t v : scene.triangles[t].v) box.add(scene.positions[v]);
    const Vec3 half = (box.hi - box.lo) * 0.5f;
    caster->near(box.lo + half, length(half), near.local());
    if (near.local().empty()) return;
    const Flat flat(scene, t);
    if (flat.material().occlude_only) return;
    for (const uint32_t number : near.local()) {
      const uint32_t lamp = triangle_of[number];
      if (lamp == t || (shines(flat.material()) && !comesAbove(lamp, t)) || !flat.sharesPlane(Flat(scene, lamp))) continue;
      found.local().push_back({lamp, t});
    }
  });
  std::vector<Pair> pairs;
  for (const std::vector<Pair>& some : found) pairs.insert(pairs.end(), some.begin(), some.end());
  // What lies below comes first.
  std::ranges::sort(pairs, [&](const Pair& a, const Pair& b) { return a.above != b.above ? comesAbove(b.above, a.above) : a.below < b.below; });
  std::map<uint32_t, uint32_t> height;  // of lamps that are lifted
  for (size_t begin = 0, end = 0; begin < pairs.size(); begin = end) {
    const uint32_t lamp = pairs[begin].above;
    const Flat above(scene, lamp), below(scene, pairs[begin].below);
    double largest = above.largest();
    uint32_t& own = height[lamp];
    for (end = begin; end < pairs.size() && pairs[end].above == lamp; ++end) {
      const auto there = height.find(pairs[end].below);
      own = std::max(own, 1 + (there == height.end() ? 0 : there->second));
      largest = std::max(largest, Flat(scene, pairs[end].below).largest());
    }
    own = std::min(own, kMostAbove);
    const Point up = above.material().double_sided && !below.material().double_sided ? below.normal() : above.normal();
    lifts.push_back({lamp, vec3Of(up * (own * kLift * largest))});
  }
  std::ranges::sort(lifts, {}, &Lift::triangle);
  return lifts;
}

}  // namespace ff::bake
