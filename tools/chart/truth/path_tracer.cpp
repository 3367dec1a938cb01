#include "tools/chart/truth/path_tracer.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <string>
#include <thread>

#include "bake/surface/lamp_groups.h"
#include "formats/read/whole_world.h"
#include "tools/chart/truth/sampling.h"
#include "tools/chart/truth/scene_surface.h"

namespace ff::chart {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;
constexpr int kSureBounces = 3;    // before roulette
constexpr int kMaxBounces = 4096;  // a path in a closed white room ends by roulette long before

constexpr float kLift = 4e-6f;  // of the largest coordinate

float largest(Vec3 p) { return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}); }

struct Facet {  // of the drawing geometry
  Vec3 a, ab, ac, normal;
  float cumulative_area = 0;  // within its patch
};

// A triangle that shines; how likely it is asked for light from one patch.
struct Emitter {
  uint32_t triangle = 0;
  Vec3 a, ab, ac, normal;
  float area_m2 = 0, power = 0;
  bool both_sides = false;
};

// Lamps are asked in proportion to their power over the squared distance from the patch; combined with the directions
// that the surface reflects to by the balance heuristic. Veach, Guibas. Optimally Combining Sampling Techniques for Monte
// Carlo Rendering. 1995.
struct LampChoice {
  std::vector<float> cumulative;  // by emitter; the last is the sum
  float share(size_t e) const { return (cumulative[e] - (e ? cumulative[e - 1] : 0)) / cumulative.back(); }
  bool any() const { return !cumulative.empty() && cumulative.back() > 0; }
};

struct Start {
  Vec3 point, normal, albedo;  // point: lifted off the surface
  bool found = false;
};

// Sums of a quantity by channel and batch of paths.
struct BatchSums {
  double of[3][kBatches] = {};
  // A ratio: of a patch that is mostly buried, batches have unlike numbers of paths, some none. Cochran. Sampling
  // Techniques. 1977, section 6.4.
  void mean(int channel, const double (&counted)[kBatches], double total, float& mean, float& error) const {
    const double(&x)[kBatches] = of[channel];
    double sum = 0, squares = 0;
    for (const double v : x) sum += v;
    sum /= total;
    for (uint32_t b = 0; b < kBatches; ++b) squares += (x[b] - sum * counted[b]) * (x[b] - sum * counted[b]);
    mean = static_cast<float>(sum);
    error = static_cast<float>(std::sqrt(squares * kBatches / (kBatches - 1)) / total);
    if (std::count(std::begin(counted), std::end(counted), 0.0) == kBatches - 1) error = std::abs(mean);
  }
};

}  // namespace

struct PathTracer::State {
  const bake::Scene* scene = nullptr;
  bake::LampGroups lamp_groups;  // by material
  RTCDevice device = nullptr;
  RTCScene solid = nullptr;    // the scene's triangles
  RTCScene drawing = nullptr;  // the world's drawing geometry
  std::vector<Vec3> normals;   // unit, per scene triangle
  std::vector<Facet> facets;   // by patch
  std::vector<uint32_t> facet_start, patch_of;  // per patch, + 1; per primitive of `drawing`
  std::vector<float> lifts;    // off a scene triangle's surface, m: its own rounding, whatever else lies far away
  float quantum = 0;           // how far drawing geometry may lie off the scene's, m
  mutable std::atomic<uint64_t> rays{0};
  std::string fault;

  ~State() {
    if (solid) rtcReleaseScene(solid);
    if (drawing) rtcReleaseScene(drawing);
    if (device) rtcReleaseDevice(device);
  }

  static void dropHoles(const RTCFilterFunctionNArguments* args) {
    const auto& state = *static_cast<const State*>(args->geometryUserPtr);
    if (args->valid[0] == -1 && holeAt(*state.scene, RTCHitN_primID(args->hit, args->N, 0),
                                       RTCHitN_u(args->hit, args->N, 0), RTCHitN_v(args->hit, args->N, 0)))
      args->valid[0] = 0;
  }

