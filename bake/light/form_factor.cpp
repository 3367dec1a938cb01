#include "bake/light/form_factor.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

#include "bake/all_threads.h"
#include "bake/light/ray_fan.h"
#include "bake/light/row_error.h"
#include "bake/light/row_hits.h"
#include "bake/light/unoccluded.h"
#include "bake/surface/sealed.h"

namespace ff::bake {
namespace {

constexpr uint32_t kMaxGroup = 128;      // patches of a group
constexpr int kGroupLog = 2;             // the cube of cells that they lie in
constexpr uint32_t kMaxCast = 256;       // patches cast by one task, but for the last group
static_assert(kGroupLog <= kCastLog);
constexpr uint32_t kLeastTried = 8, kTriedOf = 4;  // patches of a group whose errors tell how many rays it needs: so many, or one of so many
constexpr double kHalfAgain = 1.22;      // by so much the error falls with 1.41 times as many rays
constexpr double kLeastExpected = 1;     // rays towards a patch from which on geometry tells better than their number

}  // namespace

// Those of a cube of cells, whatever lies elsewhere: a range begins with the first ones of a cube.
std::vector<uint32_t> castGroups(const PatchSet& set, uint32_t first, uint32_t end) {
  std::vector<uint32_t> start;
  for (uint32_t i = first; i < end; ++i)
    if (i == first || i - start.back() == kMaxGroup ||
        hilbertAncestor(set.patches[i].key, kGroupLog) != hilbertAncestor(set.patches[i - 1].key, kGroupLog))
      start.push_back(i);
  start.push_back(end);
  return start;
}

std::vector<uint32_t> castRanges(const PatchSet& set) {
  const std::vector<uint32_t> groups = castGroups(set, 0, static_cast<uint32_t>(set.patches.size()));
  const auto cubeOf = [&](uint32_t patch) { return hilbertAncestor(set.patches[patch].key, kCastLog); };
  std::vector<uint32_t> start;
  for (size_t g = 0; g + 1 < groups.size(); ++g)
    if (g == 0 || groups[g + 1] - start.back() > kMaxCast || cubeOf(groups[g]) != cubeOf(start.back())) start.push_back(groups[g]);
  start.push_back(groups.back());
  return start;
}

void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               const RayCaster& caster, std::span<Ray> rays) {
  std::vector<SurfacePoint> points(rays.size());
  surfacePoints(scene, set, patch, sobol, seed, caster, points);
  cosineRays(points, rays);
}

struct RowCaster::State {
  // A ray of a row, by its number, that ends on a patch that emits.
  struct OnLamp {
    uint32_t patch;
    uint16_t ray;
  };

  struct Scratch {
    Scratch(const State& s)
        : met(s.budget.rays), shapes(s.set), points(s.budget.rays), rays(s.budget.rays), hits(s.budget.rays), sky(kMaxGroup), caster(s.caster),
          lamp_caster(s.caster), lamps(s.scene, s.set, lamp_caster, s.lamps, s.budget.rays, s.seed), leaks(s.set.cell_m) {}

    // The first so many points' rays and hits.
    void castFrom(size_t n) {
      cosineRays(std::span(points).first(n), std::span(rays).first(n));
      caster.nearest(std::span(rays).first(n), std::span(hits).first(n));
    }

    RowHits hit_patches;
    std::vector<uint32_t> met;       // by ray: the patch that it ends on, or kNone
    PatchShape shape;                // of the patch
    PatchShapes shapes;
    RayFan fan;
    std::vector<SurfacePoint> points;
    std::vector<Ray> rays;           // from them
    std::vector<Hit> hits;           // of them
    std::vector<SkyRays> sky;        // of the group
    RayCaster caster;                // leaves the trail of the group
    std::vector<OnLamp> on_lamps;    // of the patch
    RayCaster lamp_caster;           // leaves that of rays towards lamps
    LampLight lamps;
    LeakSums leaks;                  // of the group
  };

  const Scene& scene;
  const PatchSet& set;
  const RayCaster& caster;
  const RayBudget budget;
  const uint64_t seed;
  const SobolTable sobol;
  const LampTree& lamps;
  const MadeUpLight light;
  tbb::enumerable_thread_specific<std::unique_ptr<Scratch>> scratch;

  // What the rays that hit other patches stand for; so many reach the sky. Returns RowError::square() of the row.
  double tell(uint32_t patch, uint32_t rays, uint32_t sky, Scratch& s) const;

