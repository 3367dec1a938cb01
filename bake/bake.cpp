#include "bake/bake.h"

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <xxhash.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "bake/form_factor.h"
#include "bake/patch_size.h"
#include "bake/patches.h"
#include "bake/pool.h"
#include "bake/pyramid.h"
#include "bake/ray_caster.h"
#include "bake/row_sampling.h"
#include "bake/spatial_index.h"
#include "bake/surface_sampling.h"
#include "formats/writer.h"
#include "tools/version.h"

namespace ff::bake {
namespace {

using Clock = std::chrono::steady_clock;
double since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }

// Reports a counter from a thread of its own until it goes out of scope.
class ProgressReport {
 public:
  ProgressReport(const Progress& progress, const char* phase, uint64_t total)
      : progress_(progress), phase_(phase), total_(total) {
    if (!progress_) return;
    progress_(phase_, 0, total_);
    thread_ = std::thread([this] {
      std::unique_lock lock(mutex_);
      while (!wake_.wait_for(lock, std::chrono::milliseconds(100), [this] { return stop_; }))
        progress_(phase_, done.load(std::memory_order_relaxed), total_);
    });
  }
  ~ProgressReport() {
    if (!thread_.joinable()) return;
    {
      std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_one();
    thread_.join();
    progress_(phase_, total_, total_);
  }
  std::atomic<uint64_t> done{0};

 private:
  const Progress& progress_;
  const char* phase_;
  uint64_t total_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread thread_;
};

Result<void> checkSettings(const Scene& scene, const BakeSettings& s) {
  const auto usage = [&](std::string message, std::string remedy) {
    return Error{ErrorCode::kUsage, scene.name, "", std::move(message), std::move(remedy)};
  };
  if (s.rays < 1 || s.rays > 65535) return usage("rays must be 1 to 65535", "4096 is a good value");
  if (s.quanta < 1 || s.quanta > formats::kMaxQuanta) return usage("quanta must be 1 to 65535", "512 is a good value");
  if (!(s.cell_m >= 0) || !std::isfinite(s.cell_m)) return usage("patch size must be positive", "give metres");
  if (!(s.metals >= 0 && s.metals <= 1)) return usage("the share of metals must be 0 to 1", "1 is a good value");
  if (scene.triangles.empty())
    return Error{ErrorCode::kInvalidFile, scene.name, "", "the scene has no triangles", "export its meshes as triangles"};
  if (s.cell_m == 0 && s.patch_budget < 1) return usage("patch budget must be positive", "60000 is a good value");
  return {};
}

// The scene less the triangles of the named materials.
Result<Scene> without(const Scene& scene, const std::vector<std::string>& names) {
  Scene rest = scene;
  for (const std::string& name : names) {
    const size_t before = rest.triangles.size();
    std::erase_if(rest.triangles, [&](const Triangle& t) { return rest.materials[t.material].name == name; });
    if (rest.triangles.size() == before)
      return Error{ErrorCode::kUsage, scene.name, "", "no triangle has a material named \"" + name + "\"",
                   "see the file's materials"};
  }
  return rest;
}

// What sampling a tile's rows showed.
struct Sampling {
  double deviation = 0;  // see WorldInfo::row_total_deviation
  uint64_t clamped = 0;
};

// Appends what a row gets of each lamp group, relative to the group's emission.
void appendLamps(const ExchangeRow& row, float area_m2, std::span<const formats::LampGroup> groups, uint8_t number,
                 std::vector<formats::LampLight>& lamps) {
  for (const LampIrradiance& light : row.lamps) {
    formats::LampLight lamp{number, light.group, {}};
    for (int c = 0; c < 3; ++c)
      if (const float whole = groups[light.group].emission[c] * area_m2; whole > 0)
        lamp.weight[c] = std::min(1.0f, static_cast<float>(light.rgb[static_cast<size_t>(c)] / static_cast<double>(whole)));
    if (!(lamp.weight == Vec3{})) lamps.push_back(lamp);
  }
}

// The groups as the world lists them.
std::vector<formats::LampGroup> describeLamps(const LampGroups& groups, std::span<const Patch> patches) {
  std::vector<formats::LampGroup> described;
  for (const std::string& name : groups.name) described.push_back({name, {}, 0, 0});
  for (const Patch& patch : patches) {
    if (!patch.emits()) continue;
    formats::LampGroup& group = described[patch.lamp_group];
    group.emission = ff::max(group.emission, patch.emission);
    group.area_m2 += static_cast<double>(patch.area_m2);
    ++group.patches;
  }
  return described;
}

// The rows of one tile, sampled and laid out as a strip.
formats::Strip makeStrip(formats::TileId id, const Hierarchy& h, const ExchangeLevel& exchange,
                         std::span<const NodeValues> values, std::span<const formats::LampGroup> lamp_groups,
                         const BakeSettings& s, Sampling& sampling) {
  const auto& tiles = h.tile_start[id.level];
  formats::Strip strip;
  strip.id = id;
  strip.first_node = tiles[id.tile];
  struct Entry {
    uint32_t partner;
    uint8_t row, column;
    uint16_t count;
  };
  std::vector<Entry> entries;
  const uint32_t quanta = id.level == 0 ? s.quanta : std::max(1u, static_cast<uint32_t>(kClusterQuanta * s.quanta));
  ExchangeRow row;
  SampledRow sampled;
  for (uint32_t n = tiles[id.tile]; n < tiles[id.tile + 1]; ++n) {
    exchange.row(n, row);
    const double offset = static_cast<double>(mix64(s.seed ^ (uint64_t{id.level} << 56) ^ (n + 1ull) * 0x9e3779b97f4a7c15ull) >> 11) * 0x1p-53;
    sampleRow(row, exchange.area(n), quanta, offset, sampled);
    sampling.deviation = std::max(sampling.deviation, std::abs(sampled.total - 1));
    formats::Node node = values[n].node;
    node.quanta = quanta;
    node.sky = sampled.sky;
    node.absorbed = sampled.absorbed;
    node.row_total = static_cast<float>(sampled.total);
    node.sky_fraction = std::min(1.0f, static_cast<float>(row.sky_m2) / exchange.area(n));
    node.sky_direction = row.sky_means.direction;
    node.sky_quadratic = row.sky_means.quadratic;
    appendLamps(row, exchange.area(n), lamp_groups, static_cast<uint8_t>(n - strip.first_node), strip.lamps);
    const float seen = 1 - static_cast<float>(sampled.sky + sampled.absorbed) / static_cast<float>(quanta);
    const float most = seen > 0 ? kMostReflected / seen : 1;
    if (std::max({node.albedo.x, node.albedo.y, node.albedo.z}) > most) ++sampling.clamped;
    node.albedo = ff::min(node.albedo, {most, most, most});
    strip.nodes.push_back(node);
    for (size_t k = 0; k < sampled.column.size(); ++k) {
      const uint32_t j = sampled.column[k];
      const auto partner = static_cast<uint32_t>(std::upper_bound(tiles.begin(), tiles.end(), j) - tiles.begin() - 1);
      entries.push_back({partner, static_cast<uint8_t>(n - strip.first_node), static_cast<uint8_t>(j - tiles[partner]),
                         sampled.count[k]});
    }
  }
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.partner < b.partner; });
  for (const Entry& e : entries) {
    if (strip.blocks.empty() || strip.blocks.back().partner_tile != e.partner) strip.blocks.push_back({e.partner, 0});
    ++strip.blocks.back().entries;
    strip.rows.push_back(e.row);
    strip.columns.push_back(e.column);
    strip.counts.push_back(e.count);
  }
  return strip;
}

}  // namespace

