#include "bake/bake.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <xxhash.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <memory>
#include <new>
#include <optional>
#include <system_error>
#include <thread>
#include <utility>

#include "bake/cleanup/open_edges.h"
#include "bake/cleanup/scene_names.h"
#include "bake/cleanup/slivers.h"
#include "bake/estimate.h"
#include "bake/light/form_factor.h"
#include "bake/light/row_error.h"
#include "bake/matrix/patch_rows.h"
#include "bake/matrix/pyramid.h"
#include "bake/matrix/row_samples.h"
#include "bake/matrix/row_sampling.h"
#include "bake/memory.h"
#include "bake/not_modelled.h"
#include "bake/paging.h"
#include "bake/progress_report.h"
#include "bake/rays/ray_caster.h"
#include "bake/rays/surface_sampling.h"
#include "bake/sorting.h"
#include "bake/spill.h"
#include "bake/surface/patch_size.h"
#include "bake/surface/patches.h"
#include "bake/world_grids.h"
#include "formats/codec/strip_codec.h"
#include "formats/version.h"
#include "formats/write/writer.h"

namespace ff::bake {
namespace {

using Clock = std::chrono::steady_clock;
double since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }

Result<void> checkSettings(const Scene& scene, const BakeSettings& s) {
  const auto usage = [&](std::string message, std::string remedy) {
    return Error{ErrorCode::kUsage, scene.name, "", std::move(message), std::move(remedy)};
  };
  if (s.rays < 1 || s.rays > 65535) return usage("rays must be 1 to 65535", "4096 is a good value");
  if (!(s.target_error >= 0 && s.target_error < 1)) return usage("the error asked for must be above 0 and below 100 %", "2% is a good value");
  if (s.quanta < 1 || s.quanta > formats::kMaxQuanta) return usage("quanta must be 1 to " + std::to_string(formats::kMaxQuanta), "512 is a good value");
  if (!(s.cell_m >= 0) || !std::isfinite(s.cell_m)) return usage("patch size must be positive", "give metres");
  if (!(s.metals >= 0 && s.metals <= 1)) return usage("the share of metals must be 0 to 1", "1 is a good value");
  if (scene.triangles.empty())
    return Error{ErrorCode::kInvalidFile, scene.name, "", "the scene has no triangles", "export its meshes as triangles"};
  if (s.cell_m == 0 && s.patch_budget < 1) return usage("patch budget must be positive", "60000 is a good value");
  return {};
}

RayBudget budgetOf(const BakeSettings& settings) { return {settings.rays, settings.target_error / kNearlyAll}; }

// Where surfaces overlap, rays from one end of a pair meet what those from the other do not, and the pooled row does not add up: a
// free detector. Off by more than a fifth, or four times the noise of few rays, on so much of the surface, it is worth a line.
constexpr double kRowOff = 0.2, kRowOffRays = 4, kRowOffShare = 0.005;
// So much of the light that ends on the backs of single-sided surfaces is worth a line.
constexpr double kBacksShare = 0.01;

// Memory for what rays are cast at: a share of what there is when it is made.
constexpr double kCasterShare = 0.5;

// What sampling a tile's rows showed.
struct Sampling {
  double deviation = 0;  // see WorldInfo::row_total_deviation
  std::vector<std::pair<uint32_t, float>> off;  // patches whose rows do not add up, and by how much they miss
  uint64_t clamped = 0;
  std::vector<uint32_t> clamped_patches;  // by number, of level 0
};

// Appends what a row gets of each lamp group, relative to the group's emission.
void appendLamps(const ExchangeRow& row, float area_m2, std::span<const formats::LampGroup> groups, uint8_t number,
                 std::vector<formats::LampLight>& lamps) {
  for (const LampIrradiance& light : row.lamps) {
    formats::LampLight lamp{number, light.group, {}};
    for (int c = 0; c < 3; ++c)
      if (const float whole = groups[light.group].emission[c] * area_m2; whole > 0)
        lamp.weight[c] = std::min(formats::kLampWeightUnit, static_cast<float>(light.rgb[static_cast<size_t>(c)] / static_cast<double>(whole)));
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

// The rows of one tile, sampled and laid out as a strip. light: of all nodes of the level, as rowFactor() asks for it.
formats::Strip makeStrip(formats::TileId id, const Hierarchy& h, std::span<const NodeRow> rows, std::span<const LightValues> light,
                         std::span<const formats::LampGroup> lamp_groups, const BakeSettings& s, Sampling& sampling) {
  const auto& tiles = h.tile_start[id.level];
  formats::Strip strip;
  strip.id = id;
  strip.first_node = tiles[id.tile];
  struct Entry {
    uint32_t partner;
    uint8_t row, column;
    uint16_t count;
  };
  std::vector<Entry> entries, scratch;
  const uint32_t least = id.level == 0 ? s.quanta : std::max(1u, static_cast<uint32_t>(kClusterQuanta * s.quanta));
  const formats::TileName& name = h.names[id.level][id.tile];
  uint64_t seed = mix64(s.seed + id.level);  // of the name alone
  for (const int32_t x : name.chunk) seed = mix64(seed + static_cast<uint32_t>(x));
  seed = mix64(seed + name.tile);
  SampledRow sampled;
  for (size_t i = 0; i < rows.size(); ++i) {
    const ExchangeRow& row = rows[i].row;
    const float area_m2 = rows[i].node.area_m2;
    const auto n = static_cast<uint32_t>(strip.first_node + i);
    const uint32_t quanta = std::min(least * rowFactor(rows[i].direct, row, least, light), formats::kMaxQuanta);
    const double offset = unitOf(seed + i);
    sampleRow(row, area_m2, quanta, offset, sampled);
    sampling.deviation = std::max(sampling.deviation, std::abs(sampled.total - 1));
    if (id.level == 0 && std::abs(sampled.total - 1) > std::max(kRowOff, kRowOffRays / std::sqrt(static_cast<double>(budgetOf(s).fewest()))))
      sampling.off.emplace_back(n, static_cast<float>(sampled.total - 1));
    formats::Node node = rows[i].node;
    node.quanta = quanta;
    node.sky = sampled.sky;
    node.absorbed = sampled.absorbed;
    node.row_total = static_cast<float>(sampled.total);
    node.sky_fraction = std::min(1.0f, static_cast<float>(row.sky_m2) / area_m2);
    node.sky_direction = row.sky_means.direction;
    node.sky_quadratic = row.sky_means.quadratic;
    appendLamps(row, area_m2, lamp_groups, static_cast<uint8_t>(i), strip.lamps);
    const float seen = 1 - static_cast<float>(sampled.sky + sampled.absorbed) / static_cast<float>(quanta);
    const float most = seen > 0 ? kMaxReflected / seen : 1;
    if (std::max({node.albedo.x, node.albedo.y, node.albedo.z}) > most) {
      ++sampling.clamped;
      if (id.level == 0) sampling.clamped_patches.push_back(n);
    }
    node.albedo = ff::min(node.albedo, {most, most, most});
    strip.nodes.push_back(node);
    for (size_t k = 0, partner = 0; k < sampled.column.size(); ++k) {
      const uint32_t j = sampled.column[k];
      if (j >= tiles[partner + 1]) partner = static_cast<size_t>(std::upper_bound(tiles.begin() + static_cast<ptrdiff_t>(partner), tiles.end(), j) - tiles.begin() - 1);
      entries.push_back({static_cast<uint32_t>(partner), static_cast<uint8_t>(i), static_cast<uint8_t>(j - tiles[partner]), sampled.count[k]});
    }
  }
  sortByKey(entries, scratch, [](const Entry& e) { return e.partner; });
  strip.rows.reserve(entries.size());
  strip.columns.reserve(entries.size());
  strip.counts.reserve(entries.size());
  for (const Entry& e : entries) {
    if (strip.blocks.empty() || strip.blocks.back().partner_tile != e.partner) strip.blocks.push_back({e.partner, 0});
    ++strip.blocks.back().entries;
    strip.rows.push_back(e.row);
    strip.columns.push_back(e.column);
    strip.counts.push_back(e.count);
  }
  return strip;
}

uint32_t triangleOf(const PatchSet& set, uint32_t patch) { return set.triangles[set.patches[patch].first_triangle].source; }

std::optional<Finding> rowsThatAreOff(const Scene& scene, const PatchSet& set, std::span<const std::pair<uint32_t, float>> off,
                                      std::span<const uint32_t> patch_of) {
  PlaceSums places(scene);
  double area = 0, all = 0;
  float worst = 0;
  for (const auto& [node, miss] : off) {
    const Patch& patch = set.patches[patch_of[node]];
    const auto own = static_cast<double>(patch.area_m2);
    area += own;
    places.add(triangleOf(set, patch_of[node]), own, patch.centroid);
    if (std::abs(miss) > std::abs(worst)) worst = miss;
  }
  for (const Patch& p : set.patches) all += static_cast<double>(p.area_m2);
  if (!(area > kRowOffShare * all)) return {};
  Finding finding{"overlaps", "the rows of " + std::to_string(off.size()) + (off.size() == 1 ? " patch do" : " patches do") + " not add up, the worst by " +
                  percent(static_cast<double>(worst)) + ", as surfaces overlap there", off.size(), "patches", area / all, "surface"};
  places.putInto(finding);
  finding.remedy = "leave one of them out (--exclude), or cut away what lies under the other";
  return finding;
}

std::optional<Finding> lightOnBacks(const Scene& scene, const PatchSet& set, const PutAside& hits, double share) {
  const bool other = std::any_of(scene.materials.begin(), scene.materials.end(), [](const Material& m) { return m.occlude_only; });
  if (other || !(share > kBacksShare)) return {};
  Finding finding{"leaks", "", 0, "patches", share, "light"};
  double all = 0;
  for (size_t i = 0; i < set.patches.size(); ++i) {
    finding.count += hits.sight[i].absorbed > 0;
    all += static_cast<double>(set.patches[i].area_m2) * hits.sight[i].absorbed / hits.sight[i].rays;
  }
  finding.what = "light that leaves " + std::to_string(finding.count) + (finding.count == 1 ? " patch" : " patches") + " ends on the backs of single-sided surfaces";
  finding.places = placesOf(scene, hits.leaks(set.cell_m, kMaxPlaces), all);
  finding.remedy = "close what is open, or treat them otherwise with --backs reflect or --backs pass";
  return finding;
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
  put(&s.target_error, sizeof s.target_error);
  put(&s.quanta, sizeof s.quanta);
  put(&s.seed, sizeof s.seed);
  put(&s.metals, sizeof s.metals);
  if (s.merge_error > 0) put(&s.merge_error, sizeof s.merge_error);
  put(&s.geometry, sizeof s.geometry);
  put(&s.preview, sizeof s.preview);
  put(scene.name.c_str(), scene.name.size() + 1);  // the manifest holds it
  put(FF_VERSION, sizeof FF_VERSION);
  put(&kBakeCode, sizeof kBakeCode);
  XXH128_canonical_t digest;
  XXH128_canonicalFromHash(&digest, XXH3_128bits(bytes.data(), bytes.size()));
  std::array<uint8_t, 16> key;
  std::memcpy(key.data(), digest.digest, key.size());
  return key;
}

namespace {

void keep(std::optional<Finding> found, std::vector<Finding>& findings) {
  if (found) findings.push_back(std::move(*found));
}

// What rays are cast at and from.
struct Surface {
  Surface(const Scene& whole, Cleanup done) : clean(std::move(done)), scene(clean.scene ? *clean.scene : whole) {}
  const Cleanup clean;
  const Scene& scene;
  std::vector<Finding> findings;
  std::optional<RayCaster> caster;
  PatchSet set;
};

int threadsOf(const BakeSettings& settings) {
  return std::max(1, settings.threads > 0 ? settings.threads : static_cast<int>(std::thread::hardware_concurrency()));
}

// check: called with the scene as it is baked, before the work. look: for what is odd about it.
Result<std::unique_ptr<Surface>> makeSurface(const Scene& whole, const BakeSettings& settings, const Progress& progress, bool look,
                                             const std::function<Result<void>(const Scene&)>& check) {
  auto clean = cleanUp(whole, settings.cleanup);
  if (!clean) return clean.error();
  auto surface = std::make_unique<Surface>(whole, std::move(*clean));
  const Scene& scene = surface->scene;
  if (auto ok = checkSettings(scene, settings); !ok) return ok.error();
  if (auto ok = check(scene); !ok) return ok.error();
  auto caster = RayCaster::create(scene, static_cast<uint64_t>(kCasterShare * static_cast<double>(spareMemory(settings.memory_bytes))));
  if (!caster) return caster.error();
  surface->caster.emplace(std::move(*caster));
  ProgressReport report(progress, "patches", 0, settings.stop);
  surface->findings = surface->clean.findings;
  if (look) {
    keep(findSlivers(scene), surface->findings);
    keep(findOpenEdges(scene, *surface->caster, report.count), surface->findings);
  }
  const PatchSettings cut{.cell_m = settings.cell_m, .done = &report.count, .metals = settings.metals, .merge_error = settings.merge_error};
  auto set = settings.cell_m > 0 ? makePatches(scene, cut, &*surface->caster) : patchesWithin(settings.patch_budget, scene, cut, *surface->caster);
  if (!set) return set.error();
  surface->set = std::move(*set);
  return surface;
}

Result<BakeStats> bake(const Scene& whole, const BakeSettings& settings, const std::string& path, const Progress& progress) {
  const auto began = Clock::now();
  tbb::global_control limit(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threadsOf(settings)));
  std::optional<formats::WorldWriter> writer;
  auto surface = makeSurface(whole, settings, progress, true, [&](const Scene& scene) -> Result<void> {
    const BakeEstimate estimate = estimateBake(scene, settings);
    if (settings.announce) settings.announce(estimate);
    if (auto fits = checkFits(scene, settings, estimate); !fits) return fits;
    if (auto space = checkSpace(path, settings, estimate); !space) return space;
    auto created = formats::WorldWriter::create(path);
    if (!created) return created.error();
    writer.emplace(std::move(*created));
    return {};
  });
  if (!surface) return surface.error();
  giveBackMemory();
  const Scene& scene = (*surface)->scene;
  const RayCaster& caster = *(*surface)->caster;
  PatchSet& set = (*surface)->set;
  const size_t n = set.patches.size();

  // Rays: hits are put aside, range by range.
  BakeStats stats;
  stats.findings = std::move((*surface)->findings);
  stats.cell_m = set.cell_m;
  stats.unmerged_patches = set.unmerged;
  stats.merged_patches = set.merged;
  stats.triangles = scene.triangles.size();
  stats.without_area = scene.without_area;
  const auto cast_began = Clock::now();
  PutAside hits(n, path, spareMemory(settings.memory_bytes) / 8);
  {
    const RayBudget budget = budgetOf(settings);
    ProgressReport report(progress, "rays", n, settings.stop);
    const TakeRows take = [&](uint32_t first, HitRows rows) { hits.put(first, rows); };
    if (settings.cache) RayUnits(scene, set, caster, budget, settings.seed, *settings.cache).cast(report.count, stats.cached, take, settings.ranks);
    else castRows(scene, set, caster, budget, settings.seed, report.count, take);
  }
  const PagedVector<SunLight> sun = sunOnPatches(scene, set, caster, settings.seed);
  (*surface)->caster.reset();
  set.forgetPieces();
  giveBackMemory();
  stats.ray_seconds = since(cast_began);
  PagedVector<float> sky(n), lamp_light(n), whole_area(n);
  PagedVector<uint8_t> narrow(n);
  double square_error = 0;
  for (size_t i = 0; i < n; ++i) {
    const PatchSight& sight = hits.sight[i];
    const double rays = sight.rays, a = static_cast<double>(set.patches[i].area_m2);
    stats.rays += sight.rays;
    stats.fewest_rays = i == 0 ? sight.rays : std::min<uint32_t>(stats.fewest_rays, sight.rays);
    square_error += static_cast<double>(sight.square_error);
    sky[i] = sight.sky_fraction / sight.exposed();
    narrow[i] = sight.narrow;
    lamp_light[i] = sight.lamp_light;
    stats.sky_fraction += a * static_cast<double>(sight.sky_fraction);
    stats.absorbed_fraction += a * sight.absorbed / rays;
    stats.buried_fraction += a * sight.buried / rays;
    whole_area[i] = set.patches[i].area_m2;
    set.patches[i].area_m2 *= sight.exposed();
  }
  stats.mean_rays = static_cast<uint32_t>(stats.rays / n);
  stats.row_error = kNearlyAll * static_cast<float>(std::sqrt(square_error / static_cast<double>(n)));
  stats.cast_rays = stats.rays - stats.cached.clean_rays;
  stats.area_m2 = set.area_m2 - stats.buried_fraction;
  stats.buried_fraction = (stats.buried_fraction + set.sealed_m2) / (set.area_m2 + set.sealed_m2);
  stats.sky_fraction /= stats.area_m2;
  stats.absorbed_fraction /= stats.area_m2;
  keep(lightOnBacks(scene, set, hits, stats.absorbed_fraction), stats.findings);

  // Pooling and the pyramid.
  const Hierarchy hierarchy = makeHierarchy(set.patches, sky, narrow, lamp_light);
  PagedVector<uint32_t> patch_of(n);
  for (uint32_t p = 0; p < n; ++p) patch_of[hierarchy.number[p]] = p;
  uint64_t tiles_total = 0;
  for (const auto& t : hierarchy.tile_start) tiles_total += t.size() - 1;
  Spill rows_aside(path, spareMemory(settings.memory_bytes) / 8);
  PagedVector<double> density(n);
  for (size_t i = 0; i < n; ++i) density[hierarchy.number[i]] = hits.sight[i].rays / static_cast<double>(whole_area[i]);
  std::vector<LevelRows> levels;
  std::vector<PagedVector<LightValues>> light;  // of all nodes, by level
  {
    ProgressReport report(progress, "pyramid", hits.ranges() + hierarchy.tile_start[0].size() - 1 + tiles_total, settings.stop);
    for (uint32_t l = 0; l < hierarchy.levels(); ++l)
      levels.emplace_back(hierarchy.tile_start[l].size() - 1, rows_aside);
    light.push_back(poolPatches({set.patches, whole_area, sun, patch_of, density}, hierarchy, hits, path, settings.memory_bytes, levels[0], report.count, stats.spilled_bytes));
    for (uint32_t l = 1; l < hierarchy.levels(); ++l) light.push_back(gatherClusters(levels[l - 1], light[l - 1], hierarchy, l, levels[l], report.count));
  }
  stats.spilled_bytes += hits.spilled() + rows_aside.written() + pagedBytes().most;
  giveBackMemory();
  const std::vector<formats::LampGroup> lamp_groups = describeLamps(groupLamps(scene), set.patches);

  // Strips, coarsest level first; batches are sampled and encoded in parallel and written in order.
  double deviation = 0;
  std::vector<std::pair<uint32_t, float>> off;
  std::vector<uint32_t> lowered;  // patches whose albedo was lowered, by number
  stats.levels.resize(hierarchy.levels());
  {
    ProgressReport report(progress, "strips", tiles_total, settings.stop);
    constexpr uint32_t kBatch = 32;
    tbb::enumerable_thread_specific<std::vector<NodeRow>> scratch;  // of a tile
    for (uint32_t l = hierarchy.levels(); l-- > 0;) {
      LevelStats& level = stats.levels[l];
      level.nodes = hierarchy.nodes[l];
      level.tiles = static_cast<uint32_t>(hierarchy.tile_start[l].size()) - 1;
      for (uint32_t first = 0; first < level.tiles; first += kBatch) {
        const uint32_t count = std::min(kBatch, level.tiles - first);
        std::vector<std::unique_ptr<Result<formats::EncodedStrip>>> encoded(count);
        std::vector<Sampling> sampling(count);
        tbb::parallel_for(0u, count, [&](uint32_t k) {
          std::vector<NodeRow>& rows = scratch.local();
          levels[l].get(first + k, rows);
          const formats::Strip strip = makeStrip({l, first + k}, hierarchy, rows, light[l], lamp_groups, settings, sampling[k]);
          Box bounds;
          for (const NodeRow& row : rows) bounds.add(row.bounds);
          encoded[k] = std::make_unique<Result<formats::EncodedStrip>>(formats::encodeStrip(strip, bounds, hierarchy.names[l]));
        });
        for (uint32_t k = 0; k < count; ++k) {
          if (!*encoded[k]) return encoded[k]->error();
          deviation = std::max(deviation, sampling[k].deviation);
          stats.clamped_nodes += sampling[k].clamped;
          off.insert(off.end(), sampling[k].off.begin(), sampling[k].off.end());
          lowered.insert(lowered.end(), sampling[k].clamped_patches.begin(), sampling[k].clamped_patches.end());
          level.entries += (*encoded[k])->info.entries;
          level.stored_bytes += (*encoded[k])->info.strip.stored_bytes;
          if (auto ok = writer->addStrip(std::move(**encoded[k])); !ok) return ok.error();
          report.count.add();
        }
      }
      release(light[l]);
    }
  }

  formats::WorldInfo info;
  info.cell_m = set.cell_m;
  info.origin = scene.origin;
  for (const Patch& p : set.patches) info.bounds.add(p.bounds);
  info.rays = stats.mean_rays;
  info.fewest_rays = stats.fewest_rays;
  info.target_error = settings.target_error;
  info.row_error = stats.row_error;
  info.preview = settings.preview;
  info.quanta = settings.quanta;
  info.seed = settings.seed;
  info.bake_key = bakeKey(scene, settings, set.cell_m);
  info.generator = "ffbake " FF_VERSION;
  info.scene = scene.name;
  info.row_total_deviation = static_cast<float>(deviation);
  info.area_m2 = stats.area_m2;
  info.triangles = scene.triangles.size();
  info.absorbed_fraction = stats.absorbed_fraction;
  info.lamp_groups = lamp_groups;
  info.lights = scene.lights;

  // Drawing geometry.
  keep(rowsThatAreOff(scene, set, off, patch_of), stats.findings);
  const auto& tiles = hierarchy.tile_start[0];
  if (settings.geometry) {
    ProgressReport report(progress, "geometry", tiles.size() - 1, settings.stop);
    for (uint32_t t = 0; t + 1 < tiles.size(); ++t, report.count.add()) {
      formats::TileGeometry geometry;
      geometry.tile = t;
      const auto draw = [&](uint32_t node, const auto& triangles) {
        for (const auto& triangle : triangles) {
          if (isSeenThrough(scene.materials[scene.triangles[triangle.source].material])) continue;
          geometry.positions.insert(geometry.positions.end(), {triangle.a, triangle.b, triangle.c});
          geometry.patch.push_back(static_cast<uint8_t>(node - tiles[t]));
        }
      };
      for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i) {
        const Patch& patch = set.patches[patch_of[i]];
        draw(i, std::span(set.triangles).subspan(patch.first_triangle, patch.triangles));
      }
      const size_t exposed = geometry.patch.size();
      for (uint32_t i = tiles[t]; i < tiles[t + 1]; ++i)
        draw(i, std::ranges::equal_range(set.sealed, patch_of[i], {}, &SealedTriangle::patch));
      geometry.sealed = static_cast<uint32_t>(geometry.patch.size() - exposed);
      if (auto ok = writer->addGeometry(geometry, info); !ok) return ok.error();
    }
  }

  const std::vector<std::span<const uint32_t>> parents(hierarchy.parents.begin(), hierarchy.parents.end());
  if (auto ok = writer->finish(info, parents); !ok) return ok.error();
  if (settings.cache) {
    settings.cache->trim();
    for (std::string& line : settings.cache->warnings()) stats.warnings.push_back(std::move(line));
  }
  stats.warnings.insert(stats.warnings.end(), writer->warnings().begin(), writer->warnings().end());
  if (!settings.vdb_path.empty()) {
    std::vector<GridPatch> patches;
    for (size_t p = 0; p < n; ++p) patches.push_back({set.patches[p].cell, hits.sight[p].square_error});
    if (auto ok = writeWorldGrids(settings.vdb_path, patches, set.cell_m, scene.origin); !ok) return ok.error();
  }
  for (Finding& finding : notModelled(scene)) stats.findings.push_back(std::move(finding));
  for (uint32_t& i : lowered) i = patch_of[i];
  keep(loweredAlbedos(scene, set, lowered), stats.findings);
  stats.seconds = since(began);
  return stats;
}

Result<void> help(const Scene& whole, const BakeSettings& settings) {
  tbb::global_control limit(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threadsOf(settings)));
  const auto surface = makeSurface(whole, settings, {}, false, [&](const Scene& scene) { return checkFits(scene, settings, estimateBake(scene, settings)); });
  if (!surface) return surface.error();
  WorkCount done(0, settings.stop);
  RayUnits((*surface)->scene, (*surface)->set, *(*surface)->caster, budgetOf(settings), settings.seed, *settings.cache).help(done, *settings.ranks);
  return {};
}

Result<BakeStatus> status(const Scene& whole, const BakeSettings& settings, const Progress& progress) {
  tbb::global_control limit(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threadsOf(settings)));
  const auto surface = makeSurface(whole, settings, progress, false, [&](const Scene& scene) { return checkFits(scene, settings, estimateBake(scene, settings)); });
  if (!surface) return surface.error();
  const PatchSet& set = (*surface)->set;
  ProgressReport report(progress, "rays", set.patches.size(), settings.stop);
  BakeStatus status;
  status.cell_m = set.cell_m;
  status.patches = set.patches.size();
  status.cached = RayUnits((*surface)->scene, set, *(*surface)->caster, budgetOf(settings), settings.seed, *settings.cache).status(report.count, status.changed);
  return status;
}