  // Of a group.
  uint32_t raysFor(uint32_t first, uint32_t end, Scratch& s) const;
  GroupRows cast(uint32_t first, uint32_t end, Scratch& s, WorkCount& done) const;

  // What a patch gets of lamps; of s.on_lamps, in the order of rays, with what s has of these rays.
  std::vector<LampIrradiance> lampsOf(uint32_t patch, uint32_t rays, Scratch& s) const;
  void castLamps(uint32_t first, std::span<const uint32_t> again, Scratch& s, GroupRows& group) const;

  Scratch& ownScratch() {
    std::unique_ptr<Scratch>& own = scratch.local();
    if (!own) own = std::make_unique<Scratch>(*this);
    return *own;
  }
};

RowCaster::RowCaster(const Scene& scene, const PatchSet& set, const RayCaster& caster, const LampTree& lamps, RayBudget budget, uint64_t seed)
    : state_(new State{scene, set, caster, budget, seed, SobolTable(budget.rays), lamps, MadeUpLight(set), {}}) {}
RowCaster::~RowCaster() = default;

GroupRows RowCaster::cast(uint32_t first, uint32_t end, RayTrail* trail, RayTrail* lamp_trail, WorkCount& done) const {
  State::Scratch& s = state_->ownScratch();
  s.caster = state_->caster.leaving(trail);
  s.lamp_caster = state_->caster.leaving(lamp_trail);
  return state_->cast(first, end, s, done);
}

void RowCaster::castLamps(uint32_t first, std::span<const uint32_t> again, RayTrail* lamp_trail, GroupRows& group) const {
  State::Scratch& s = state_->ownScratch();
  s.lamp_caster = state_->caster.leaving(lamp_trail);
  state_->castLamps(first, again, s, group);
}

double RowCaster::State::tell(uint32_t patch, uint32_t rays, uint32_t sky, Scratch& s) const {
  const Patch& from = set.patches[patch];
  s.shape.assign(set, patch);
  s.fan.assign(s.shape, from.normal, std::span(s.rays).first(rays), std::span(s.met).first(rays));
  for (RowHits::Entry& e : s.hit_patches.entries()) {
    e.stand_for = {static_cast<double>(e.hits[0]), static_cast<double>(e.hits[1])};
    if (e.patch == patch || farExchange(from, set.patches[e.patch]) * rays < kLeastExpected * static_cast<double>(from.area_m2)) continue;
    const PatchShape& other = s.shapes.of(e.patch);
    const std::optional<double> exchange = unoccludedExchange(s.shape, other);
    const double expected = exchange ? *exchange / s.shape.area_m2 * rays : 0;
    if (!(expected >= kLeastExpected)) continue;
    const RayFan::Share share = s.fan.towards(e.patch, other, expected);
    if (!(share.all() ? isLikely(e.count(), expected) : share.isLikely())) continue;
    const double seen = share.all() ? 1 : static_cast<double>(share.there[0] + share.there[1]) / (share.towards[0] + share.towards[1]);
    for (size_t half = 0; half < 2; ++half)
      e.stand_for[half] = expected / 2 * (share.towards[half] > 0 ? static_cast<double>(share.there[half]) / share.towards[half] : seen);
    e.estimate = expected * seen;
    e.whole = share.all();
  }
  RowError error(light);
  for (const RowHits::Entry& e : s.hit_patches.entries()) error.add(e.patch, e.hits, e.stand_for);
  error.sky(sky);
  return error.square(rays);
}

// From the errors of a few of them with few rays.
uint32_t RowCaster::State::raysFor(uint32_t first, uint32_t end, Scratch& s) const {
  if (budget.fewest() == budget.rays) return budget.rays;
  const uint32_t step = std::clamp((end - first) / kLeastTried, 1u, kTriedOf);
  double square = 0;
  uint32_t tried = 0;
  for (uint32_t begin = first; begin < end; begin += step, ++tried) {
    // Of each few one by chance: those of a cell follow each other by orientation, and every fourth may be the outside of a wall.
    const uint32_t patch = begin + static_cast<uint32_t>(mix64(set.patches[begin].name) % std::min(step, end - begin));
    surfacePoints(scene, set, patch, sobol, seed, caster, std::span(s.points).first(kLeastRays));
    s.castFrom(kLeastRays);
    s.hit_patches.begin(kLeastRays);
    uint32_t sky = 0;
    for (uint32_t k = 0; k < kLeastRays; ++k) {
      const Hit& hit = s.hits[k];
      s.met[k] = kNone;
      if (hit.triangle == kNone) ++sky;
      else if (const uint32_t j = set.patchAt(hit.triangle, hit.front, hit.point); j < set.patches.size()) s.hit_patches.add(s.met[k] = j, k);
    }
    square += tell(patch, kLeastRays, sky, s);
  }
  const double off = std::sqrt(square / tried) / static_cast<double>(budget.target_error);
  uint32_t rays = kLeastRays;  // and half as many again, and so on: Sobol points are best by powers of two
  for (double left = off; left > 1 && rays < budget.rays; left /= kHalfAgain) rays += (rays & (rays - 1)) == 0 ? rays / 2 : rays / 3;
  return std::min(rays, budget.rays);
}