  Result<RTCScene> makeScene(std::span<const Vec3> positions, std::span<const bake::Triangle> triangles, bool holes,
                             RTCSceneFlags flags = RTC_SCENE_FLAG_NONE) {
    RTCScene made = rtcNewScene(device);
    rtcSetSceneFlags(made, RTC_SCENE_FLAG_ROBUST | flags);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                                 3 * sizeof(float), positions.size()));
    auto* indices = static_cast<uint32_t*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                                   3 * sizeof(uint32_t), triangles.size()));
    if (!vertices || !indices) {
      rtcReleaseGeometry(geometry);
      rtcReleaseScene(made);
      return Error{ErrorCode::kIo, scene->name, "", "not enough memory for the path tracer", "take a smaller scene"};
    }
    std::memcpy(vertices, positions.data(), positions.size_bytes());
    for (size_t t = 0; t < triangles.size(); ++t) std::memcpy(indices + 3 * t, triangles[t].v.data(), 12);
    if (holes) {
      rtcSetGeometryUserData(geometry, this);
      rtcSetGeometryIntersectFilterFunction(geometry, dropHoles);
      rtcSetGeometryOccludedFilterFunction(geometry, dropHoles);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(made, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(made);
    return made;
  }

  static void dropBacks(const RTCFilterFunctionNArguments* args) {
    const auto* ray = reinterpret_cast<const RTCRay*>(args->ray);  // of rtcIntersect1: one
    const auto* hit = reinterpret_cast<const RTCHit*>(args->hit);
    if (hit->Ng_x * ray->dir_x + hit->Ng_y * ray->dir_y + hit->Ng_z * ray->dir_z >= 0) args->valid[0] = 0;
  }

  RTCRayHit cast(RTCScene in, Vec3 origin, Vec3 direction, float far_m, float near_m = 0, bool fronts_only = false) const {
    RTCRayHit r{};
    r.ray.tnear = near_m;
    r.ray.org_x = origin.x, r.ray.org_y = origin.y, r.ray.org_z = origin.z;
    r.ray.dir_x = direction.x, r.ray.dir_y = direction.y, r.ray.dir_z = direction.z;
    r.ray.tfar = far_m;
    r.ray.mask = ~0u;
    r.hit.geomID = r.hit.primID = r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    if (fronts_only) context.filter = dropBacks;
    rtcIntersect1(in, &context, &r);
    return r;
  }
  bool open(Vec3 origin, Vec3 direction, float far_m = std::numeric_limits<float>::infinity()) const {
    RTCRay r{};
    r.org_x = origin.x, r.org_y = origin.y, r.org_z = origin.z;
    r.dir_x = direction.x, r.dir_y = direction.y, r.dir_z = direction.z;
    r.tfar = far_m;
    r.mask = ~0u;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(solid, &context, &r);
    return r.tfar >= 0;
  }

  // A point of the patch, on the scene's own triangle beneath the drawing geometry.
  Start start(uint32_t patch, float pick, float along) const {
    const std::span<const Facet> own(facets.data() + facet_start[patch], facet_start[patch + 1] - facet_start[patch]);
    if (own.empty() || !(own.back().cumulative_area > 0)) return {};
    const float area = pick * own.back().cumulative_area;
    const auto at = std::min<size_t>(
        own.size() - 1, static_cast<size_t>(std::partition_point(own.begin(), own.end(), [&](const Facet& f) {
                                              return f.cumulative_area <= area;
                                            }) - own.begin()));
    const Facet& f = own[at];
    const float before = at ? own[at - 1].cumulative_area : 0.0f, share = f.cumulative_area - before;
    const float root = std::sqrt(std::clamp((area - before) / share, 0.0f, 1.0f));
    const Vec3 p = f.a + f.ab * (root * (1 - along)) + f.ac * (root * along);
    const float reach = 2 * quantum + kLift * largest(f.a);
    const RTCRayHit hit = cast(solid, p + f.normal * reach, f.normal * -1.0f, 2 * reach);
    if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    const uint32_t t = hit.hit.primID;
    const float facing = dot(normals[t], f.normal);
    // The other side of a double-sided surface is a patch of its own; a surface at an angle belongs to another one.
    if (std::abs(facing) < 0.9f || (facing < 0 && !isDoubleSided(t))) return {};
    const Vec3 normal = facing > 0 ? normals[t] : normals[t] * -1.0f;
    return {p + f.normal * (reach - hit.ray.tfar) + normal * lifts[t], normal, surfaceAt(*scene, t, hit.hit.u, hit.hit.v).albedo,
            true};
  }
  // No point that start() finds on the patch faces `direction`: normals there differ from the facets' by less than 26 degrees.
  bool turnedAway(uint32_t patch, Vec3 direction) const {
    constexpr float kSine = 0.45f;
    for (uint32_t f = facet_start[patch]; f < facet_start[patch + 1]; ++f)
      if (dot(facets[f].normal, direction) > -kSine) return false;
    return true;
  }
  // Of a ray of `solid`, by the triangle's corners: however long the ray, it is off by their rounding alone.
  Vec3 pointOf(const RTCRayHit& hit) const {
    const auto& v = scene->triangles[hit.hit.primID].v;
    const Vec3 a = scene->positions[v[0]];
    return a + (scene->positions[v[1]] - a) * hit.hit.u + (scene->positions[v[2]] - a) * hit.hit.v;
  }
  uint16_t groupOf(uint32_t t) const { return lamp_groups.of_material[scene->triangles[t].material]; }
  bool isDoubleSided(uint32_t t) const { return scene->materials[scene->triangles[t].material].double_sided; }

  Vec3 sunOn(Vec3 point, Vec3 normal, const Lighting& light, uint64_t& cast_rays) const {
    const float cosine = light.hasSun() ? dot(normal, light.to_sun) : 0.0f;
    if (!(cosine > 0)) return {};
    ++cast_rays;
    return open(point, light.to_sun) ? light.sun * cosine : Vec3{};
  }

  std::vector<Emitter> emittersOf(const Lighting& light) const {
    std::vector<Emitter> emitters;
    if (!(light.lamps > 0)) return emitters;
    for (uint32_t t = 0; t < scene->triangles.size(); ++t) {
      const Vec3 radiance = surfaceAt(*scene, t, 1.0f / 3, 1.0f / 3).radiance;
      const auto& v = scene->triangles[t].v;
      const Vec3 a = scene->positions[v[0]], ab = scene->positions[v[1]] - a, ac = scene->positions[v[2]] - a;
      const float area = 0.5f * length(cross(ab, ac));
      const float power = area * (radiance.x + radiance.y + radiance.z) * light.lampsOf(groupOf(t));
      if (power > 0) emitters.push_back({t, a, ab, ac, normals[t], area, power, isDoubleSided(t)});
    }
    return emitters;
  }
  // For receivers within `area_m2` around a place.
  static LampChoice chooseLamps(std::span<const Emitter> emitters, Vec3 middle, float area_m2) {
    LampChoice choice;
    float sum = 0;
    for (const Emitter& e : emitters) {
      const Vec3 d = e.a + (e.ab + e.ac) / 3 - middle;
      sum += e.power / (dot(d, d) + area_m2 + e.area_m2);
      choice.cumulative.push_back(sum);
    }
    return choice;
  }

  // One light for one patch: what all its paths share.
  struct Lamps {
    std::span<const Emitter> emitters;
    std::span<const uint32_t> emitter_of;  // per triangle of the scene
    LampChoice choice;
  };

  // Density, per solid angle, of asking for the point that a ray meets on triangle t.
  float lampDensity(const Lamps& lamps, uint32_t t, float distance, float cosine) const {
    if (!lamps.choice.any() || lamps.emitter_of[t] == bake::kNone || !(cosine > 0)) return 0;
    const size_t e = lamps.emitter_of[t];
    return lamps.choice.share(e) / lamps.emitters[e].area_m2 * distance * distance / cosine;
  }

  // Irradiance from one point of one lamp, weighted.
  Vec3 askLamp(Vec3 point, Vec3 normal, const Lamps& lamps, const Lighting& light, Random& random,
               uint64_t& cast_rays) const {
    if (!lamps.choice.any()) return {};
    const auto& cumulative = lamps.choice.cumulative;
    const size_t e = std::min<size_t>(cumulative.size() - 1,
                                      static_cast<size_t>(std::upper_bound(cumulative.begin(), cumulative.end(),
                                                                           random.unit() * cumulative.back()) -
                                                          cumulative.begin()));
    const Emitter& emitter = lamps.emitters[e];
    const float root = std::sqrt(random.unit()), along = random.unit();
    const float u = root * (1 - along), v = root * along;
    const Vec3 at = emitter.a + emitter.ab * u + emitter.ac * v, to = at - point;
    const float distance = length(to);
    if (!(distance > 0)) return {};
    const Vec3 w = to / distance;
    const float cosine = dot(normal, w), back = -dot(emitter.normal, w), lamp_cosine = emitter.both_sides ? std::abs(back) : back;
    if (!(cosine > 0) || !(lamp_cosine > 0) || holeAt(*scene, emitter.triangle, u, v)) return {};
    ++cast_rays;
    if (!open(point, w, distance * (1 - 1e-4f))) return {};
    const float density = lampDensity(lamps, emitter.triangle, distance, lamp_cosine), reflected = cosine / kPi;
    const Vec3 radiance = surfaceAt(*scene, emitter.triangle, u, v).radiance * light.lampsOf(groupOf(emitter.triangle));
    return radiance * (cosine / (density + reflected));  // L cos / density, times density / (density + reflected)
  }

  struct Arrived {
    Vec3 all, direct, sun;  // irradiance at the start; direct: lamps and sky alone, without the sun
    bool buried = false;
  };

  Arrived path(const Start& from, Vec3 direction, const Lighting& light, const Lamps& lamps, Random& random,
               uint64_t& cast_rays) const {
    Arrived arrived;
    arrived.sun = sunOn(from.point, from.normal, light, cast_rays);
    arrived.direct = askLamp(from.point, from.normal, lamps, light, random, cast_rays);
    arrived.all = arrived.sun + arrived.direct;
    float reflected = dot(from.normal, direction) / kPi;  // density of the direction that was taken
    Vec3 point = from.point, throughput{1, 1, 1};  // of irradiance: pi times radiance where directions follow the cosine
    for (int bounce = 0; bounce < kMaxBounces; ++bounce) {
      ++cast_rays;
      const RTCRayHit hit = cast(solid, point, direction, std::numeric_limits<float>::infinity());
      if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
        const Vec3 e = throughput * runtime::skyRadiance(light.sky, direction) * kPi;
        arrived.all += e;
        if (bounce == 0) arrived.direct += e;
        break;
      }
      const uint32_t t = hit.hit.primID;
      const bool front = dot(normals[t], direction) < 0;
      if (!front && !isDoubleSided(t)) {
        arrived.buried = bounce == 0 && isInside(from, cast_rays);
        break;
      }
      const SurfacePoint surface = surfaceAt(*scene, t, hit.hit.u, hit.hit.v);
      const Vec3 normal = front ? normals[t] : normals[t] * -1.0f;
      const Vec3 at = pointOf(hit);
      const float asked = lampDensity(lamps, t, hit.ray.tfar, std::abs(dot(normals[t], direction)));
      const Vec3 e = throughput * surface.radiance * (kPi * light.lampsOf(groupOf(t)) * reflected / (reflected + asked));
      arrived.all += e;
      if (bounce == 0) arrived.direct += e;
      throughput = throughput * surface.albedo;
      if (bounce >= kSureBounces) {
        const float keep = std::min(0.97f, std::max({throughput.x, throughput.y, throughput.z}));
        if (random.unit() >= keep) break;
        throughput = throughput / keep;
      }
      point = at + normal * lifts[t];
      arrived.all += throughput * (sunOn(point, normal, light, cast_rays) +
                                   askLamp(point, normal, lamps, light, random, cast_rays));
      const float u = random.unit(), v = random.unit();
      direction = cosineDirection(normal, u, v);
      reflected = std::sqrt(std::max(0.0f, 1 - u)) / kPi;
    }
    return arrived;
  }

  bool isInside(const Start& from, uint64_t& cast_rays) const {
    for (const Vec3 side : {Vec3{1, 0.3f, 0.1f}, {-0.2f, 1, 0.4f}, {0.5f, -0.1f, 1}, {-1, -0.6f, -0.7f}}) {
      ++cast_rays;
      const Vec3 w = normalized(from.normal + normalized(side - from.normal * dot(side, from.normal)));
      const RTCRayHit hit = cast(solid, from.point, w, std::numeric_limits<float>::infinity());
      if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID || dot(normals[hit.hit.primID], w) < 0 || isDoubleSided(hit.hit.primID))
        return false;
    }
    return true;
  }

  // The mean over paths; start(u) finds where the path at a place of the unit square begins. buried_count: paths that begin
  // inside a solid are dark, not left out.
  template <class StartAt>
  PatchTruth meanOfPaths(uint32_t patch, uint32_t paths, uint64_t seed, const Lighting& light, const Lamps& lamps,
                         bool buried_count, const StartAt& start_at) const {
    const uint32_t per_batch = std::max(1u, (paths + kBatches - 1) / kBatches);
    BatchSums all, direct, irradiance;
    double sun[3] = {}, counted[kBatches] = {};
    uint64_t cast_rays = 0, found = 0, buried = 0;
    for (uint32_t b = 0; b < kBatches; ++b) {
      Random random((seed * 0x2545f4914f6cdd1dull + patch) * kBatches + b);
      const EvenPoints even(random);
      for (uint32_t i = 0; i < per_batch; ++i) {
        const auto u = even.point(i);
        const Start from = start_at(u[0], u[1]);
        if (!from.found) continue;
        ++found;
        const Arrived e = path(from, cosineDirection(from.normal, u[2], u[3]), light, lamps, random, cast_rays);
        if (e.buried && !buried_count) {
          ++buried;
          continue;
        }
        ++counted[b];
        for (int c = 0; c < 3; ++c) {
          irradiance.of[c][b] += static_cast<double>(e.all[c]);
          all.of[c][b] += static_cast<double>(from.albedo[c] * e.all[c]);
          direct.of[c][b] += static_cast<double>(from.albedo[c] * (e.direct[c] + e.sun[c]));
          sun[c] += static_cast<double>(e.sun[c]);
        }
      }
    }
    PatchTruth truth;
    truth.buried = found == buried;
    const auto total = static_cast<double>(found - buried);
    for (int c = 0; c < 3 && !truth.buried; ++c) {
      all.mean(c, counted, total, truth.reflected[c], truth.error[c]);
      direct.mean(c, counted, total, truth.direct[c], truth.direct_error[c]);
      irradiance.mean(c, counted, total, truth.irradiance[c], truth.irradiance_error[c]);
      truth.sun[c] = static_cast<float>(sun[c] / total);
    }
    rays += cast_rays;
    return truth;
  }

  PatchTruth tracePatch(uint32_t patch, const Lighting& light, std::span<const Emitter> emitters,
                        std::span<const uint32_t> emitter_of, const TraceSettings& settings) const {
    const std::span<const Facet> own(facets.data() + facet_start[patch], facet_start[patch + 1] - facet_start[patch]);
    Lamps lamps{emitters, emitter_of, {}};
    if (!own.empty()) lamps.choice = chooseLamps(emitters, own[own.size() / 2].a, own.back().cumulative_area);
    return meanOfPaths(patch, settings.paths, settings.seed, light, lamps, false,
                       [&](float pick, float along) { return start(patch, pick, along); });
  }

  PatchTruth traceSeen(const SeenSurface& surface, const Lighting& light, std::span<const Emitter> emitters,
                       std::span<const uint32_t> emitter_of, uint64_t seed) const {
    const std::span<const SeenPoint> points = surface.points;
    PatchTruth none;
    none.buried = true;
    if (points.empty()) return none;
    Box extent;
    for (const SeenPoint& p : points) extent.add(p.point);
    const Vec3 size = extent.hi - extent.lo;
    const Lamps lamps{emitters, emitter_of, chooseLamps(emitters, (extent.lo + extent.hi) / 2, dot(size, size))};
    return meanOfPaths(points.front().patch, surface.paths, seed, light, lamps, true, [&](float pick, float) {
      const SeenPoint& p = points[std::min(points.size() - 1, static_cast<size_t>(pick * static_cast<float>(points.size())))];
      return Start{p.point, p.normal, p.albedo, true};
    });
  }

  // The patch whose drawing geometry lies at a point of the surface and faces as `normal` does.
  uint32_t patchAt(Vec3 point, Vec3 normal) const {
    const float reach = 2 * quantum + 2 * kLift * largest(point);
    const RTCRayHit hit = cast(drawing, point + normal * reach, normal * -1.0f, 2 * reach, 0, true);
    return hit.hit.geomID == RTC_INVALID_GEOMETRY_ID ? kNoPatch : patch_of[hit.hit.primID];
  }

  template <class Work>
  void forEach(size_t count, int threads, const Work& work) const {
    std::atomic<size_t> next{0};
    const auto run = [&] {
      for (size_t i = next++; i < count; i = next++) work(i);
    };
    const int n = threads > 0 ? threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
    std::vector<std::jthread> others;
    for (int k = 1; k < n; ++k) others.emplace_back(run);
    run();
  }

  // one(i, emitters, emitter_of): the truth of the i-th.
  template <class One>
  std::vector<PatchTruth> traceEach(size_t count, const Lighting& light, int threads, const One& one) const {
    std::vector<PatchTruth> truth(count);
    rays = 0;
    const std::vector<Emitter> emitters = emittersOf(light);
    std::vector<uint32_t> emitter_of(scene->triangles.size(), bake::kNone);
    for (uint32_t e = 0; e < emitters.size(); ++e) emitter_of[emitters[e].triangle] = e;
    forEach(count, threads, [&](size_t i) { truth[i] = one(i, emitters, emitter_of); });
    return truth;
  }
};

