// ff_bench_bake [--quick]: speed, size, memory and accuracy of ffbake on voxel towns, beside bare Embree in the same run.
// Prints one JSON object a line (metric, value, unit, limit, note).
#include <embree3/rtcore.h>
#include <tbb/parallel_for.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <type_traits>
#include <vector>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "bake/light/form_factor.h"
#include "bake/light/row_error.h"
#include "formats/read/reader.h"
#include "tests/support/analytic_scenes.h"
#include "tools/chart/patch_rows.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace {

using namespace ff;
using namespace ff::bake;
using Clock = std::chrono::steady_clock;

double since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }
double median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  return v[v.size() / 2];
}

template <class T>
T orExit(Result<T> result) {
  if (!result) {
    std::cerr << "ff_bench_bake: " << result.error().line() << "\n";
    std::exit(static_cast<int>(result.error().code));
  }
  return std::move(*result);
}

void print(const char* metric, double value, const char* unit, double limit, const std::string& note) {
  nlohmann::json j{{"metric", metric}, {"value", value}, {"unit", unit}, {"note", note}};
  j["limit"] = std::isfinite(limit) ? nlohmann::json(limit) : nlohmann::json(nullptr);
  std::cout << j.dump() << std::endl;
}
constexpr double kNoLimit = std::numeric_limits<double>::quiet_NaN();

Scene imported(const std::filesystem::path& folder, const tools::Town& t) {
  const std::string path = (folder / "town.glb").string();
  if (auto ok = tools::writeGlb(tools::townModel(t, false), path); !ok) {
    std::cerr << ok.error().line() << "\n";
    std::exit(2);
  }
  return orExit(importGltf(path));
}

Scene town(const std::filesystem::path& folder, uint64_t patches) {
  return imported(folder, orExit(tools::makeTown({.patches = patches})));
}

// What ffbake says of a bake of its own process, so that its memory is nobody else's.
nlohmann::json baked(const std::filesystem::path& folder, uint32_t rays, uint64_t memory_bytes) {
  std::string command = std::string(FF_BAKE_TOOL) + " " + (folder / "town.glb").string() + " -o " + (folder / "town.ffm").string() +
                        " --patch-size 1 --no-cache --quiet --json --rays " + std::to_string(rays);
  if (memory_bytes > 0) command += " --memory " + std::to_string(memory_bytes);
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(popen(command.c_str(), "r"), pclose);
  std::string text;
  std::array<char, 4096> part;
  for (size_t n = 0; pipe && (n = fread(part.data(), 1, part.size(), pipe.get())) > 0;) text.append(part.data(), n);
  auto stats = nlohmann::json::parse(text, nullptr, false);
  if (!stats.is_object()) {
    std::cerr << "ff_bench_bake: this failed: " << command << "\n";
    std::exit(2);
  }
  return stats;
}

// The shares of a bake's patches whose rows, and whose light of lamps, are cast again for what was edited; the bake is in the cache.
struct CastAgain {
  double rows = 0, lamps = 0;
};
CastAgain castAgain(const Scene& edited, const BakeSettings& settings) {
  const CachedRays cached = orExit(bakeStatus(edited, settings)).cached;
  const auto again = [&](const CachedRays::Patches& of) { return 1 - static_cast<double>(of.clean) / static_cast<double>(cached.patches()); };
  return {again(cached.rows), again(cached.lamps)};
}

// And a house of 3.5 x 3.5 x 5.5 m.
double editShare(const Scene& town, Vec3 ground, const BakeSettings& settings) {
  Scene edited = town;
  test::addBlock(edited, ground - Vec3{1.75f, 0, 1.75f}, ground + Vec3{1.75f, 5.5f, 1.75f}, town.triangles[0].material, false);
  return castAgain(edited, settings).rows;
}

// The street lamp nearest to a place is moved upwards by 1 m.
Scene withLampMoved(const Scene& town, Vec3 place) {
  Scene edited = town;
  const auto middle = [&](const Triangle& t) { return (town.positions[t.v[0]] + town.positions[t.v[1]] + town.positions[t.v[2]]) / 3; };
  const auto isLamp = [&](const Triangle& t) { return town.materials[t.material].name == "street lamp"; };
  Vec3 lamp{1e9f, 1e9f, 1e9f};
  for (const Triangle& t : town.triangles)
    if (isLamp(t) && length(middle(t) - place) < length(lamp - place)) lamp = middle(t);
  for (Triangle& t : edited.triangles) {
    if (!isLamp(t) || length(middle(t) - lamp) > 2) continue;
    for (uint32_t& v : t.v) {
      const Vec3 to = town.positions[v] + Vec3{0, 1, 0};
      if (!edited.uv0.empty()) edited.uv0.push_back(Vec2(edited.uv0[v]));
      if (!edited.uv1.empty()) edited.uv1.push_back(Vec2(edited.uv1[v]));
      if (!edited.colors.empty()) edited.colors.push_back(Rgba(edited.colors[v]));
      v = static_cast<uint32_t>(edited.positions.size());
      edited.positions.push_back(to);
    }
  }
  return edited;
}