// What libraries throw, as errors. folder: of arrays that memory has no room for.
template <class F>
auto caught(const Scene& scene, const BakeSettings& settings, const std::string& folder, F f) -> decltype(f()) {
  try {
    const Paging paging(folder, settings.memory_bytes);
    return f();
  } catch (const Stopped&) {
    return Error{ErrorCode::kIo, scene.name, "", "the bake was stopped", "", ErrorCause::kStopped};
  } catch (const SpillFailed& failed) {
    return failed.error;
  } catch (const std::bad_alloc&) {  // the estimate was too low
    return Error{ErrorCode::kIo, scene.name, "", "the bake ran out of memory", "use a larger --patch-size or a smaller --memory"};
  } catch (const std::system_error& e) {  // of threads: files have errors of their own
    return Error{ErrorCode::kIo, scene.name, "", std::string("the bake ran out of threads: ") + e.what(), "use fewer --threads, or raise the limit on processes"};
  } catch (const std::exception& e) {  // OpenVDB's, TBB's
    return Error{ErrorCode::kIo, scene.name, "", std::string("the bake cannot go on: ") + e.what(), "report this, with the scene"};
  }
}

}  // namespace

Result<BakeStats> bakeWorld(const Scene& whole, const BakeSettings& settings, const std::string& path, const Progress& progress) {
  return caught(whole, settings, formats::folderOf(path), [&] { return bake(whole, settings, path, progress); });
}

Result<void> helpBake(const Scene& whole, const BakeSettings& settings) {
  return caught(whole, settings, settings.cache->folder(), [&] { return help(whole, settings); });
}

Result<BakeStatus> bakeStatus(const Scene& whole, const BakeSettings& settings, const Progress& progress) {
  return caught(whole, settings, settings.cache->folder(), [&] { return status(whole, settings, progress); });
}

}  // namespace ff::bake