Result<PathTracer> PathTracer::create(const bake::Scene& scene, const formats::WholeWorld& world) {
  auto state = std::make_unique<State>();
  state->scene = &scene;
  state->lamp_groups = bake::groupLamps(scene);
  state->device = rtcNewDevice(nullptr);
  if (!state->device) return Error{ErrorCode::kIo, scene.name, "", "Embree cannot start on this machine", ""};
  rtcSetDeviceErrorFunction(
      state->device,
      [](void* user, RTCError, const char* text) { static_cast<State*>(user)->fault = text ? text : "unknown"; },
      state.get());
  state->normals.reserve(scene.triangles.size());
  for (const bake::Triangle& t : scene.triangles) {
    const Vec3 a = scene.positions[t.v[0]];
    const Vec3 b = scene.positions[t.v[1]], c = scene.positions[t.v[2]];
    state->normals.push_back(normalized(cross(b - a, c - a)));
    state->lifts.push_back(kLift * std::max({largest(a), largest(b), largest(c)}));
  }
  bool holes = false;
  for (const bake::Material& m : scene.materials) holes |= m.cutout;
  auto solid = state->makeScene(scene.positions, scene.triangles, holes);
  if (!solid) return solid.error();
  state->solid = *solid;

  if (!world.hasGeometry())
    return Error{ErrorCode::kInvalidFile, world.path(), "", "the world has no drawing geometry", "bake it with geometry"};
  const uint32_t patches = formats::wholeNumber(world.levels()[0].nodes);
  std::vector<std::vector<Facet>> of_patch(patches);
  std::vector<Vec3> corners;
  std::vector<bake::Triangle> triangles;
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto geometry = world.geometry(info.id.tile);
    if (!geometry) return geometry.error();
    Box extent;
    for (const Vec3& p : geometry->positions) extent.add(p);
    const Vec3 size = extent.hi - extent.lo;
    state->quantum = std::max({state->quantum, size.x * 0x1p-16f, size.y * 0x1p-16f, size.z * 0x1p-16f});
    for (size_t t = 0; t < geometry->patch.size(); ++t) {
      const Vec3 a = geometry->positions[3 * t], b = geometry->positions[3 * t + 1], c = geometry->positions[3 * t + 2];
      const auto first = static_cast<uint32_t>(corners.size());
      corners.insert(corners.end(), {a, b, c});
      triangles.push_back({{first, first + 1, first + 2}, 0});
      state->patch_of.push_back(formats::wholeNumber(info.first_node + geometry->patch[t]));
      std::vector<Facet>& own = of_patch[state->patch_of.back()];
      const Vec3 n = cross(b - a, c - a);
      const float area = 0.5f * length(n);
      if (area > 0 && t < geometry->exposed())
        own.push_back({a, b - a, c - a, normalized(n), area + (own.empty() ? 0.0f : own.back().cumulative_area)});
    }
  }
  for (const auto& own : of_patch) {
    state->facet_start.push_back(static_cast<uint32_t>(state->facets.size()));
    state->facets.insert(state->facets.end(), own.begin(), own.end());
  }
  state->facet_start.push_back(static_cast<uint32_t>(state->facets.size()));
  auto drawing = state->makeScene(corners, triangles, false, RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
  if (!drawing) return drawing.error();
  state->drawing = *drawing;
  if (!state->fault.empty()) return Error{ErrorCode::kIo, scene.name, "", "Embree: " + state->fault, ""};

  uint32_t tried = 0, found = 0;
  for (uint32_t p = 0; p < patches; p += std::max(1u, patches / 256)) {
    ++tried;
    found += state->start(p, 0.37f, 0.41f).found ? 1 : 0;
  }
  if (found * 2 < tried)
    return Error{ErrorCode::kInvalidFile, world.path(), "", "most of its surface is not that of " + scene.name,
                 "name the scene that the world was baked from"};
  return PathTracer(std::move(state));
}

