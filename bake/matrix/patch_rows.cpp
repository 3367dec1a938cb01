#include "bake/matrix/patch_rows.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <utility>

#include "bake/matrix/pool.h"
#include "bake/memory.h"

namespace ff::bake {

void PutAside::put(uint32_t first, const HitRows& rows) {
  for (size_t p = 0; p < rows.patches(); ++p) sight[first + p] = sightOf(rows, p);
  const auto count = [&](size_t patch, uint64_t bytes) {
    std::atomic_ref(pooling_bytes_[patch]).fetch_add(static_cast<uint32_t>(bytes), std::memory_order_relaxed);
  };
  for (size_t p = 0; p < rows.patches(); ++p)
    count(first + p, HitPool::kBytesANode + rows.lamps[p].size() * sizeof(LampIrradiance) + (rows.start[p + 1] - rows.start[p]) * HitPool::kBytesAHit);
  for (const uint32_t hit : rows.column) count(hit, HitPool::kBytesAHit);
  Range range{first, spill_.put(encoded(rows)), rows.leaks};
  const std::lock_guard lock(mutex_);
  ranges_.push_back(std::move(range));
}

std::vector<Leak> PutAside::leaks(float cell_m, size_t most) const {
  std::vector<const Range*> in_order;
  for (const Range& range : ranges_) in_order.push_back(&range);
  std::sort(in_order.begin(), in_order.end(), [](const Range* a, const Range* b) { return a->first < b->first; });
  LeakSums sums(cell_m);
  for (const Range* range : in_order)
    for (const Leak& leak : range->leaks) sums.add(leak);
  return sums.heaviest(most);
}

std::pair<uint32_t, HitRows> PutAside::take(size_t range) {
  const Spill::Block block = std::exchange(ranges_[range].block, {});
  return {ranges_[range].first, decodedHits(spill_.get(block))};
}

namespace {

// No bucket is larger, so that the next one finds its memory in use and in cache: of so many tiles that all threads end at about the same time.
constexpr uint64_t kBucketBytesAThread = uint64_t{128} << 20;

// First nodes of buckets of whole tiles, with as many as memory has room for.
std::vector<uint32_t> bucketsOf(const Hierarchy& h, std::span<const uint32_t> patch_of, const PutAside& hits, uint64_t bytes) {
  const std::vector<uint32_t>& tiles = h.tile_start[0];
  std::vector<uint32_t> start{0};
  uint64_t in_bucket = 0;
  for (size_t t = 0; t + 1 < tiles.size(); ++t) {
    uint64_t in_tile = 0;
    for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) in_tile += hits.poolingBytes(patch_of[i]);
    if (tiles[t] > start.back() && in_bucket + in_tile > bytes) {
      start.push_back(tiles[t]);
      in_bucket = 0;
    }
    in_bucket += in_tile;
  }
  start.push_back(tiles.back());
  return start;
}

}  // namespace

PagedVector<LightValues> poolPatches(const PatchRowSource& source, const Hierarchy& h, PutAside& hits, const std::string& path, uint64_t memory_bytes,
                                     LevelRows& rows, WorkCount& done, uint64_t& spilled) {
  const std::vector<uint32_t>& tiles = h.tile_start[0];
  PagedVector<LightValues> light(source.patches.size());
  tbb::enumerable_thread_specific<std::vector<NodeRow>> scratch;  // of a tile
  {
    Spill spill(path, spareMemory(memory_bytes) / 4);
    const uint64_t bucket_bytes = std::min(spareMemory(memory_bytes) / 4, kBucketBytesAThread * static_cast<uint64_t>(tbb::this_task_arena::max_concurrency()));
    HitPool pool(h.number, source.whole_area, source.density, bucketsOf(h, source.patch_of, hits, bucket_bytes), spill);
    tbb::parallel_for(size_t{0}, hits.ranges(), [&](size_t r) {
      const auto [first, of_range] = hits.take(r);
      pool.add(first, of_range);
      done.add();
    });
    giveBackMemory();
    PooledRows pooled;
    for (size_t b = 0; b < pool.buckets(); ++b) {
      pool.take(b, pooled);
      const auto first = static_cast<uint32_t>(std::lower_bound(tiles.begin(), tiles.end(), pooled.first()) - tiles.begin());
      const auto end = static_cast<uint32_t>(std::lower_bound(tiles.begin(), tiles.end(), pooled.end()) - tiles.begin());
      tbb::parallel_for(first, end, [&](uint32_t t) {
        std::vector<NodeRow>& of_tile = scratch.local();
        of_tile.resize(tiles[t + 1] - tiles[t]);
        for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) {
          NodeRow& row = of_tile[i - tiles[t]];
          const uint32_t p = source.patch_of[i];
          const Patch& patch = source.patches[p];
          row.node.area_m2 = patch.area_m2;
          row.node.centroid = patch.centroid;
          row.node.normal = patch.normal;
          row.node.albedo = patch.albedo;
          row.node.emission = patch.emission;
          row.node.lamp_group = patch.lamp_group;
          row.bounds = patch.bounds;
          pooled.row(i, row.row);
          row.direct = directLight(row.row, patch.area_m2, source.sun[p]);
          light[i] = reflectedLight(patch.albedo, patch.area_m2, row.direct, row.row, {});
        }
        rows.put(t, of_tile);
        done.add();
      });
    }
    spilled += spill.written();
  }
  giveBackMemory();
  PagedVector<LightValues> bounced(source.patches.size());
  tbb::parallel_for(0u, static_cast<uint32_t>(tiles.size()) - 1, [&](uint32_t t) {
    std::vector<NodeRow>& of_tile = scratch.local();
    rows.get(t, of_tile);
    for (size_t i = 0; i < of_tile.size(); ++i) {
      const NodeRow& row = of_tile[i];
      bounced[tiles[t] + i] = reflectedLight(row.node.albedo, row.node.area_m2, row.direct, row.row, light);
    }
    done.add();
  });
  return bounced;
}

}  // namespace ff::bake
