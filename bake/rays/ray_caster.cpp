#include "bake/rays/ray_caster.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <string>
#include <vector>

#include "bake/rays/surface_sampling.h"
#include "bake/rays/triangle_block.h"

namespace ff::bake {
namespace {

constexpr size_t kWide = TriangleBlock::kTriangles;

// Embree's test of boxes differs between instruction sets. It works axis by axis with a reciprocal of the direction that is an estimate and
// one step of Newton's (right to 2^-21.6 of itself), and rounds what is at most twice as large as the coordinate of box or origin. So it
// is off by 1e-6 of the largest coordinate on an axis, where an origin is at most kReach times as far out. Boxes are wider than that: all
// instruction sets find a triangle that meet() meets.
constexpr float kMargin = 1.2e-6f, kReach = 1.25f;
// Where axes are shorter than that of the longest, they count as so long: directions below 1e-18 are taken for 1e-18.
constexpr float kShortAxis = 0x1p-10f;
// Rounds distances up: three low bits of Embree's distances to boxes hold something else.
constexpr float kUp = 1 + 0x1p-19f;

float up(double distance_m) { return static_cast<float>(distance_m) * kUp; }

Box boxOf(const Corners& corners) {
  Box box;
  for (const Vec3& p : corners) box.add(p);
  return box;
}

// Not normalised.
Vec3 normalOf(const Corners& corners) { return cross(corners[1] - corners[0], corners[2] - corners[0]); }

Corners cornersOf(const Scene& scene, uint32_t triangle) {
  const auto& v = scene.triangles[triangle].v;
  return {scene.positions[v[0]], scene.positions[v[1]], scene.positions[v[2]]};
}

}  // namespace

struct RayCaster::State {
  const Scene* scene = nullptr;
  RTCDevice device = nullptr;
  RTCScene embree = nullptr;
  std::vector<TriangleBlock> blocks;   // Embree's primitives
  std::vector<Corners> block_corners;  // kWide a block
  std::vector<uint8_t> cutout;        // per scene triangle
  std::vector<float> offsets;         // per scene triangle, m
  Vec3 largest;                       // coordinates, m
  std::string error;

  ~State() {
    if (embree) rtcReleaseScene(embree);
    if (device) rtcReleaseDevice(device);
  }

  void makeBlocks();
  void attachBlocks();

  // Whether a ray is stopped where it meets a triangle, on its front or back; facing: by surfaces only that face it.
  bool stops(uint32_t triangle, const TriangleHit& hit, bool front, bool facing, bool holes) const {
    if (holes && cutout[triangle] && isHole(*scene, triangle, hit.b, hit.c)) return false;
    if (!facing || front) return true;
    return scene->backs != Backs::kReflect && scene->materials[scene->triangles[triangle].material].double_sided;
  }

  // How far a ray goes before it comes near the scene, m: 0 for all that start there, infinite for what goes away.
  double wayTo(const Ray& ray) const {
    double way = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const double outside = static_cast<double>(std::abs(ray.origin[axis]) - kReach * largest[axis]);
      const double inward = static_cast<double>(std::copysign(1.0f, -ray.origin[axis]) * ray.direction[axis]);
      if (outside > 0) way = std::max(way, inward > 0 ? outside / inward : std::numeric_limits<double>::infinity());
    }
    return way;
  }

  // One ray under way, and the nearest of what it has met.
  struct Cast {
    RTCIntersectContext embree;  // first: Embree hands back a pointer to it
    const State* state;
    Ray ray;
    BlockRay block_ray;
    bool facing, holes;
    uint32_t triangle = kNone;
    bool front = true;
    double from_m, to_m;
    double way_m;  // from the ray's origin to Embree's

    Cast(const State& s, const Ray& r, float from, float to, bool facing_only, bool with_holes)
        : state(&s), ray(r), block_ray(r), facing(facing_only), holes(with_holes), from_m(static_cast<double>(from)), to_m(static_cast<double>(to)),
          way_m(s.wayTo(r)) {
      rtcInitIntersectContext(&embree);  // INCOHERENT is its default; COHERENT halves the speed of diffuse rays
    }
    static Cast& of(RTCIntersectContext* context) { return *reinterpret_cast<Cast*>(context); }

    RTCRay embreeRay() const {  // if it comes near
      RTCRay r;
      const auto moved = [&](float at, float along) {
        return way_m > 0 ? static_cast<float>(static_cast<double>(at) + way_m * static_cast<double>(along)) : at;
      };
      r.org_x = moved(ray.origin.x, ray.direction.x);
      r.org_y = moved(ray.origin.y, ray.direction.y);
      r.org_z = moved(ray.origin.z, ray.direction.z);
      r.dir_x = ray.direction.x;
      r.dir_y = ray.direction.y;
      r.dir_z = ray.direction.z;
      r.tnear = way_m > 0 ? 0 : static_cast<float>(from_m);
      r.tfar = up(to_m - way_m);
      r.mask = ~0u;
      r.time = 0;
      r.flags = 0;
      return r;
    }