PathTracer::PathTracer(std::unique_ptr<State> state) : state_(std::move(state)) {}
PathTracer::PathTracer(PathTracer&&) noexcept = default;
PathTracer& PathTracer::operator=(PathTracer&&) noexcept = default;
PathTracer::~PathTracer() = default;

std::vector<PatchTruth> PathTracer::trace(std::span<const uint32_t> patches, const Lighting& light,
                                          const TraceSettings& settings) const {
  return state_->traceEach(patches.size(), light, settings.threads,
                           [&](size_t i, std::span<const Emitter> emitters, std::span<const uint32_t> emitter_of) {
                             return state_->tracePatch(patches[i], light, emitters, emitter_of, settings);
                           });
}

std::vector<Vec3> PathTracer::sunIrradiance(std::span<const uint32_t> patches, const Lighting& light, uint32_t rays,
                                            int threads) const {
  std::vector<Vec3> irradiance(patches.size());
  if (!light.hasSun()) return irradiance;
  state_->forEach(patches.size(), threads, [&](size_t i) {
    if (state_->turnedAway(patches[i], light.to_sun)) return;
    Random random(patches[i] ^ 0xd1b54a32d192ed03ull);
    const EvenPoints even(random);
    uint64_t cast_rays = 0;
    uint32_t found = 0;
    Vec3 sum;
    std::vector<Start> dark;
    for (uint32_t k = 0; k < rays; ++k) {
      const auto u = even.point(k);
      const Start from = state_->start(patches[i], u[0], u[1]);
      if (!from.found) continue;
      const Vec3 sun = state_->sunOn(from.point, from.normal, light, cast_rays);
      sum += sun;
      if (sun == Vec3{}) dark.push_back(from);
      else ++found;
    }
    if (found == 0) return;
    for (const Start& from : dark)  // what nobody sees, no engine would light
      found += state_->isInside(from, cast_rays) ? 0 : 1;
    irradiance[i] = sum / static_cast<float>(found);
  });
  return irradiance;
}