std::array<uint8_t, 16> bakeKey(const Scene& scene, const BakeSettings& s, float cell_m) {
  std::vector<std::byte> bytes;
  const auto put = [&](const void* p, size_t n) {
    const auto* b = static_cast<const std::byte*>(p);
    bytes.insert(bytes.end(), b, b + n);
  };
  put(scene.content_hash.data(), scene.content_hash.size());
  put(&cell_m, sizeof cell_m);
  put(&s.rays, sizeof s.rays);
  put(&s.quanta, sizeof s.quanta);
  put(&s.seed, sizeof s.seed);
  put(&s.metals, sizeof s.metals);
  for (const std::string& name : s.leave_out) put(name.c_str(), name.size() + 1);
  put(FF_VERSION, sizeof FF_VERSION);
  put(&kBakeCode, sizeof kBakeCode);
  XXH128_canonical_t digest;
  XXH128_canonicalFromHash(&digest, XXH3_128bits(bytes.data(), bytes.size()));
  std::array<uint8_t, 16> key;
  std::memcpy(key.data(), digest.digest, key.size());
  return key;
}

Result<BakeStats> bakeWorld(const Scene& whole, const BakeSettings& settings, const std::string& path,
                            const Progress& progress) {
  const auto began = Clock::now();
  std::optional<Scene> part;
  if (!settings.leave_out.empty()) {
    auto rest = without(whole, settings.leave_out);
    if (!rest) return rest.error();
    part = std::move(*rest);
  }
  const Scene& scene = part ? *part : whole;
  if (auto ok = checkSettings(scene, settings); !ok) return ok.error();
  const int threads = settings.threads > 0 ? settings.threads : static_cast<int>(std::thread::hardware_concurrency());
  tbb::global_control limit(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(std::max(1, threads)));
  auto writer = formats::WorldWriter::create(path);
  if (!writer) return writer.error();

  // Patches.
  auto caster = RayCaster::create(scene);
  if (!caster) return caster.error();
  auto set = [&] {
    ProgressReport report(progress, "patches", 1);
    const PatchSettings cut{.cell_m = settings.cell_m, .metals = settings.metals};
    return settings.cell_m > 0 ? makePatches(scene, cut, &*caster) : patchesWithin(settings.patch_budget, scene, cut, *caster);
  }();
  if (!set) return set.error();
  const size_t n = set->patches.size();

  // Rays.
  BakeStats stats;
  stats.cell_m = set->cell_m;
  stats.triangles = scene.triangles.size();
  const auto cast_began = Clock::now();
  HitRows hits;
  {
    ProgressReport report(progress, "rays", n);
    hits = castRows(scene, *set, *caster, settings.rays, settings.seed, report.done);
  }
  stats.ray_seconds = since(cast_began);
  std::vector<float> sky(n), whole_area(n);
  for (size_t i = 0; i < n; ++i) {
    stats.rays += hits.rays[i];
    const double rays = hits.rays[i], a = static_cast<double>(set->patches[i].area_m2);
    sky[i] = hits.sky_fraction[i] / exposedFraction(hits, i);
    stats.sky_fraction += a * static_cast<double>(hits.sky_fraction[i]);
    stats.absorbed_fraction += a * hits.absorbed[i] / rays;
    stats.buried_fraction += a * hits.buried[i] / rays;
    whole_area[i] = set->patches[i].area_m2;
    set->patches[i].area_m2 *= exposedFraction(hits, i);
  }
  stats.area_m2 = set->area_m2 - stats.buried_fraction;
  stats.buried_fraction = (stats.buried_fraction + set->sealed_m2) / (set->area_m2 + set->sealed_m2);
  stats.sky_fraction /= stats.area_m2;
  stats.absorbed_fraction /= stats.area_m2;

  // Pooling and the pyramid.
  const Hierarchy hierarchy = makeHierarchy(set->patches, sky, hits.narrow);
  std::vector<std::unique_ptr<ExchangeLevel>> exchange;
  std::vector<std::vector<NodeValues>> values;
  values.push_back(patchValues(set->patches, hierarchy));
  {
    ProgressReport report(progress, "pyramid", hierarchy.levels());
    std::vector<float> areas(n);
    for (size_t i = 0; i < n; ++i) areas[hierarchy.number[i]] = whole_area[i];
    HitRows ordered = renumber(hits, hierarchy.number);
    hits = {};
    exchange.push_back(std::make_unique<PooledPatches>(std::move(ordered), std::move(areas)));
    for (uint32_t l = 1; l < hierarchy.levels(); ++l) {
      exchange.push_back(
          std::make_unique<ClusterExchange>(*exchange.back(), hierarchy.parents[l - 1], hierarchy.nodes[l]));
      values.push_back(clusterValues(values.back(), hierarchy, l));
      report.done = l;
    }
  }

  const std::vector<formats::LampGroup> lamp_groups = describeLamps(groupLamps(scene), set->patches);

  // Strips, coarsest level first; batches are sampled and encoded in parallel and written in order.
  double deviation = 0;
  stats.levels.resize(hierarchy.levels());
  {
    uint64_t tiles_total = 0;
    for (const auto& t : hierarchy.tile_start) tiles_total += t.size() - 1;
    ProgressReport report(progress, "strips", tiles_total);
    constexpr uint32_t kBatch = 32;
    for (uint32_t l = hierarchy.levels(); l-- > 0;) {
      LevelStats& level = stats.levels[l];
      level.nodes = hierarchy.nodes[l];
      level.tiles = static_cast<uint32_t>(hierarchy.tile_start[l].size()) - 1;
      for (uint32_t first = 0; first < level.tiles; first += kBatch) {
        const uint32_t count = std::min(kBatch, level.tiles - first);
        std::vector<std::unique_ptr<Result<formats::EncodedStrip>>> encoded(count);
        std::vector<Sampling> sampling(count);
        tbb::parallel_for(0u, count, [&](uint32_t k) {
          const formats::Strip strip =
              makeStrip({l, first + k}, hierarchy, *exchange[l], values[l], lamp_groups, settings, sampling[k]);
          Box bounds;
          for (size_t i = 0; i < strip.nodes.size(); ++i) bounds.add(values[l][strip.first_node + i].bounds);
          encoded[k] = std::make_unique<Result<formats::EncodedStrip>>(formats::encodeStrip(strip, bounds));
        });
        for (uint32_t k = 0; k < count; ++k) {
          if (!*encoded[k]) return encoded[k]->error();
          deviation = std::max(deviation, sampling[k].deviation);
          stats.clamped_nodes += sampling[k].clamped;
          level.entries += (*encoded[k])->info.entries;
          level.stored_bytes += (*encoded[k])->info.stored_bytes;
          if (auto ok = writer->addStrip(std::move(**encoded[k])); !ok) return ok.error();
          ++report.done;
        }
      }
      exchange[l].reset();
    }
  }

  // Drawing geometry.
  std::vector<uint32_t> patch_of(n);
  for (uint32_t p = 0; p < n; ++p) patch_of[hierarchy.number[p]] = p;
  const auto& tiles = hierarchy.tile_start[0];
  if (settings.geometry) {
    ProgressReport report(progress, "geometry", tiles.size() - 1);
    for (uint32_t t = 0; t + 1 < tiles.size(); ++t, ++report.done) {
      formats::TileGeometry geometry;
      geometry.tile = t;
      for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) {
        const Patch& patch = set->patches[patch_of[i]];
        for (uint32_t k = 0; k < patch.triangles; ++k) {
          const PatchTriangle& triangle = set->triangles[patch.first_triangle + k];
          for (const Vec3& corner : {triangle.a, triangle.b, triangle.c}) geometry.positions.push_back(corner);
          geometry.patch.push_back(static_cast<uint8_t>(i - tiles[t]));
        }
      }
      if (auto ok = writer->addGeometry(geometry); !ok) return ok.error();
    }
  }

  // Manifest.
  std::vector<std::pair<Cell, uint32_t>> cell_tiles;
  for (uint32_t t = 0; t + 1 < tiles.size(); ++t)
    for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) cell_tiles.emplace_back(set->patches[patch_of[i]].cell, t);
  std::vector<float> cells;
  for (uint32_t l = 0; l < hierarchy.levels(); ++l) cells.push_back(std::ldexp(set->cell_m, static_cast<int>(l)));
  formats::WorldInfo info;
  info.cell_m = set->cell_m;
  for (const Patch& p : set->patches) info.bounds.add(p.bounds);
  info.rays = settings.rays;
  info.quanta = settings.quanta;
  info.seed = settings.seed;
  info.bake_key = bakeKey(scene, settings, set->cell_m);
  info.generator = "ffbake " FF_VERSION;
  info.scene = scene.name;
  info.row_total_deviation = static_cast<float>(deviation);
  info.area_m2 = stats.area_m2;
  info.triangles = scene.triangles.size();
  info.absorbed_fraction = stats.absorbed_fraction;
  info.lamp_groups = lamp_groups;
  if (auto ok = writer->finish(info, hierarchy.parents, cells, buildSpatialIndex(cell_tiles, set->cell_m)); !ok)
    return ok.error();
  stats.seconds = since(began);
  return stats;
}

}  // namespace ff::bake
