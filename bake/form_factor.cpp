#include "bake/form_factor.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "bake/cosine_rays.h"
#include "bake/sealed.h"
#include "bake/surface_sampling.h"

namespace ff::bake {
namespace {

constexpr size_t kChunk = 64;  // patches cast by one task

struct Scratch {
  std::vector<uint16_t> count;     // per patch, zero between rows
  std::vector<uint32_t> touched;
  std::vector<Ray> rays;
  std::vector<Vec3> normals;
};

uint32_t raysOfLamps(const PatchSet& set, uint32_t rays) {
  const auto lamps = static_cast<size_t>(std::count_if(set.patches.begin(), set.patches.end(), [](const Patch& p) { return p.emits(); }));
  const size_t times = lamps > 0 ? 1 + set.patches.size() / (4 * lamps) : 1;
  return std::min(65535u, rays * static_cast<uint32_t>(std::min<size_t>(times, kMostLampRays)));
}

struct Chunk {
  std::vector<uint32_t> column;
  std::vector<uint16_t> count;
};

}  // namespace

void patchRays(const Scene& scene, const PatchSet& set, uint32_t patch, const SobolTable& sobol, uint64_t seed,
               const RayCaster& caster, std::span<Ray> rays, std::span<Vec3> normals) {
  const Patch& p = set.patches[patch];
  const std::span<const PatchTriangle> triangles(set.triangles.data() + p.first_triangle, p.triangles);
  const float whole = triangles.back().cumulative_area;
  const auto seeds = SobolTable::seeds(seed, patch);
  std::vector<Frame> frames;
  frames.reserve(triangles.size());
  for (const PatchTriangle& t : triangles) frames.push_back(frameOf(normalized(cross(t.b - t.a, t.c - t.a))));
  for (uint32_t i = 0; i < rays.size(); ++i) {
    const auto u = sobol.point(i, seeds);
    float pick = u[0], v = u[1];
    const PatchTriangle* t = nullptr;
    Vec3 origin;
    for (int attempt = 0; attempt < 16; ++attempt) {  // again where a cutout has a hole
      const float x = pick * whole;
      const auto at = std::upper_bound(triangles.begin(), triangles.end(), x,
                                       [](float a, const PatchTriangle& q) { return a < q.cumulative_area; });
      t = at == triangles.end() ? &triangles.back() : &*at;
      const float before = at == triangles.begin() ? 0.0f : (t - 1)->cumulative_area;
      const float own = t->cumulative_area - before;
      origin = pointInTriangle(t->a, t->b, t->c, own > 0 ? std::clamp((x - before) / own, 0.0f, 1.0f) : 0.5f, v);
      if (!scene.materials[scene.triangles[t->source].material].cutout) break;
      const auto [b, c] = barycentric(scene, t->source, origin);
      if (!isHole(scene, t->source, b, c)) break;
      pick = std::fmod(pick + 0.6180339887f, 1.0f);
      v = std::fmod(v + 0.7548776662f, 1.0f);
    }
    const Frame& frame = frames[static_cast<size_t>(t - triangles.data())];
    rays[i].origin = origin + frame.normal * caster.surfaceOffset(t->source);
    rays[i].direction = cosineDirection(frame, u[2], u[3]);
    if (!normals.empty()) normals[i] = frame.normal;
  }
}

HitRows castRows(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays, uint64_t seed,
                 std::atomic<uint64_t>& done) {
  const size_t n = set.patches.size(), chunks = (n + kChunk - 1) / kChunk;
  const uint32_t lamp_rays = raysOfLamps(set, rays);
  const SobolTable sobol(lamp_rays);
  HitRows rows;
  rows.rays.resize(n);
  for (size_t i = 0; i < n; ++i) rows.rays[i] = set.patches[i].emits() ? lamp_rays : rays;
  rows.start.assign(n + 1, 0);
  rows.sky.assign(n, 0);
  rows.absorbed.assign(n, 0);
  rows.buried.assign(n, 0);
  rows.sky_means.assign(n, {});
  rows.narrow.assign(n, 0);
  std::vector<Chunk> parts(chunks);
  tbb::enumerable_thread_specific<Scratch> scratch([&] {
    return Scratch{std::vector<uint16_t>(n), {}, std::vector<Ray>(lamp_rays), std::vector<Vec3>(lamp_rays)};
  });
  tbb::parallel_for(size_t{0}, chunks, [&](size_t c) {
    Scratch& s = scratch.local();
    for (size_t i = c * kChunk; i < std::min(n, (c + 1) * kChunk); ++i) {
      const std::span<Ray> cast(s.rays.data(), rows.rays[i]);
      patchRays(scene, set, static_cast<uint32_t>(i), sobol, seed, caster, cast, s.normals);
      SkySums sky;
      std::array<uint32_t, kNarrowCells.size()> near{};
      for (size_t k = 0; k < cast.size(); ++k) {
        const Ray& ray = cast[k];
        const Hit hit = caster.nearest(ray);
        if (hit.triangle == kNone) {
          ++rows.sky[i];
          sky.add(ray.direction, 1);
          continue;
        }
        const float cells = length(hit.point - ray.origin) / set.cell_m;
        for (size_t d = 0; d < near.size(); ++d) near[d] += cells < kNarrowCells[d];
        const uint32_t j = set.patchAt(hit.triangle, hit.front, hit.point);
        if (j == kSealed) {
          ++rows.buried[i];
        } else if (j == kNone) {
          ++(isBuried(caster, ray.origin, s.normals[k]) ? rows.buried : rows.absorbed)[i];
        } else if (s.count[j]++ == 0) {
          s.touched.push_back(j);
        }
      }
      for (const uint32_t hits : near) if (hits > kMostRays * rows.rays[i]) ++rows.narrow[i];
      rows.sky_means[i] = sky.means();
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
  });
  for (size_t i = 0; i < n; ++i) rows.start[i + 1] += rows.start[i];
  rows.column.resize(rows.start[n]);
  rows.count.resize(rows.start[n]);
  tbb::parallel_for(size_t{0}, chunks, [&](size_t c) {
    const auto at = static_cast<ptrdiff_t>(rows.start[c * kChunk]);
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
  out.sky_means.resize(n);
  for (size_t i = 0; i < n; ++i) out.start[i + 1] = out.start[i] + in.start[old[i] + 1] - in.start[old[i]];
  out.column.resize(in.column.size());
  out.count.resize(in.count.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, n, kChunk), [&](const tbb::blocked_range<size_t>& range) {
    std::vector<std::pair<uint32_t, uint16_t>> row;
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const uint32_t p = old[i];
      out.rays[i] = in.rays[p];
      out.sky[i] = in.sky[p];
      out.absorbed[i] = in.absorbed[p];
      out.buried[i] = in.buried[p];
      out.sky_means[i] = in.sky_means[p];
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