    bool comesNear() const { return way_m < to_m; }

    // Whether any of a block is nearer, or as near and lower in number, than what was met before.
    bool meetBlock(size_t number) {
      const Corners* corners = &state->block_corners[kWide * number];
      __builtin_prefetch(corners);
      __builtin_prefetch(corners + 2);
      const TriangleBlock& block = state->blocks[number];
      bool any = false;
      for (unsigned in = mayMeet(block, block_ray, static_cast<float>(from_m), up(to_m)); in; in &= in - 1) {
        const auto i = static_cast<size_t>(__builtin_ctz(in));
        const auto hit = meet(ray, corners[i], from_m);
        if (!hit || hit->distance_m > to_m || (hit->distance_m == to_m && block.triangle[i] > triangle)) continue;
        const bool on_front = dot(normalOf(corners[i]), ray.direction) < 0;
        if (!state->stops(block.triangle[i], *hit, on_front, facing, holes)) continue;
        triangle = block.triangle[i];
        front = on_front;
        to_m = hit->distance_m;
        any = true;
      }
      return any;
    }

    Hit hit() const {
      return {triangle, front, ray.origin + ray.direction * static_cast<float>(to_m)};
    }
  };
};

// Embree's builder says which triangles go together best.
void RayCaster::State::makeBlocks() {
  std::vector<RTCBuildPrimitive> primitives;
  primitives.reserve(scene->triangles.size());
  for (uint32_t t = 0; t < scene->triangles.size(); ++t) {
    const Box box = boxOf(cornersOf(*scene, t));
    primitives.push_back({box.lo.x, box.lo.y, box.lo.z, 0, box.hi.x, box.hi.y, box.hi.z, t});
  }
  struct Leaves {
    std::mutex mutex;
    State& state;
  } leaves{{}, *this};
  RTCBVH bvh = rtcNewBVH(device);
  RTCBuildArguments args = rtcDefaultBuildArguments();
  args.byteSize = sizeof args;
  args.maxBranchingFactor = 4;
  args.maxDepth = 1024;
  args.sahBlockSize = kWide;
  args.minLeafSize = args.maxLeafSize = kWide;
  args.bvh = bvh;
  args.primitives = primitives.data();
  args.primitiveCount = args.primitiveArrayCapacity = primitives.size();
  args.userPtr = &leaves;
  // Of its tree the leaves alone are wanted: all nodes are one.
  args.createNode = [](RTCThreadLocalAllocator, unsigned, void* user) { return user; };
  args.setNodeChildren = [](void*, void**, unsigned, void*) {};
  args.setNodeBounds = [](void*, const RTCBounds**, unsigned, void*) {};
  args.createLeaf = [](RTCThreadLocalAllocator, const RTCBuildPrimitive* primitive, size_t count, void* user) {
    auto& to = *static_cast<Leaves*>(user);
    TriangleBlock block;
    std::array<Corners, kWide> corners{};
    for (size_t i = 0; i < count; ++i) {
      corners[i] = cornersOf(*to.state.scene, primitive[i].primID);
      block.set(i, primitive[i].primID, corners[i]);
    }
    for (size_t i = count; i < kWide; ++i) block.clear(i);
    const std::lock_guard lock(to.mutex);
    to.state.blocks.push_back(block);
    to.state.block_corners.insert(to.state.block_corners.end(), corners.begin(), corners.end());
    return user;
  };
  rtcBuildBVH(&args);
  rtcReleaseBVH(bvh);
}

void RayCaster::State::attachBlocks() {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(blocks.size()));
  rtcSetGeometryUserData(geometry, this);
  rtcSetGeometryBoundsFunction(
      geometry,
      [](const RTCBoundsFunctionArguments* args) {
        const auto& state = *static_cast<const State*>(args->geometryUserPtr);
        Box box;
        for (size_t i = 0; i < kWide; ++i)
          if (state.blocks[args->primID].triangle[i] != kNone) box.add(boxOf(state.block_corners[kWide * args->primID + i]));
        const Vec3 lo = box.lo - state.largest * kMargin, hi = box.hi + state.largest * kMargin;
        *args->bounds_o = {lo.x, lo.y, lo.z, 0, hi.x, hi.y, hi.z, 0};
      },
      nullptr);
  // rtcIntersect1 and rtcOccluded1 only: N is 1.
  rtcSetGeometryIntersectFunction(geometry, [](const RTCIntersectFunctionNArguments* args) {
    Cast& cast = Cast::of(args->context);
    if (cast.meetBlock(args->primID)) reinterpret_cast<RTCRayHit*>(args->rayhit)->ray.tfar = up(cast.to_m - cast.way_m);
  });
  rtcSetGeometryOccludedFunction(geometry, [](const RTCOccludedFunctionNArguments* args) {
    if (Cast::of(args->context).meetBlock(args->primID)) reinterpret_cast<RTCRay*>(args->ray)->tfar = -kInfinity;
  });
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(embree, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(embree);
}