// Embree with a scene's triangles, and nothing else.
struct BareEmbree {
  RTCDevice device = rtcNewDevice(nullptr);
  RTCScene scene = rtcNewScene(device);

  explicit BareEmbree(const Scene& from) {
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<Vec3*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(Vec3),
                                                                from.positions.size()));
    auto* corners = static_cast<uint32_t*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                                   3 * sizeof(uint32_t), from.triangles.size()));
    std::copy(from.positions.begin(), from.positions.end(), vertices);
    for (const Triangle& t : from.triangles) corners = std::copy(t.v.begin(), t.v.end(), corners);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
  }
  ~BareEmbree() {
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
  }

  // N rays by one call. Returns a sum of what they hit.
  template <int N>
  uint64_t intersect(const Ray* rays, bool coherent) const {
    alignas(64) RTCRayHitNt<N> hits{};
    alignas(64) std::array<int, N> valid;
    valid.fill(-1);
    for (int k = 0; k < N; ++k) {
      const auto& [origin, direction] = rays[k];
      hits.ray.org_x[k] = origin.x, hits.ray.org_y[k] = origin.y, hits.ray.org_z[k] = origin.z;
      hits.ray.dir_x[k] = direction.x, hits.ray.dir_y[k] = direction.y, hits.ray.dir_z[k] = direction.z;
      hits.ray.tfar[k] = std::numeric_limits<float>::infinity();
      hits.ray.mask[k] = ~0u;
      hits.hit.geomID[k] = hits.hit.primID[k] = hits.hit.instID[0][k] = RTC_INVALID_GEOMETRY_ID;
    }
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    if (coherent) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    if constexpr (N == 1) rtcIntersect1(scene, &context, reinterpret_cast<RTCRayHit*>(&hits));
    if constexpr (N == 4) rtcIntersect4(valid.data(), scene, &context, reinterpret_cast<RTCRayHit4*>(&hits));
    if constexpr (N == 8) rtcIntersect8(valid.data(), scene, &context, reinterpret_cast<RTCRayHit8*>(&hits));
    if constexpr (N == 16) rtcIntersect16(valid.data(), scene, &context, reinterpret_cast<RTCRayHit16*>(&hits));
    return std::accumulate(std::begin(hits.hit.primID), std::end(hits.hit.primID), uint64_t{0});
  }
};

// By octant, then by cell of the octahedral map: so that rays of a packet go about the same way.
uint32_t directionCell(Vec3 d) {
  const float sum = std::abs(d.x) + std::abs(d.y) + std::abs(d.z);
  uint32_t cell = std::signbit(d.x) | std::signbit(d.y) << 1 | std::signbit(d.z) << 2;
  const std::array<uint32_t, 2> at = {static_cast<uint32_t>(15.99f * std::abs(d.x) / sum), static_cast<uint32_t>(15.99f * std::abs(d.y) / sum)};
  for (int bit = 3; bit >= 0; --bit)
    for (const uint32_t x : at) cell = cell << 1 | (x >> bit & 1);
  return cell;
}

// Rays per second of one of Embree's calls and nothing else, all threads.
struct BareSpeed {
  std::string call;
  double rays_per_s = 0;
};

