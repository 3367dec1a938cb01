#include "bake/rays/ray_caster.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "bake/rays/surface_sampling.h"

namespace ff::bake {
namespace {

RTCRay toEmbree(const Ray& ray, float distance_m) {
  RTCRay r;
  r.org_x = ray.origin.x;
  r.org_y = ray.origin.y;
  r.org_z = ray.origin.z;
  r.dir_x = ray.direction.x;
  r.dir_y = ray.direction.y;
  r.dir_z = ray.direction.z;
  r.tnear = 0;
  r.tfar = distance_m;
  r.mask = ~0u;
  r.time = 0;
  r.flags = 0;
  return r;
}

}  // namespace

struct RayCaster::State {
  const Scene* scene = nullptr;
  RTCDevice device = nullptr;
  RTCScene embree = nullptr;
  std::vector<uint32_t> source[2];  // geometry (0 opaque, 1 cutout) and primitive -> scene triangle
  std::vector<Vec3> normals;        // per scene triangle, not normalised
  std::string error;

  ~State() {
    if (embree) rtcReleaseScene(embree);
    if (device) rtcReleaseDevice(device);
  }

  void rejectHoles(const RTCFilterFunctionNArguments* args) const {
    // rtcIntersect1 and rtcOccluded1 only: N is 1.
    if (args->valid[0] != -1) return;
    const uint32_t t = source[1][RTCHitN_primID(args->hit, args->N, 0)];
    if (isHole(*scene, t, RTCHitN_u(args->hit, args->N, 0), RTCHitN_v(args->hit, args->N, 0))) args->valid[0] = 0;
  }

  struct Context {
    RTCIntersectContext embree;  // first: Embree hands back a pointer to it
    const State* state;
  };
  static void rejectBacks(const RTCFilterFunctionNArguments* args) {
    if (args->valid[0] != -1) return;
    if (!reinterpret_cast<const Context*>(args->context)->state->facesRay(args)) args->valid[0] = 0;
  }

  Context context(bool facing) const {
    Context made;
    rtcInitIntersectContext(&made.embree);  // INCOHERENT is its default; COHERENT halves the speed of diffuse rays
    made.state = this;
    if (facing) made.embree.filter = rejectBacks;
    return made;
  }

  bool facesRay(const RTCFilterFunctionNArguments* args) const {
    const uint32_t t = source[RTCHitN_geomID(args->hit, args->N, 0)][RTCHitN_primID(args->hit, args->N, 0)];
    const Vec3 d{RTCRayN_dir_x(args->ray, args->N, 0), RTCRayN_dir_y(args->ray, args->N, 0), RTCRayN_dir_z(args->ray, args->N, 0)};
    if (dot(normals[t], d) < 0) return true;
    return scene->backs != Backs::kReflect && scene->materials[scene->triangles[t].material].double_sided;
  }