Result<RayCaster> RayCaster::create(const Scene& scene, const char* embree) {
  auto state = std::make_shared<State>();
  state->scene = &scene;
  state->device = rtcNewDevice(embree);
  if (!state->device) return Error{ErrorCode::kIo, scene.name, "", "Embree cannot start on this machine", ""};
  rtcSetDeviceErrorFunction(
      state->device,
      [](void* user, RTCError, const char* text) { static_cast<State*>(user)->error = text ? text : "unknown"; },
      state.get());
  state->embree = rtcNewScene(state->device);
  state->cutout.reserve(scene.triangles.size());
  state->offsets.reserve(scene.triangles.size());
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const auto [a, b, c] = cornersOf(scene, t);
    state->cutout.push_back(scene.materials[scene.triangles[t].material].cutout);
    state->offsets.push_back(3e-6f * largestCoordinate(scene, t));
    for (const Vec3 v : {a, b, c})
      for (int axis = 0; axis < 3; ++axis) state->largest[axis] = std::max(state->largest[axis], std::abs(v[axis]));
  }
  const float least = kShortAxis * std::max({state->largest.x, state->largest.y, state->largest.z});
  state->largest = max(state->largest, {least, least, least});
  if (!scene.triangles.empty()) state->makeBlocks();
  if (state->error.empty()) state->attachBlocks();
  if (!state->error.empty()) return Error{ErrorCode::kIo, scene.name, "", "Embree: " + state->error, ""};
  return RayCaster(std::move(state), nullptr, true);
}

RayCaster::RayCaster(std::shared_ptr<const State> state, RayTrail* trail, bool holes) : state_(std::move(state)), trail_(trail), holes_(holes) {}

RayCaster RayCaster::leaving(RayTrail* trail) const { return RayCaster(state_, trail, holes_); }
RayCaster RayCaster::withoutHoles() const { return RayCaster(state_, trail_, false); }

Hit RayCaster::nearest(const Ray& ray, float within_m) const {
  const Scene& scene = *state_->scene;
  const auto hitWithin = [&](float from_m, float to_m, bool facing) {
    State::Cast cast(*state_, ray, from_m, to_m, facing, holes_);
    RTCRayHit rh;
    rh.ray = cast.embreeRay();
    rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    if (cast.comesNear()) rtcIntersect1(state_->embree, &cast.embree, &rh);
    if (trail_) trail_->add(ray, cast.to_m);
    return std::pair(cast.triangle == kNone ? Hit{} : cast.hit(), static_cast<float>(cast.to_m));
  };
  const auto [hit, distance_m] = hitWithin(0, within_m, scene.backs == Backs::kPass);
  // Rooms that share a plane of no thickness: of faces that coincide the one that faces the ray is meant.
  if (!hit.front && (scene.backs == Backs::kReflect || !scene.materials[scene.triangles[hit.triangle].material].double_sided)) {
    const float steep = std::abs(dot(normalized(normalOf(cornersOf(scene, hit.triangle))), ray.direction));
    const float reach = surfaceOffset(hit.triangle) / std::max(steep, 1e-3f);
    const Hit facing = hitWithin(std::max(0.0f, distance_m - reach), std::min(within_m, distance_m + reach), true).first;
    if (facing.triangle != kNone) return facing;
  }
  return hit;
}

bool RayCaster::occluded(const Ray& ray, float distance_m) const {
  State::Cast cast(*state_, ray, 0, distance_m, state_->scene->backs == Backs::kPass, holes_);
  RTCRay r = cast.embreeRay();
  if (cast.comesNear()) rtcOccluded1(state_->embree, &cast.embree, &r);
  // A blocker is enough, wherever else another comes to stand.
  if (trail_ && cast.triangle != kNone) trail_->add({cast.hit().point, ray.direction}, 0);
  else if (trail_) trail_->add(ray, static_cast<double>(distance_m));
  return cast.triangle != kNone;
}

void RayCaster::near(Vec3 point, float distance_m, std::vector<uint32_t>& triangles) const {
  struct Answer {
    const State& state;
    Vec3 point;
    float distance_m;
    std::vector<uint32_t>& triangles;
  } answer{*state_, point, distance_m, triangles};
  triangles.clear();
  RTCPointQuery query{point.x, point.y, point.z, 0, distance_m * kUp};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(
      state_->embree, &query, &context,
      [](RTCPointQueryFunctionArguments* args) {
        auto& to = *static_cast<Answer*>(args->userPtr);
        for (size_t i = 0; i < kWide; ++i) {
          const uint32_t t = to.state.blocks[args->primID].triangle[i];
          if (t != kNone && boxOf(to.state.block_corners[kWide * args->primID + i]).distance(to.point) <= to.distance_m) to.triangles.push_back(t);
        }
        return false;  // the distance stays
      },
      &answer);
  std::sort(triangles.begin(), triangles.end());
}

// Some 25 units in the last place of the largest coordinate.
float RayCaster::surfaceOffset(uint32_t triangle) const { return state_->offsets[triangle]; }

}  // namespace ff::bake