// Over rays made beforehand, those of up to 512 patches: rtcIntersect1, 4, 8 and 16 of rays as a patch draws them, and of each patch's rays sorted by direction, as a
// coherent lot. Medians of 5 rounds; the first is rtcIntersect1 of rays as drawn.
std::vector<BareSpeed> bareSpeeds(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays) {
  const SobolTable sobol(rays);
  const size_t batch = std::min<size_t>(set.patches.size(), 512), stride = set.patches.size() / batch;
  std::vector<Ray> drawn(batch * rays), sorted;
  tbb::parallel_for(size_t{0}, batch, [&](size_t b) {
    patchRays(scene, set, static_cast<uint32_t>(b * stride), sobol, 1, caster, std::span(drawn).subspan(b * rays, rays));
  });
  sorted = drawn;
  tbb::parallel_for(size_t{0}, batch, [&](size_t b) {
    const auto own = std::span(sorted).subspan(b * rays, rays);
    std::stable_sort(own.begin(), own.end(), [](const Ray& p, const Ray& q) { return directionCell(p.direction) < directionCell(q.direction); });
  });
  const BareEmbree embree(scene);
  std::atomic<uint64_t> sink{0};
  const auto speedOf = [&]<int N>(std::integral_constant<int, N>, bool coherent) {
    const Ray* const all = coherent ? sorted.data() : drawn.data();
    const auto began = Clock::now();
    tbb::parallel_for(size_t{0}, batch, [&](size_t b) {
      uint64_t sum = 0;
      for (size_t k = b * rays; k + N <= (b + 1) * rays; k += N) sum += embree.intersect<N>(all + k, coherent);
      sink += sum;
    });
    return static_cast<double>(drawn.size()) / since(began);
  };
  std::array<std::vector<double>, 8> rounds;
  for (int round = 0; round < 5; ++round)
    for (const bool coherent : {false, true}) {
      rounds[4 * size_t{coherent}].push_back(speedOf(std::integral_constant<int, 1>(), coherent));
      rounds[4 * size_t{coherent} + 1].push_back(speedOf(std::integral_constant<int, 4>(), coherent));
      rounds[4 * size_t{coherent} + 2].push_back(speedOf(std::integral_constant<int, 8>(), coherent));
      rounds[4 * size_t{coherent} + 3].push_back(speedOf(std::integral_constant<int, 16>(), coherent));
    }
  std::vector<BareSpeed> speeds;
  for (size_t way = 0; way < rounds.size(); ++way)
    speeds.push_back({"rtcIntersect" + std::string(std::array{"1", "4", "8", "16"}[way % 4]) + (way < 4 ? "" : ", sorted, coherent"), median(rounds[way])});
  return speeds;
}

// Relative L2 of reflected radiosity, sun and sky, rows of `rays` and `quanta` against pooled rows of 16384 other rays.
double rowError(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays, uint32_t quanta) {
  const std::vector<double> sun = chart::sunOnPatches(set, caster);
  WorkCount done;
  const auto solve = [&](const HitRows& hits, uint32_t q) {
    const chart::PatchRows rows = chart::pooledRows(set, hits, q);
    return chart::solveRows(set, rows, chart::sunAndSky(set, rows, sun));
  };
  return chart::reflectedDifference(solve(castRows(scene, set, caster, rays, 1, done), quanta),
                                    solve(castRows(scene, set, caster, 16384, 77, done), 0));
}

// What each patch's row brings in each made-up light (bake/light/row_error.h).
std::vector<std::array<double, MadeUpLight::kLights>> brought(const chart::PatchRows& rows, const MadeUpLight& light) {
  std::vector<std::array<double, MadeUpLight::kLights>> all(rows.sky.size());
  tbb::parallel_for(size_t{0}, all.size(), [&](size_t i) {
    for (uint64_t k = rows.start[i]; k < rows.start[i + 1]; ++k)
      for (size_t l = 0; l < MadeUpLight::kLights; ++l) all[i][l] += light.shines(rows.column[k], l) ? static_cast<double>(rows.f[k]) : 0;
  });
  return all;
}

// Root mean square over patches and made-up lights, relative to what the reference brings with the sky, or to RowError::kFloor where that is more.
double madeUpError(const chart::PatchRows& rows, const chart::PatchRows& reference, const MadeUpLight& light) {
  const auto is = brought(rows, light), should = brought(reference, light);
  double square = 0;
  for (size_t i = 0; i < is.size(); ++i)
    for (size_t l = 0; l < MadeUpLight::kLights; ++l) {
      const double off = (is[i][l] - should[i][l]) / std::max(should[i][l] + static_cast<double>(reference.sky[i]), RowError::kFloor);
      square += off * off;
    }
  return std::sqrt(square / static_cast<double>(is.size() * MadeUpLight::kLights));
}