  // facing: hits surfaces only that face the ray.
  RTCRayHit cast(const Ray& ray, float from_m, float within_m, bool facing) const {
    RTCRayHit rh;
    rh.ray = toEmbree(ray, within_m);
    rh.ray.tnear = from_m;
    rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rh.hit.primID = RTC_INVALID_GEOMETRY_ID;
    rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    Context made = context(facing);
    rtcIntersect1(embree, &made.embree, &rh);
    return rh;
  }
};

Result<RayCaster> RayCaster::create(const Scene& scene) {
  auto state = std::make_unique<State>();
  state->scene = &scene;
  state->device = rtcNewDevice(nullptr);
  if (!state->device) return Error{ErrorCode::kIo, scene.name, "", "Embree cannot start on this machine", ""};
  rtcSetDeviceErrorFunction(
      state->device,
      [](void* user, RTCError, const char* text) { static_cast<State*>(user)->error = text ? text : "unknown"; },
      state.get());
  state->embree = rtcNewScene(state->device);
  // Robust: a ray along the edge that two triangles share must hit one of them; a miss would be a leak of sky.
  rtcSetSceneFlags(state->embree, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
  rtcSetSceneBuildQuality(state->embree, RTC_BUILD_QUALITY_MEDIUM);
  state->normals.resize(scene.triangles.size());
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const auto& v = scene.triangles[t].v;
    const Vec3 a = scene.positions[v[0]], b = scene.positions[v[1]], c = scene.positions[v[2]];
    state->normals[t] = cross(b - a, c - a);
    state->source[scene.materials[scene.triangles[t].material].cutout ? 1 : 0].push_back(t);
  }
  for (unsigned g = 0; g < 2; ++g) {
    const auto& source = state->source[g];
    if (source.empty()) continue;
    RTCGeometry geometry = rtcNewGeometry(state->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                                 sizeof(Vec3), scene.positions.size()));
    auto* indices = static_cast<uint32_t*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                                   3 * sizeof(uint32_t), source.size()));
    if (!vertices || !indices) {
      rtcReleaseGeometry(geometry);
      return Error{ErrorCode::kIo, scene.name, "", "not enough memory for the ray caster", "bake a smaller scene"};
    }
    std::memcpy(vertices, scene.positions.data(), scene.positions.size() * sizeof(Vec3));
    for (size_t i = 0; i < source.size(); ++i)
      std::memcpy(indices + 3 * i, scene.triangles[source[i]].v.data(), 3 * sizeof(uint32_t));
    if (g == 1) {
      rtcSetGeometryUserData(geometry, state.get());
      const RTCFilterFunctionN filter = [](const RTCFilterFunctionNArguments* args) {
        static_cast<const State*>(args->geometryUserPtr)->rejectHoles(args);
      };
      rtcSetGeometryIntersectFilterFunction(geometry, filter);
      rtcSetGeometryOccludedFilterFunction(geometry, filter);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(state->embree, geometry, g);
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(state->embree);
  if (!state->error.empty()) return Error{ErrorCode::kIo, scene.name, "", "Embree: " + state->error, ""};
  return RayCaster(std::move(state));
}

RayCaster::RayCaster(std::unique_ptr<State> state) : state_(std::move(state)) {}
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;
RayCaster::~RayCaster() = default;

Hit RayCaster::nearest(const Ray& ray, float within_m) const {
  const Scene& scene = *state_->scene;
  RTCRayHit rh = state_->cast(ray, 0, within_m, scene.backs == Backs::kPass);
  if (rh.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
  Hit hit;
  const auto set = [&] {
    hit.triangle = state_->source[rh.hit.geomID][rh.hit.primID];
    hit.front = dot(state_->normals[hit.triangle], ray.direction) < 0;
    hit.point = ray.origin + ray.direction * rh.ray.tfar;
  };
  set();
  // Rooms that share a plane of no thickness: of faces that coincide the one that faces the ray is meant.
  if (!hit.front && (scene.backs == Backs::kReflect || !scene.materials[scene.triangles[hit.triangle].material].double_sided)) {
    const float steep = std::abs(dot(normalized(state_->normals[hit.triangle]), ray.direction));
    const float reach = surfaceOffset(hit.triangle) / std::max(steep, 1e-3f);
    const RTCRayHit facing = state_->cast(ray, std::max(0.0f, rh.ray.tfar - reach), std::min(within_m, rh.ray.tfar + reach), true);
    if (facing.hit.geomID != RTC_INVALID_GEOMETRY_ID) {
      rh = facing;
      set();
    }
  }
  return hit;
}

bool RayCaster::occluded(const Ray& ray, float distance_m) const {
  RTCRay r = toEmbree(ray, distance_m);
  State::Context context = state_->context(state_->scene->backs == Backs::kPass);
  rtcOccluded1(state_->embree, &context.embree, &r);
  return r.tfar < 0;
}

void RayCaster::near(Vec3 point, float distance_m, std::vector<uint32_t>& triangles) const {
  struct Answer {
    const State& state;
    std::vector<uint32_t>& triangles;
  } answer{*state_, triangles};
  triangles.clear();
  RTCPointQuery query{point.x, point.y, point.z, 0, distance_m};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(
      state_->embree, &query, &context,
      [](RTCPointQueryFunctionArguments* args) {
        auto& to = *static_cast<Answer*>(args->userPtr);
        to.triangles.push_back(to.state.source[args->geomID][args->primID]);
        return false;  // the distance stays
      },
      &answer);
  std::sort(triangles.begin(), triangles.end());
}

float RayCaster::surfaceOffset(uint32_t triangle) const {
  constexpr float kShare = 3e-6f;
  return kShare * largestCoordinate(*state_->scene, triangle);
}

uint32_t RayCaster::bareIntersect(const Ray& ray) const { return state_->cast(ray, 0, std::numeric_limits<float>::infinity(), false).hit.primID; }

}  // namespace ff::bake