std::vector<LampIrradiance> RowCaster::State::lampsOf(uint32_t patch, uint32_t rays, Scratch& s) const {
  s.lamps.aim(patch, rays);
  for (const auto& [lamp, k] : s.on_lamps) s.lamps.hit(lamp, s.hits[k], s.rays[k], dot(s.rays[k].direction, s.points[k].normal));
  return s.lamps.finish();
}

// Rays of rows end where they ended, so those that ended on lamps alone are cast again.
void RowCaster::State::castLamps(uint32_t first, std::span<const uint32_t> again, Scratch& s, GroupRows& group) const {
  HitRows& rows = group.rows;
  size_t at = 0, ray = 0;
  for (const uint32_t patch : again) {
    const size_t i = patch - first;
    if (lamps.empty()) {
      rows.lamps[i].clear();
      continue;
    }
    s.on_lamps.clear();
    for (; at < group.to_lamps.entry.size() && group.to_lamps.entry[at] < rows.start[i + 1]; ++at) {
      const uint64_t entry = group.to_lamps.entry[at];
      const bool emits = entry >= rows.start[i] && lamps.leafOf(rows.column[entry]) != kNone;
      for (size_t left = rows.count[entry]; left > 0; --left, ++ray)
        if (emits) s.on_lamps.push_back({rows.column[entry], group.to_lamps.ray[ray]});
    }
    std::sort(s.on_lamps.begin(), s.on_lamps.end(), [](const OnLamp& a, const OnLamp& b) { return a.ray < b.ray; });
    for (const OnLamp& on : s.on_lamps) {
      const std::span<SurfacePoint> point(&s.points[on.ray], 1);
      surfacePoints(scene, set, patch, sobol, seed, caster, point, on.ray);
      cosineRays(point, {&s.rays[on.ray], 1});
      s.hits[on.ray] = caster.nearest(s.rays[on.ray]);
    }
    rows.lamps[i] = lampsOf(patch, rows.rays[i], s);
  }
}