// How much lower the error is than that of rows that each patch's rays alone tell; and if all pairs were known exactly of which rays expect two hits or more.
struct OverPlain {
  double pooled = 1, known = 1;
};
OverPlain overPlain(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint32_t rays) {
  WorkCount done;
  const HitRows hits = castRows(scene, set, caster, rays, 1, done);
  const chart::PatchRows reference = chart::pooledRows(set, castRows(scene, set, caster, 32768, 77, done), 0), pooled = chart::pooledRows(set, hits, 0);
  chart::PatchRows plain, known;
  plain.sky = known.sky = reference.sky;
  for (uint32_t i = 0; i < hits.patches(); ++i) {
    for (uint64_t k = hits.start[i]; k < hits.start[i + 1]; ++k) {
      plain.column.push_back(hits.column[k]);
      plain.f.push_back(static_cast<float>(hits.count[k]) / static_cast<float>(rays));
    }
    plain.start.push_back(plain.column.size());
    std::map<uint32_t, float> row;
    for (uint64_t k = pooled.start[i]; k < pooled.start[i + 1]; ++k) row[pooled.column[k]] = pooled.f[k];
    for (uint64_t k = reference.start[i]; k < reference.start[i + 1]; ++k) {
      const uint32_t j = reference.column[k];
      const float expected = reference.f[k] * static_cast<float>(rays) * (1 + set.patches[i].area_m2 / set.patches[j].area_m2);  // from both ends
      if (expected >= 2) row[j] = reference.f[k];
    }
    for (const auto& [j, f] : row) {
      known.column.push_back(j);
      known.f.push_back(f);
    }
    known.start.push_back(known.column.size());
  }
  const MadeUpLight light(set);
  const double alone = madeUpError(plain, reference, light);
  return {alone / madeUpError(pooled, reference, light), alone / madeUpError(known, reference, light)};
}

}  // namespace