EyeView PathTracer::lookFrom(Vec3 eye, uint32_t rays) const {
  EyeView view;
  const State& s = *state_;
  for (uint32_t i = 0; i < rays; ++i) {
    const Vec3 w = sphereDirection(i, rays);
    const RTCRayHit hit = s.cast(s.solid, eye, w, std::numeric_limits<float>::infinity());
    if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
      ++view.sky;
      continue;
    }
    const uint32_t t = hit.hit.primID;
    const bool front = dot(s.normals[t], w) < 0;
    if (!front && !s.isDoubleSided(t)) {
      ++view.backs;
      continue;
    }
    const Vec3 normal = front ? s.normals[t] : s.normals[t] * -1.0f, at = s.pointOf(hit);
    view.points.push_back({at + normal * s.lifts[t], normal, surfaceAt(*s.scene, t, hit.hit.u, hit.hit.v).albedo,
                           s.patchAt(at, normal)});
  }
  return view;
}

std::vector<PatchTruth> PathTracer::traceSeen(std::span<const SeenSurface> surfaces, const Lighting& light, uint64_t seed,
                                              int threads) const {
  return state_->traceEach(surfaces.size(), light, threads,
                           [&](size_t i, std::span<const Emitter> emitters, std::span<const uint32_t> emitter_of) {
                             return state_->traceSeen(surfaces[i], light, emitters, emitter_of, seed);
                           });
}

uint64_t PathTracer::raysCast() const { return state_->rays; }

PathTracer::Sight PathTracer::sight(Vec3 origin, Vec3 direction) const {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  const auto met = [](const RTCRayHit& r) { return r.hit.geomID != RTC_INVALID_GEOMETRY_ID; };
  RTCRayHit hit = state_->cast(state_->drawing, origin, direction, kInfinity);
  if (!met(hit)) return {kNoPatch, kInfinity};
  const float at = hit.ray.tfar;
  if (dot({hit.hit.Ng_x, hit.hit.Ng_y, hit.hit.Ng_z}, direction) >= 0) {
    const float margin = 4 * state_->quantum + 1e-5f * at;
    hit = state_->cast(state_->drawing, origin, direction, at + margin, std::max(0.0f, at - margin), true);
  }
  return {met(hit) ? state_->patch_of[hit.hit.primID] : kNoPatch, at};
}

}  // namespace ff::chart