GroupRows RowCaster::State::cast(uint32_t first, uint32_t end, Scratch& s, WorkCount& done) const {
  const uint32_t rays = raysFor(first, end, s);
  const size_t n = end - first;
  GroupRows group;
  HitRows& rows = group.rows;
  rows.rays.assign(n, rays);
  rows.square_error.assign(n, 0);
  rows.start.assign(n + 1, 0);
  rows.sky.assign(n, 0);
  rows.absorbed.assign(n, 0);
  rows.buried.assign(n, 0);
  rows.sky_fraction.assign(n, 0);
  rows.sky_means.assign(n, {});
  rows.lamps.assign(n, {});
  rows.narrow.assign(n, 0);
  s.leaks.clear();
  const std::span<SurfacePoint> points = std::span(s.points).first(rays);
  for (uint32_t patch = first; patch < end; ++patch) {
    const size_t i = patch - first;
    surfacePoints(scene, set, patch, sobol, seed, caster, points);
    s.on_lamps.clear();
    s.hit_patches.begin(rays);
    SkyRays& sky = s.sky[i];
    sky.look.clear();
    sky.main.clear();
    sky.sight.clear();
    std::array<uint32_t, kNarrowCells.size()> near{};
    s.castFrom(rays);
    for (size_t k = 0; k < rays; ++k) {
      const SurfacePoint& from = points[k];
      const Ray& ray = s.rays[k];
      const Hit& hit = s.hits[k];
      s.met[k] = kNone;
      if (hit.triangle == kNone) {
        ++rows.sky[i];
        (k < lookingRays(rays) ? sky.look : sky.main).push_back({ray.origin, ray.direction, dot(ray.direction, from.normal)});
        continue;
      }
      const float distance = length(hit.point - ray.origin), cells = distance / set.cell_m;
      sky.sight.add(ray.direction, distance);
      for (size_t d = 0; d < near.size(); ++d) near[d] += cells < kNarrowCells[d];
      const uint32_t j = set.patchAt(hit.triangle, hit.front, hit.point);
      if (j == kSealed) {
        ++rows.buried[i];
        continue;
      }
      if (j == kNone) {
        const bool buried = !hit.front && isBuried(s.caster, ray.origin, from.normal);
        ++(buried ? rows.buried : rows.absorbed)[i];
        if (!buried && !hit.front) s.leaks.add({hit.point, set.patches[patch].area_m2 / static_cast<float>(rays)});
        continue;
      }
      s.hit_patches.add(s.met[k] = j, k);
      if (lamps.leafOf(j) != kNone) s.on_lamps.push_back({j, static_cast<uint16_t>(k)});
    }
    for (const uint32_t hits : near) if (hits > kMaxRays * rays) ++rows.narrow[i];
    if (!lamps.empty()) rows.lamps[i] = lampsOf(patch, rays, s);
    rows.square_error[i] = static_cast<float>(tell(patch, rays, rows.sky[i], s));
    const std::span<RowHits::Entry> entries = s.hit_patches.entries();
    std::sort(entries.begin(), entries.end(), [](const RowHits::Entry& a, const RowHits::Entry& b) { return a.patch < b.patch; });
    std::sort(s.on_lamps.begin(), s.on_lamps.end(), [](const OnLamp& a, const OnLamp& b) { return std::pair(a.patch, a.ray) < std::pair(b.patch, b.ray); });
    auto on = s.on_lamps.begin();
    for (const RowHits::Entry& e : entries) {
      if (on != s.on_lamps.end() && on->patch == e.patch) group.to_lamps.entry.push_back(rows.column.size());
      for (; on != s.on_lamps.end() && on->patch == e.patch; ++on) group.to_lamps.ray.push_back(on->ray);
      rows.column.push_back(e.patch);
      rows.count.push_back(static_cast<uint16_t>(e.count()));
      rows.whole.push_back(e.whole);
      rows.estimate.push_back(e.estimate > 0 ? std::max(1u, static_cast<uint32_t>(e.estimate * kRayParts + 0.5)) : 0);
    }
    rows.start[i + 1] = rows.column.size();
    done.add();
  }
  const auto sky = skyOf(scene, set, s.caster, sobol, seed, first, std::span(s.sky).first(n), rays);
  for (size_t i = 0; i < n; ++i) {
    rows.sky_fraction[i] = static_cast<float>(sky[i].weight());
    rows.sky_means[i] = sky[i].means();
  }
  rows.leaks = s.leaks.heaviest(kMaxLeaks);
  return group;
}

HitRows rowsOfRange(std::vector<HitRows> groups, float cell_m) {
  HitRows rows = joined(std::move(groups));
  LeakSums leaks(cell_m);
  for (const Leak& leak : rows.leaks) leaks.add(leak);
  rows.leaks = leaks.heaviest(kMaxLeaks);
  return rows;
}

void castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, WorkCount& done, const TakeRows& take) {
  const std::vector<uint32_t> start = castRanges(set);
  const LampTree lamps(scene, set, caster);
  const RowCaster rows(scene, set, caster, lamps, budget, seed);
  std::atomic<size_t> next{0};
  onAllThreads([&] {  // in order: all are in one neighbourhood, of which memory holds what they need
    for (size_t r = next++; r + 1 < start.size(); r = next++) {
      const std::vector<uint32_t> group = castGroups(set, start[r], start[r + 1]);
      std::vector<HitRows> groups;
      for (size_t g = 0; g + 1 < group.size(); ++g) groups.push_back(std::move(rows.cast(group[g], group[g + 1], nullptr, nullptr, done).rows));
      take(start[r], rowsOfRange(std::move(groups), set.cell_m));
    }
  });
}

HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, WorkCount& done) {
  return gathered([&](const TakeRows& take) { castRows(scene, set, caster, budget, seed, done, take); });
}

HitRows gathered(const std::function<void(const TakeRows&)>& cast) {
  std::mutex mutex;
  std::map<uint32_t, HitRows> ranges;
  cast([&](uint32_t first, HitRows rows) {
    const std::lock_guard lock(mutex);
    ranges.emplace(first, std::move(rows));
  });
  std::vector<HitRows> in_order;
  for (auto& [first, rows] : ranges) in_order.push_back(std::move(rows));
  return joined(std::move(in_order));
}

}  // namespace ff::bake