int main(int argc, char** argv) {
  bool quick = false;
  uint64_t patches = 0, memory_bytes = 0;
  uint32_t rays = 4096;
  CLI::App app{"Benchmarks of the baker; JSON lines.", "ff_bench_bake"};
  app.add_flag("--quick", quick, "a town of 8,000 patches");
  app.add_option("--patches", patches, "of the town (60k)")->transform(CLI::AsSizeValue(true));
  app.add_option("--memory", memory_bytes, "of the whole bake, as for ffbake (what is free)")->transform(CLI::AsSizeValue(true));
  app.add_option("--rays", rays, "a patch, of the whole bake")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  if (patches == 0) patches = quick ? 8000 : 60000;
  const uint64_t small = quick ? 2000 : 8000, accurate = quick ? 4000 : 16000;
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_bake_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const std::string name = "voxel town, " + std::to_string(rays) + " rays, Q = 512";

  const tools::Town made = orExit(tools::makeTown({.patches = patches}));
  const Scene scene = imported(folder, made);
  const RayCaster caster = orExit(RayCaster::create(scene));
  const PatchSet set = orExit(makePatches(scene, {.cell_m = 1}, &caster));
  std::vector<BareSpeed> bare = bareSpeeds(scene, set, caster, rays);
  const nlohmann::json stats = baked(folder, rays, memory_bytes);
  const std::vector<BareSpeed> after = bareSpeeds(scene, set, caster, rays);
  for (size_t way = 0; way < bare.size(); ++way) bare[way].rays_per_s = (bare[way].rays_per_s + after[way].rays_per_s) / 2;  // the machine's speed drifts
  const BareSpeed& best = *std::max_element(bare.begin(), bare.end(), [](const BareSpeed& a, const BareSpeed& b) { return a.rays_per_s < b.rays_per_s; });
  const double seconds = stats["seconds"], speed = static_cast<double>(stats["rays"]) / seconds;
  const auto& level0 = stats["levels"][0];
  const double nodes = level0["nodes"];
  const std::string note = name + ", " + std::to_string(level0["nodes"].get<uint64_t>()) + " patches, whole bake after import";
  std::string calls;
  for (const BareSpeed& way : bare) calls += "; " + way.call + ": " + std::to_string(way.rays_per_s / 1e6);
  print("bake.rays_per_s", speed, "rays/s", best.rays_per_s, note + "; those of rows alone, rays towards lamps and the sky come on top; limit: the fastest of bare Embree's calls, same rays, all threads");
  print("bake.ratio_to_bare_embree", speed / best.rays_per_s, "ratio", 1, note + "; to " + best.call + ". Million rays a second" + calls);
  print("bake.ratio_to_rtcIntersect1", speed / bare[0].rays_per_s, "ratio", 1, note + "; of rays in the order in which a patch draws them");
  print("bake.peak_mib", static_cast<double>(stats["peak_bytes"]) / (1 << 20), "MiB", memory_bytes > 0 ? static_cast<double>(memory_bytes) / (1 << 20) : kNoLimit,
        note + ", with import; limit: --memory; put into files: " + std::to_string(stats["spilled_bytes"].get<uint64_t>() >> 20) + " MiB");
  double all = 0;
  for (const auto& l : stats["levels"]) all += l["stored_bytes"].get<double>();
  const auto world = orExit(formats::World::open((folder / "town.ffm").string()));
  print("bake.bytes_per_patch", static_cast<double>(world.levels()[0].stored_bytes) / nodes, "B", 190, note + "; level 0: rows, node records, index");
  print("bake.entries_per_row", level0["entries"].get<double>() / nodes, "entries", kNoLimit, note);
  print("bake.pyramid_over_level0", all / level0["stored_bytes"].get<double>(), "ratio", 1.6,
        note);

  // As ffbake does it: rays for an error of 2 %, with a cache; and an edit.
  const auto cache = orExit(BakeCache::open((folder / "cache").string(), uint64_t{1} << 40));
  const BakeSettings asked{.cell_m = 1, .rays = 16384, .target_error = 0.02f, .cache = cache.get()};
  const BakeStats at_target = orExit(bakeWorld(scene, asked, (folder / "town.ffm").string()));
  print("bake.rays_per_patch_at_target", at_target.mean_rays, "rays", kNoLimit,
        "for an error of 2 %, of which " + std::to_string(100 * static_cast<double>(at_target.row_error)) + " % measured; " +
            std::to_string(at_target.seconds) + " s, of " + std::to_string(rays) + " rays a patch " + std::to_string(seconds));
  const auto placeOf = [&](tools::Int3 voxel) {
    return Vec3{static_cast<float>(made.origin.x + voxel.x), 0, static_cast<float>(made.origin.z + voxel.z)} * made.cell_m;
  };
  Box all_of_it;
  for (const Vec3& at : scene.positions) all_of_it.add(at);
  const Vec3 street = placeOf({(made.street_from.x + made.street_to.x) / 2, 0, (made.street_from.z + made.street_to.z) / 2});
  const double corner = editShare(scene, {all_of_it.lo.x + 12, 0, all_of_it.lo.z + 12}, asked);
  print("bake.edit_share", editShare(scene, street, asked), "ratio", 0.1,
        "patches whose rays are cast again after a house of 4 m was built in the middle of the street through the town; in a corner of it " + std::to_string(corner) +
            ". Bound by what sees it, in groups of patches that a cube of 4 cells holds. Patches, pyramid and strips are made anew whole");
  Scene dimmed = scene;
  for (Material& m : dimmed.materials)
    if (m.name == "street lamp") m.emission = m.emission * 0.5f;
  const CastAgain moved = castAgain(withLampMoved(scene, street), asked), of_dimmed = castAgain(dimmed, asked);
  print("bake.edit_share_lamp", moved.rows, "ratio", kNoLimit,
        "patches whose rows are cast again after a street lamp there was moved by 1 m; their light of lamps, a fifth of casting: " + std::to_string(moved.lamps) +
            "; after all street lamps were dimmed: rows " + std::to_string(of_dimmed.rows) + ", light of lamps " + std::to_string(of_dimmed.lamps));

  const Scene little = town(folder, small);
  const BakeStats little_stats = orExit(bakeWorld(little, {.cell_m = 1, .rays = rays}, (folder / "little.ffm").string()));
  print("bake.cost_growth", (seconds / nodes) / (little_stats.seconds / static_cast<double>(little_stats.levels[0].nodes)),
        "ratio", 1,
        "seconds a patch at " + std::to_string(static_cast<uint64_t>(nodes)) + " patches over that at " +
            std::to_string(little_stats.levels[0].nodes));

  const RayCaster little_caster = orExit(RayCaster::create(little));
  const OverPlain over_plain = overPlain(little, orExit(makePatches(little, {.cell_m = 1}, &little_caster)), little_caster, 1024);
  print("bake.plain_error_over_ours", over_plain.pooled, "ratio", 1.8,
        "made-up lights, 1024 rays, before samples are drawn; against 32768 other rays. If all pairs of which rays expect two hits were known exactly: " +
            std::to_string(over_plain.known));

  const Scene probe = town(folder, accurate);
  const RayCaster probe_caster = orExit(RayCaster::create(probe));
  const PatchSet probe_set = orExit(makePatches(probe, {.cell_m = 1}, &probe_caster));
  print("bake.measured_error", rowError(probe, probe_set, probe_caster, 4096, 512), "relative L2", kNoLimit,
        "reflected radiosity, sun and sky, against pooled rows of 16384 other rays; " +
            std::to_string(probe_set.patches.size()) + " patches");
  std::filesystem::remove_all(folder);
  return 0;
}
