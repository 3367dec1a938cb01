#include "bake/light/form_factor.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "bake/rays/cosine_rays.h"
#include "bake/surface/sealed.h"

namespace ff::bake {
namespace {

constexpr size_t kMaxTogether = 128;  // patches cast by one task
constexpr int kTogetherLog = 2;        // the cube of cells that they lie in
constexpr size_t kGrain = 64;          // rows renumbered by one task

struct Scratch {
  std::vector<uint16_t> count;     // per patch, zero between rows
  std::vector<uint32_t> touched;
  std::vector<SurfacePoint> points;
  std::vector<SkyRays> sky;        // of a chunk's patches
  LampLight lamps;
  SightMap sight;
};

struct GroupHits {
  std::vector<uint32_t> column;
  std::vector<uint16_t> count;
};

// Patches that are cast together, as neighbours guide each other's rays to the sky: those of a cube of cells, whatever lies elsewhere.
// First ones, then the number of patches.
std::vector<size_t> castTogether(const PatchSet& set) {
  std::vector<size_t> start;
  for (size_t i = 0; i < set.patches.size(); ++i)
    if (i == 0 || i - start.back() == kMaxTogether ||
        hilbertAncestor(set.patches[i].key, kTogetherLog) != hilbertAncestor(set.patches[i - 1].key, kTogetherLog))
      start.push_back(i);
  start.push_back(set.patches.size());
  return start;
}

}  // namespace

void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               const RayCaster& caster, std::span<Ray> rays) {
  std::vector<SurfacePoint> points(rays.size());
  surfacePoints(scene, set, patch, sobol, seed, caster, points);
  for (size_t i = 0; i < rays.size(); ++i)
    rays[i] = {points[i].position, cosineDirection(frameOf(points[i].normal), points[i].u, points[i].v)};
}

HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays, uint64_t seed,
                 std::atomic<uint64_t>& done) {
  const size_t n = set.patches.size();
  const std::vector<size_t> start = castTogether(set);
  const size_t groups = start.size() - 1;
  const SobolTable sobol(rays);
  const LampTree lamps(set);
  HitRows rows;
  rows.rays.assign(n, rays);
  rows.start.assign(n + 1, 0);
  rows.sky.assign(n, 0);
  rows.absorbed.assign(n, 0);
  rows.buried.assign(n, 0);
  rows.sky_fraction.assign(n, 0);
  rows.sky_means.assign(n, {});
  rows.lamps.assign(n, {});
  rows.narrow.assign(n, 0);
  std::vector<GroupHits> parts(groups);
  tbb::enumerable_thread_specific<Scratch> scratch([&] {
    return Scratch{std::vector<uint16_t>(n), {}, std::vector<SurfacePoint>(rays), std::vector<SkyRays>(kMaxTogether),
                   LampLight(scene, set, caster, lamps, rays, seed), {}};
  });
  tbb::parallel_for(size_t{0}, groups, [&](size_t c) {
    Scratch& s = scratch.local();
    const size_t first = start[c], end = start[c + 1];
    for (size_t i = first; i < end; ++i) {
      surfacePoints(scene, set, static_cast<uint32_t>(i), sobol, seed, caster, s.points);
      if (!lamps.empty()) s.lamps.aim(static_cast<uint32_t>(i));
      SkyRays& sky = s.sky[i - first];
      sky.look.clear();
      sky.main.clear();
      s.sight.clear();
      std::array<uint32_t, kNarrowCells.size()> near{};
      for (size_t k = 0; k < rays; ++k) {
        const SurfacePoint& from = s.points[k];
        const Ray ray{from.position, cosineDirection(frameOf(from.normal), from.u, from.v)};
        const Hit hit = caster.nearest(ray);
        if (hit.triangle == kNone) {
          ++rows.sky[i];
          (k < lookingRays(rays) ? sky.look : sky.main).push_back({ray.origin, ray.direction, dot(ray.direction, from.normal)});
          continue;
        }
        const float distance = length(hit.point - ray.origin), cells = distance / set.cell_m;
        s.sight.add(ray.direction, distance);
        for (size_t d = 0; d < near.size(); ++d) near[d] += cells < kNarrowCells[d];
        const uint32_t j = set.patchAt(hit.triangle, hit.front, hit.point);
        if (j == kSealed) {
          ++rows.buried[i];
          continue;
        }
        if (j == kNone) {
          ++(!hit.front && isBuried(caster, ray.origin, from.normal) ? rows.buried : rows.absorbed)[i];
          continue;
        }
        if (s.count[j]++ == 0) s.touched.push_back(j);
        if (set.patches[j].emits()) s.lamps.hit(j, hit.triangle, hit.front, ray, hit.point, dot(ray.direction, from.normal));
      }
      for (auto* reached : {&sky.look, &sky.main})
        for (SkyRays::Ray& ray : *reached) ray.opening_m = s.sight.around(ray.direction);
      for (const uint32_t hits : near) if (hits > kMaxRays * rows.rays[i]) ++rows.narrow[i];
      if (!lamps.empty()) rows.lamps[i] = s.lamps.finish();
      std::sort(s.touched.begin(), s.touched.end());
      for (uint32_t j : s.touched) {
        parts[c].column.push_back(j);
        parts[c].count.push_back(s.count[j]);
        s.count[j] = 0;
      }
      rows.start[i + 1] = s.touched.size();
      s.touched.clear();
      done.fetch_add(1, std::memory_order_relaxed);
    }
    const auto sky = skyOf(scene, set, caster, sobol, seed, static_cast<uint32_t>(first), std::span(s.sky).first(end - first), rays);
    for (size_t i = first; i < end; ++i) {
      rows.sky_fraction[i] = static_cast<float>(sky[i - first].weight());
      rows.sky_means[i] = sky[i - first].means();
    }
  });
  for (size_t i = 0; i < n; ++i) rows.start[i + 1] += rows.start[i];
  rows.column.resize(rows.start[n]);
  rows.count.resize(rows.start[n]);
  tbb::parallel_for(size_t{0}, groups, [&](size_t c) {
    const auto at = static_cast<ptrdiff_t>(rows.start[start[c]]);
    std::copy(parts[c].column.begin(), parts[c].column.end(), rows.column.begin() + at);
    std::copy(parts[c].count.begin(), parts[c].count.end(), rows.count.begin() + at);
    parts[c] = {};
  });
  return rows;
}

HitRows renumber(const HitRows& in, std::span<const uint32_t> number) {
  const size_t n = in.sky.size();
  std::vector<uint32_t> old(n);
  for (uint32_t i = 0; i < n; ++i) old[number[i]] = i;
  HitRows out;
  out.start.assign(n + 1, 0);
  out.rays.resize(n);
  out.sky.resize(n);
  out.absorbed.resize(n);
  out.buried.resize(n);
  out.sky_fraction.resize(n);
  out.sky_means.resize(n);
  out.lamps.resize(n);
  for (size_t i = 0; i < n; ++i) out.start[i + 1] = out.start[i] + in.start[old[i] + 1] - in.start[old[i]];
  out.column.resize(in.column.size());
  out.count.resize(in.count.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, n, kGrain), [&](const tbb::blocked_range<size_t>& range) {
    std::vector<std::pair<uint32_t, uint16_t>> row;
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const uint32_t p = old[i];
      out.rays[i] = in.rays[p];
      out.sky[i] = in.sky[p];
      out.absorbed[i] = in.absorbed[p];
      out.buried[i] = in.buried[p];
      out.sky_fraction[i] = in.sky_fraction[p];
      out.sky_means[i] = in.sky_means[p];
      out.lamps[i] = in.lamps[p];
      row.clear();
      for (uint64_t k = in.start[p]; k < in.start[p + 1]; ++k) row.emplace_back(number[in.column[k]], in.count[k]);
      std::sort(row.begin(), row.end());
      uint64_t at = out.start[i];
      for (const auto& [column, count] : row) {
        out.column[at] = column;
        out.count[at++] = count;
      }
    }
  });
  return out;
}

}  // namespace ff::bake
