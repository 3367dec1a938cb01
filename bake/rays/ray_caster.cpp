#include "bake/rays/ray_caster.h"

#include <embree3/rtcore.h>

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <numeric>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "bake/paging.h"
#include "bake/rays/block_store.h"
#include "bake/rays/surface_sampling.h"

namespace ff::bake {
namespace {

constexpr size_t kWide = TriangleBlock::kTriangles;
constexpr size_t kTogether = RayPacket::kRays;  // that Embree takes at once

// Embree's test of boxes differs between instruction sets. It works axis by axis with a reciprocal of the direction that is an estimate and
// one step of Newton's (right to 2^-21.6 of itself), and rounds what is at most twice as large as the coordinate of box or origin. So it
// is off by 1e-6 of the largest coordinate on an axis, where an origin is at most kReach times as far out. Rays that it takes together it tests by
// their largest and smallest origin and reciprocal first, in the same way, so that a box is displaced by no more. Boxes are wider than that: all
// instruction sets find a triangle that meet() meets.
constexpr float kMargin = 1.2e-6f, kReach = 1.25f;
// Where axes are shorter than that of the longest, they count as so long: directions below 1e-18 are taken for 1e-18.
constexpr float kShortAxis = 0x1p-10f;
// What a tree takes of memory for each of its triangles, B, about (towns: 27, in parts 21); triangles of a part, of whose trees kTrees at least fit.
constexpr double kTreeBytes = 30, kPartTreeBytes = 22, kTrees = 8;
constexpr double kBlockBytes = sizeof(Block) / 3.7;  // likewise, of blocks
constexpr uint64_t kBlocksOf = 5;                   // what is held of blocks, where not all are: one in so many of the memory for both, and what trees leave
constexpr size_t kLeastPart = size_t{1} << 6, kMostPart = size_t{1} << 15;
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

// An order of rays in which neighbours go about the same way: cell by cell of each octant's part of the octahedral map of directions.
template <class RayOf>
std::vector<uint32_t> byDirection(size_t rays, RayOf rayOf) {
  constexpr uint32_t kCells = 16;  // a side
  constexpr std::array<uint8_t, kCells> kSpread = {0, 1, 4, 5, 16, 17, 20, 21, 64, 65, 68, 69, 80, 81, 84, 85};  // the bits of 0, 1, 2 ..., spread
  std::vector<uint16_t> cell(rays);
  std::array<uint32_t, 8 * kCells * kCells + 1> start{};
  for (size_t i = 0; i < rays; ++i) {
    const Vec3& d = rayOf(i).direction;
    const float x = std::abs(d.x), y = std::abs(d.y), scale = kCells / (x + y + std::abs(d.z));
    const auto place = [&](float v) { return kSpread[static_cast<size_t>(std::min(kCells - 1.0f, v * scale))]; };
    const unsigned octant = std::signbit(d.x) | std::signbit(d.y) << 1 | std::signbit(d.z) << 2;
    cell[i] = static_cast<uint16_t>(octant * kCells * kCells + place(x) + 2u * place(y));
    ++start[cell[i] + 1u];
  }
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<uint32_t> order(rays);
  for (uint32_t i = 0; i < rays; ++i) order[start[cell[i]]++] = i;
  return order;
}

}  // namespace

struct RayCaster::State {
  // Triangles that lie near each other.
  struct Part {
    const State* state = nullptr;
    Box box;                              // m
    uint32_t first_block = 0, blocks = 0;
    std::atomic<RTCScene> tree{nullptr};  // over the blocks; null: not built at present
    std::atomic<uint32_t> users{0};       // threads that may be in it
    std::atomic<uint64_t> used_at{0};     // State::clock
    std::mutex building;
  };

  const Scene* scene = nullptr;
  RTCDevice device = nullptr;
  RTCScene top = nullptr;                   // over the parts, where there are several; else the tree of the only one
  std::unique_ptr<Part[]> parts;
  size_t part_count = 0;
  std::unique_ptr<BlockStore> blocks;       // by part
  PagedVector<uint8_t> cutout;              // per scene triangle
  PagedVector<float> offsets;               // per scene triangle, m
  Vec3 largest;                             // coordinates, m

  uint64_t tree_bytes = kNoLimit;
  mutable std::atomic<int64_t> held{0};     // by Embree, B
  mutable std::atomic<uint64_t> clock{0};   // of trees that were built
  struct Retired {
    Part* part;
    RTCScene tree;
  };
  mutable std::mutex mutex;                 // of all below
  mutable std::vector<Retired> retired;     // trees that some thread may still be in
  mutable std::string error;
  mutable std::atomic<bool> failed{false};
  bool built = false;

  // What Embree could not build, for want of threads, it cannot take down either: it would end the process.
  ~State() {
    if (!built) return;
    for (const Retired& r : retired) rtcReleaseScene(r.tree);
    for (size_t p = 0; p < part_count; ++p)
      if (const RTCScene tree = parts[p].tree; tree && tree != top) rtcReleaseScene(tree);
    rtcReleaseScene(top);
    rtcReleaseDevice(device);
  }

  void begin(const char* embree);
  void measure();
  void makeParts(uint64_t memory_bytes);
  void makeBlocks(Part& part, std::span<RTCBuildPrimitive> primitives);
  RTCScene makeTree(const Part& part) const;
  void makeTop();
  void letGo() const;
  RTCScene treeOf(Part& part) const;
  void checkTrees() const {
    if (blocks->failed()) throw std::runtime_error(blocks->error());
    if (failed.load(std::memory_order_relaxed)) {
      const std::lock_guard lock(mutex);
      throw std::runtime_error("Embree: " + error);
    }
  }

  // A part whose tree stays while this lives. only_built: it is not built where there is none.
  class Visit {
   public:
    explicit Visit(Part& part, bool only_built = false) : part_(part) {
      ++part_.users;
      tree_ = only_built && !part.tree ? nullptr : part.state->treeOf(part);
    }
    ~Visit() { --part_.users; }
    Visit(const Visit&) = delete;
    Visit& operator=(const Visit&) = delete;
    RTCScene tree() const { return tree_; }  // null: it could not be built

   private:
    Part& part_;
    RTCScene tree_;
  };

  // Whether a ray is stopped where it meets a triangle, on its front or back; facing: by surfaces only that face it.
  bool stops(uint32_t triangle, const TriangleHit& hit, bool front, bool facing, bool holes) const {
    if (holes && cutout[triangle] && isHole(*scene, triangle, hit.b, hit.c)) return false;
    if (!facing || front) return true;
    return scene->backs != Backs::kReflect && scene->materials[scene->triangles[triangle].material].double_sided;
  }

  // How far a ray goes before it comes near the scene, m: 0 for all that start there, infinite for what goes away or is no number, which Embree does
  // not take.
  double wayTo(const Ray& ray) const {
    double way = std::isfinite(dot(ray.origin, ray.direction)) ? 0 : std::numeric_limits<double>::infinity();
    for (int axis = 0; axis < 3; ++axis) {
      const double outside = static_cast<double>(std::abs(ray.origin[axis]) - kReach * largest[axis]);
      const double inward = static_cast<double>(std::copysign(1.0f, -ray.origin[axis]) * ray.direction[axis]);
      if (outside > 0) way = std::max(way, inward > 0 ? outside / inward : std::numeric_limits<double>::infinity());
    }
    return way;
  }

  // One ray under way, and the nearest of what it has met.
  struct Cast {
    Ray ray;
    bool facing, holes;
    uint32_t triangle = kNone;
    bool front = true;
    double from_m, to_m;
    double way_m;  // from the ray's origin to Embree's

    Cast(const State& state, const Ray& r, float from, float to, bool facing_only, bool with_holes)
        : ray(r), facing(facing_only), holes(with_holes), from_m(static_cast<double>(from)), to_m(static_cast<double>(to)), way_m(state.wayTo(r)) {}

    bool comesNear() const { return way_m < to_m; }
    float upTo() const { return up(to_m - way_m); }  // as far as Embree's ray goes

    // As ray i of n, with that number.
    void put(RTCRayN* to, unsigned n, unsigned i) const {
      const auto moved = [&](float at, float along) {
        return way_m > 0 ? static_cast<float>(static_cast<double>(at) + way_m * static_cast<double>(along)) : at;
      };
      RTCRayN_org_x(to, n, i) = moved(ray.origin.x, ray.direction.x);
      RTCRayN_org_y(to, n, i) = moved(ray.origin.y, ray.direction.y);
      RTCRayN_org_z(to, n, i) = moved(ray.origin.z, ray.direction.z);
      RTCRayN_dir_x(to, n, i) = ray.direction.x;
      RTCRayN_dir_y(to, n, i) = ray.direction.y;
      RTCRayN_dir_z(to, n, i) = ray.direction.z;
      RTCRayN_tnear(to, n, i) = way_m > 0 ? 0 : static_cast<float>(from_m);
      RTCRayN_tfar(to, n, i) = upTo();
      RTCRayN_mask(to, n, i) = ~0u;
      RTCRayN_time(to, n, i) = 0;
      RTCRayN_flags(to, n, i) = 0;
      RTCRayN_id(to, n, i) = i;
    }

    // Whether one of a block is nearer, or as near and lower in number, than what was met before. may_meet: a bit for each.
    bool meetBlock(const State& state, const Block& block, unsigned may_meet) {
      bool any = false;
      for (unsigned in = may_meet; in; in &= in - 1) {
        const auto i = static_cast<size_t>(__builtin_ctz(in));
        const auto hit = meet(ray, block.corners[i], from_m);
        if (!hit || hit->distance_m > to_m || (hit->distance_m == to_m && block.planes.triangle[i] > triangle)) continue;
        const bool on_front = dot(normalOf(block.corners[i]), ray.direction) < 0;
        if (!state.stops(block.planes.triangle[i], *hit, on_front, facing, holes)) continue;
        triangle = block.planes.triangle[i];
        front = on_front;
        to_m = hit->distance_m;
        any = true;
      }
      return any;
    }

    // A blocker is enough, wherever else another comes to stand.
    void leaveOccluded(RayTrail* trail, float distance_m) const {
      if (trail && triangle != kNone) trail->add({hit().point, ray.direction}, 0);
      else if (trail) trail->add(ray, static_cast<double>(distance_m));
    }

    Hit hit() const {
      if (triangle == kNone) return {};
      return {triangle, front, ray.origin + ray.direction * static_cast<float>(to_m)};
    }
  };

  // Whether it is a back that was hit, of a surface that counts with its front alone.
  bool isBack(const Hit& hit) const {
    return !hit.front && (scene->backs == Backs::kReflect || !scene->materials[scene->triangles[hit.triangle].material].double_sided);
  }
  // Rooms that share a plane of no thickness: of faces that coincide with a back that was hit the one that faces the ray is meant.
  Cast facing(const Hit& back, const Cast& hit, float within_m) const {
    const float steep = std::abs(dot(normalized(normalOf(cornersOf(*scene, back.triangle))), hit.ray.direction));
    const float reach = offsets[back.triangle] / std::max(steep, 1e-3f), at = static_cast<float>(hit.to_m);
    return Cast(*this, hit.ray, std::max(0.0f, at - reach), std::min(within_m, at + reach), true, hit.holes);
  }

  // Rays that Embree takes together.
  struct Together {
    RTCIntersectContext embree;  // first: Embree hands back a pointer to it
    const State& state;
    const BlockStore::Reader blocks;
    Cast* casts;                                     // by the number that Embree's rays have
    alignas(64) std::array<float, kTogether> error;  // RayPacket::error
    std::vector<Part*>* put_off = nullptr;           // parts without a tree that rays to be occluded came through, where they are left for later

    Together(const State& s, Cast* c) : state(s), blocks(*s.blocks), casts(c) { rtcInitIntersectContext(&embree); }
    static Together& of(RTCIntersectContext* context) { return *reinterpret_cast<Together*>(context); }

    // f(place of a ray, its cast) for those that a block stops nearer than anything did before.
    template <class F>
    void meetBlock(RTCRayN* rays, unsigned n, const int* valid, unsigned number, F f) const {
      const Block& block = blocks[number];
      __builtin_prefetch(&block.corners[0]);
      __builtin_prefetch(&block.corners[2]);
      if (n == kTogether) {  // else 1, or as many as instruction sets before avx512 take
        const RTCRay16& r = *reinterpret_cast<const RTCRay16*>(rays);
        alignas(64) uint32_t may_meet[kTogether];
        unsigned left = mayMeet(block.planes, {r.org_x, r.org_y, r.org_z, r.dir_x, r.dir_y, r.dir_z, r.tnear, r.tfar, error.data(), valid}, may_meet);
        for (; left; left &= left - 1) {
          const auto i = static_cast<unsigned>(__builtin_ctz(left));
          if (casts[i].meetBlock(state, block, may_meet[i])) f(i, casts[i]);
        }
        return;
      }
      for (unsigned i = 0; i < n; ++i) {
        if (!valid[i]) continue;
        Cast& cast = casts[RTCRayN_id(rays, n, i)];
        const unsigned may_meet = mayMeet(block.planes, BlockRay(cast.ray), static_cast<float>(cast.from_m), up(cast.to_m));
        if (cast.meetBlock(state, block, may_meet)) f(i, cast);
      }
    }
  };

  static void occlude(RTCScene tree, RTCIntersectContext* context, RTCRayN* rays, unsigned n, const int* valid) {
    switch (n) {
      case 1: return rtcOccluded1(tree, context, reinterpret_cast<RTCRay*>(rays));
      case 4: return rtcOccluded4(valid, tree, context, reinterpret_cast<RTCRay4*>(rays));
      case 8: return rtcOccluded8(valid, tree, context, reinterpret_cast<RTCRay8*>(rays));
      default: return rtcOccluded16(valid, tree, context, reinterpret_cast<RTCRay16*>(rays));
    }
  }

  // Parts that have trees come first, wherever they stand on the way: most rays end there, and no tree is built for them.
  void occludeAll(Together& together, RTCRayN* rays, unsigned n, int* valid) const {
    std::vector<Part*> without_tree;
    together.put_off = &without_tree;
    occlude(top, &together.embree, rays, n, valid);
    for (Part* part : without_tree) {
      bool left = false;
      for (unsigned i = 0; i < n; ++i) {
        if (RTCRayN_tfar(rays, n, i) == -kInfinity) valid[i] = 0;
        left |= valid[i] != 0;
      }
      if (!left) return;
      const Visit visit(*part);
      if (visit.tree()) occlude(visit.tree(), &together.embree, rays, n, valid);
    }
  }

  // any: until something is met, whatever it is.
  void find(Cast& cast, bool any) const {
    if (!cast.comesNear()) return;
    Together together(*this, &cast);
    RTCRayHit ray;
    int valid = -1;
    cast.put(reinterpret_cast<RTCRayN*>(&ray.ray), 1, 0);
    ray.hit.geomID = ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    if (any) occludeAll(together, reinterpret_cast<RTCRayN*>(&ray.ray), 1, &valid);
    else rtcIntersect1(top, &together.embree, &ray);
    checkTrees();
  }

  // Up to kTogether that go about the same way.
  void find(std::span<Cast> casts, bool any) const {
    Together together(*this, casts.data());
    together.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    alignas(64) RTCRayHit16 rays{};
    alignas(64) std::array<int, kTogether> valid{};
    for (unsigned i = 0; i < casts.size(); ++i) {
      if (casts[i].way_m > 0) continue;
      valid[i] = -1;
      casts[i].put(reinterpret_cast<RTCRayN*>(&rays.ray), kTogether, i);
      rays.hit.geomID[i] = rays.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
      together.error[i] = originError(casts[i].ray.origin);
    }
    if (any) occludeAll(together, reinterpret_cast<RTCRayN*>(&rays.ray), kTogether, valid.data());
    else rtcIntersect16(valid.data(), top, &together.embree, &rays);
    checkTrees();
    for (Cast& cast : casts)
      if (cast.way_m > 0) find(cast, any);
  }

  // In that order of rays: castOf(ray) begins one, take(ray, cast) is told its end.
  template <class CastOf, class Take>
  void findAll(std::span<const uint32_t> order, bool any, CastOf castOf, Take take) const {
    std::vector<Cast> casts;
    casts.reserve(kTogether);
    for (size_t from = 0; from < order.size(); from += kTogether) {
      const auto now = order.subspan(from, std::min(kTogether, order.size() - from));
      casts.clear();
      for (const uint32_t i : now) casts.push_back(castOf(i));
      find(std::span(casts), any);
      for (size_t k = 0; k < now.size(); ++k) take(now[k], casts[k]);
    }
  }
};

void RayCaster::State::begin(const char* embree) {
  device = rtcNewDevice(embree);
  if (!device) return;
  rtcSetDeviceErrorFunction(
      device,
      [](void* user, RTCError, const char* text) {
        auto& state = *static_cast<State*>(user);
        const std::lock_guard lock(state.mutex);
        state.error = text ? text : "unknown";
        state.failed = true;
      },
      this);
  rtcSetDeviceMemoryMonitorFunction(
      device,
      [](void* user, ssize_t bytes, bool) {
        static_cast<State*>(user)->held += bytes;
        return true;
      },
      this);
}

void RayCaster::State::measure() {
  cutout.reserve(scene->triangles.size());
  offsets.reserve(scene->triangles.size());
  for (uint32_t t = 0; t < scene->triangles.size(); ++t) {
    cutout.push_back(scene->materials[scene->triangles[t].material].cutout);
    offsets.push_back(3e-6f * largestCoordinate(*scene, t));
    for (const Vec3 v : cornersOf(*scene, t))
      for (int axis = 0; axis < 3; ++axis) largest[axis] = std::max(largest[axis], std::abs(v[axis]));
  }
  const float least = kShortAxis * std::max({largest.x, largest.y, largest.z});
  largest = max(largest, {least, least, least});
}

namespace {

Vec3 middleOf(const RTCBuildPrimitive& p) { return {p.lower_x + p.upper_x, p.lower_y + p.upper_y, p.lower_z + p.upper_z}; }  // twice as far out

// Cuts triangles in halves along the longest side of the box of their middles until there are few enough. parts: appended.
void halve(std::span<RTCBuildPrimitive> triangles, size_t most, std::vector<std::span<RTCBuildPrimitive>>& parts) {
  if (triangles.size() <= most) {
    parts.push_back(triangles);
    return;
  }
  Box box;
  for (const RTCBuildPrimitive& p : triangles) box.add(middleOf(p));
  const Vec3 size = box.hi - box.lo;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const auto middle = triangles.begin() + static_cast<ptrdiff_t>(triangles.size() / 2);
  std::nth_element(triangles.begin(), middle, triangles.end(), [&](const RTCBuildPrimitive& a, const RTCBuildPrimitive& b) {
    const float x = middleOf(a)[axis], y = middleOf(b)[axis];
    return x < y || (x == y && a.primID < b.primID);
  });
  std::vector<std::span<RTCBuildPrimitive>> second;
  tbb::parallel_invoke([&] { halve(triangles.first(triangles.size() / 2), most, parts); }, [&] { halve(triangles.subspan(triangles.size() / 2), most, second); });
  parts.insert(parts.end(), second.begin(), second.end());
}

// The same, what is larger than its part would be apart from it: it would make the box of one large part of all of them.
std::vector<std::span<RTCBuildPrimitive>> partsOf(std::span<RTCBuildPrimitive> triangles, size_t most) {
  std::vector<std::span<RTCBuildPrimitive>> parts;
  if (triangles.size() <= most) return {triangles};
  Box box;
  for (const RTCBuildPrimitive& p : triangles) box.add(middleOf(p) * 0.5f);
  const Vec3 size = box.hi - box.lo;
  const float broad = std::max({size.x, size.y, size.z}) / std::sqrt(static_cast<float>(triangles.size()) / static_cast<float>(most));
  const auto large = std::partition(triangles.begin(), triangles.end(), [&](const RTCBuildPrimitive& p) {
    return std::max({p.upper_x - p.lower_x, p.upper_y - p.lower_y, p.upper_z - p.lower_z}) <= broad;
  });
  const auto small = static_cast<size_t>(large - triangles.begin());
  if (small > 0) halve(triangles.first(small), most, parts);
  if (small < triangles.size()) halve(triangles.subspan(small), most, parts);
  return parts;
}

}  // namespace

// Parts, and their blocks.
void RayCaster::State::makeParts(uint64_t memory_bytes) {
  PagedVector<RTCBuildPrimitive> primitives;
  primitives.reserve(scene->triangles.size());
  for (uint32_t t = 0; t < scene->triangles.size(); ++t) {
    const Box box = boxOf(cornersOf(*scene, t));
    primitives.push_back({box.lo.x, box.lo.y, box.lo.z, 0, box.hi.x, box.hi.y, box.hi.z, t});
  }
  const auto triangles = static_cast<double>(primitives.size()), room = static_cast<double>(memory_bytes);
  const bool aside = isPaging() && triangles * (kTreeBytes + kBlockBytes) > room;
  const uint64_t cache_bytes = aside ? std::max(memory_bytes / kBlocksOf, memory_bytes - std::min(memory_bytes, static_cast<uint64_t>(triangles * kPartTreeBytes))) : 0;
  blocks = aside ? std::make_unique<BlockStore>(cache_bytes) : std::make_unique<BlockStore>();
  tree_bytes = memory_bytes - cache_bytes;
  const bool in_parts = aside || triangles * kTreeBytes > room;
  const auto of_part = std::clamp(static_cast<size_t>(static_cast<double>(tree_bytes) / (kTrees * kTreeBytes)), kLeastPart, kMostPart);
  const auto of_parts = partsOf(primitives, in_parts ? of_part : primitives.size());
  part_count = of_parts.size();
  parts = std::make_unique<Part[]>(part_count);
  tbb::parallel_for(size_t{0}, part_count, [&](size_t p) {
    parts[p].state = this;
    for (const RTCBuildPrimitive& own : of_parts[p]) {
      parts[p].box.add(Vec3{own.lower_x, own.lower_y, own.lower_z});
      parts[p].box.add(Vec3{own.upper_x, own.upper_y, own.upper_z});
    }
    if (!of_parts[p].empty()) makeBlocks(parts[p], of_parts[p]);
  });
  blocks->finish();
}

// Embree's builder says which triangles go together best.
void RayCaster::State::makeBlocks(Part& part, std::span<RTCBuildPrimitive> primitives) {
  struct Leaves {
    const Scene& scene;
    std::mutex mutex;
    std::vector<Block> blocks;
  } leaves{*scene, {}, {}};
  leaves.blocks.reserve(primitives.size() / 3 + 1);
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
    Block block{};
    for (size_t i = 0; i < count; ++i) {
      block.corners[i] = cornersOf(to.scene, primitive[i].primID);
      block.planes.set(i, primitive[i].primID, block.corners[i]);
    }
    for (size_t i = count; i < kWide; ++i) block.planes.clear(i);
    const std::lock_guard lock(to.mutex);
    to.blocks.push_back(block);
    return user;
  };
  tbb::this_task_arena::isolate([&] { rtcBuildBVH(&args); });
  rtcReleaseBVH(bvh);
  const std::lock_guard lock(mutex);
  part.first_block = blocks->add(std::move(leaves.blocks));
  part.blocks = blocks->size() - part.first_block;
}

RTCScene RayCaster::State::makeTree(const Part& part) const {
  const RTCScene tree = rtcNewScene(device);
  if (part_count > 1) rtcSetSceneFlags(tree, RTC_SCENE_FLAG_COMPACT);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, part.blocks);
  rtcSetGeometryUserData(geometry, const_cast<Part*>(&part));
  rtcSetGeometryBoundsFunction(
      geometry,
      [](const RTCBoundsFunctionArguments* args) {
        const auto& own = *static_cast<const Part*>(args->geometryUserPtr);
        const State& state = *own.state;
        const BlockStore::Reader reader(*state.blocks);
        const Block& block = reader[own.first_block + args->primID];
        Box box;
        for (size_t i = 0; i < kWide; ++i)
          if (block.planes.triangle[i] != kNone) box.add(boxOf(block.corners[i]));
        const Vec3 lo = box.lo - state.largest * kMargin, hi = box.hi + state.largest * kMargin;
        *args->bounds_o = {lo.x, lo.y, lo.z, 0, hi.x, hi.y, hi.z, 0};
      },
      nullptr);
  rtcSetGeometryIntersectFunction(geometry, [](const RTCIntersectFunctionNArguments* args) {
    RTCRayN* rays = RTCRayHitN_RayN(args->rayhit, args->N);
    const unsigned number = static_cast<const Part*>(args->geometryUserPtr)->first_block + args->primID;
    Together::of(args->context).meetBlock(rays, args->N, args->valid, number, [&](unsigned i, const Cast& cast) { RTCRayN_tfar(rays, args->N, i) = cast.upTo(); });
  });
  rtcSetGeometryOccludedFunction(geometry, [](const RTCOccludedFunctionNArguments* args) {
    const unsigned number = static_cast<const Part*>(args->geometryUserPtr)->first_block + args->primID;
    Together::of(args->context).meetBlock(args->ray, args->N, args->valid, number, [&](unsigned i, const Cast&) { RTCRayN_tfar(args->ray, args->N, i) = -kInfinity; });
  });
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(tree, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(tree);
  return tree;
}

// Over the parts: a ray goes on in the trees of those that it comes through.
void RayCaster::State::makeTop() {
  if (part_count == 1) {
    top = makeTree(parts[0]);
    parts[0].tree = top;
    return;
  }
  top = rtcNewScene(device);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(part_count));
  rtcSetGeometryUserData(geometry, parts.get());
  rtcSetGeometryBoundsFunction(
      geometry,
      [](const RTCBoundsFunctionArguments* args) {
        const Part& part = static_cast<const Part*>(args->geometryUserPtr)[args->primID];
        const Vec3 lo = part.box.lo - part.state->largest * kMargin, hi = part.box.hi + part.state->largest * kMargin;
        *args->bounds_o = {lo.x, lo.y, lo.z, 0, hi.x, hi.y, hi.z, 0};
      },
      nullptr);
  rtcSetGeometryIntersectFunction(geometry, [](const RTCIntersectFunctionNArguments* args) {
    const Visit visit(static_cast<Part*>(args->geometryUserPtr)[args->primID]);
    if (!visit.tree()) return;
    switch (args->N) {
      case 1: return rtcIntersect1(visit.tree(), args->context, reinterpret_cast<RTCRayHit*>(args->rayhit));
      case 4: return rtcIntersect4(args->valid, visit.tree(), args->context, reinterpret_cast<RTCRayHit4*>(args->rayhit));
      case 8: return rtcIntersect8(args->valid, visit.tree(), args->context, reinterpret_cast<RTCRayHit8*>(args->rayhit));
      default: return rtcIntersect16(args->valid, visit.tree(), args->context, reinterpret_cast<RTCRayHit16*>(args->rayhit));
    }
  });
  rtcSetGeometryOccludedFunction(geometry, [](const RTCOccludedFunctionNArguments* args) {
    Part& part = static_cast<Part*>(args->geometryUserPtr)[args->primID];
    const Visit visit(part, true);
    if (visit.tree()) return occlude(visit.tree(), args->context, args->ray, args->N, args->valid);
    auto& put_off = *Together::of(args->context).put_off;
    if (std::find(put_off.begin(), put_off.end(), &part) == put_off.end()) put_off.push_back(&part);
  });
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(top, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(top);
}

RTCScene RayCaster::State::treeOf(Part& part) const {
  RTCScene tree = part.tree;
  if (!tree) {
    const std::lock_guard lock(part.building);
    tree = part.tree;
    if (!tree && !failed) {
      tbb::this_task_arena::isolate([&] { tree = makeTree(part); });  // whoever waits for it may not begin what waits for this lock
      ++clock;
      part.tree = tree;
      letGo();
    }
  }
  part.used_at.store(clock.load(std::memory_order_relaxed), std::memory_order_relaxed);
  return tree;
}

// Trees that were used longest ago, while there is too much. Nobody is in a tree that was retired once its part had no user since.
void RayCaster::State::letGo() const {
  const std::lock_guard lock(mutex);
  std::erase_if(retired, [](const Retired& r) {
    if (r.part->users != 0) return false;
    rtcReleaseScene(r.tree);
    return true;
  });
  while (held > static_cast<int64_t>(tree_bytes)) {
    Part* oldest = nullptr;
    for (size_t p = 0; p < part_count; ++p)
      if (parts[p].tree.load() && parts[p].users == 0 && (!oldest || parts[p].used_at < oldest->used_at)) oldest = &parts[p];
    if (!oldest) return;
    const RTCScene tree = oldest->tree.exchange(nullptr);
    if (oldest->users == 0) rtcReleaseScene(tree);
    else retired.push_back({oldest, tree});
  }
}

Result<RayCaster> RayCaster::create(const Scene& scene, uint64_t memory_bytes, const char* embree) {
  auto state = std::make_shared<State>();
  state->scene = &scene;
  state->begin(embree);
  if (!state->device) return Error{ErrorCode::kIo, scene.name, "", "Embree cannot start on this machine", ""};
  state->measure();
  state->makeParts(memory_bytes);
  if (!state->failed) state->makeTop();
  if (state->failed) return Error{ErrorCode::kIo, scene.name, "", "Embree: " + state->error, ""};
  state->built = true;
  return RayCaster(std::move(state), nullptr, true);
}

RayCaster::RayCaster(std::shared_ptr<const State> state, RayTrail* trail, bool holes) : state_(std::move(state)), trail_(trail), holes_(holes) {}

RayCaster RayCaster::leaving(RayTrail* trail) const { return RayCaster(state_, trail, holes_); }
RayCaster RayCaster::withoutHoles() const { return RayCaster(state_, trail_, false); }

Hit RayCaster::nearest(const Ray& ray, float within_m) const {
  State::Cast cast(*state_, ray, 0, within_m, state_->scene->backs == Backs::kPass, holes_);
  state_->find(cast, false);
  if (trail_) trail_->add(ray, cast.to_m);
  const Hit hit = cast.hit();
  if (!state_->isBack(hit)) return hit;
  State::Cast facing = state_->facing(hit, cast, within_m);
  state_->find(facing, false);
  if (trail_) trail_->add(ray, facing.to_m);
  return facing.triangle == kNone ? hit : facing.hit();
}

void RayCaster::nearest(std::span<const Ray> rays, std::span<Hit> hits) const {
  const bool passed = state_->scene->backs == Backs::kPass;
  std::vector<State::Cast> backs;  // that were hit
  std::vector<uint32_t> ray_of;    // them
  state_->findAll(
      byDirection(rays.size(), [&](size_t i) -> const Ray& { return rays[i]; }), false, [&](size_t i) { return State::Cast(*state_, rays[i], 0, kInfinity, passed, holes_); },
      [&](uint32_t i, const State::Cast& cast) {
        if (trail_) trail_->add(cast.ray, cast.to_m);
        hits[i] = cast.hit();
        if (!state_->isBack(hits[i])) return;
        backs.push_back(state_->facing(hits[i], cast, kInfinity));
        ray_of.push_back(i);
      });
  for (size_t from = 0; from < backs.size(); from += kTogether) {
    const size_t end = std::min(backs.size(), from + kTogether);
    state_->find(std::span(backs).subspan(from, end - from), false);
    for (size_t k = from; k < end; ++k) {
      if (trail_) trail_->add(backs[k].ray, backs[k].to_m);
      if (backs[k].triangle != kNone) hits[ray_of[k]] = backs[k].hit();
    }
  }
}

bool RayCaster::occluded(const Ray& ray, float distance_m) const {
  State::Cast cast(*state_, ray, 0, distance_m, state_->scene->backs == Backs::kPass, holes_);
  state_->find(cast, true);
  cast.leaveOccluded(trail_, distance_m);
  return cast.triangle != kNone;
}

void RayCaster::occlude(std::span<SightLine> lines) const {
  const bool passed = state_->scene->backs == Backs::kPass;
  state_->findAll(
      byDirection(lines.size(), [&](size_t i) -> const Ray& { return lines[i].ray; }), true,
      [&](size_t i) { return State::Cast(*state_, lines[i].ray, 0, lines[i].length_m, passed, holes_); },
      [&](size_t i, const State::Cast& cast) {
        cast.leaveOccluded(trail_, lines[i].length_m);
        lines[i].occluded = cast.triangle != kNone;
      });
}

void RayCaster::near(Vec3 point, float distance_m, std::vector<uint32_t>& triangles) const {
  struct Answer {
    const State& state;
    Vec3 point;
    float distance_m;
    std::vector<uint32_t>& triangles;
    const State::Part* part;
    const BlockStore::Reader blocks;
  } answer{*state_, point, distance_m, triangles, &state_->parts[0], BlockStore::Reader(*state_->blocks)};
  triangles.clear();
  RTCPointQuery query{point.x, point.y, point.z, 0, distance_m * kUp};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  static constexpr auto inPart = [](RTCPointQueryFunctionArguments* args) {
    auto& to = *static_cast<Answer*>(args->userPtr);
    const Block& block = to.blocks[to.part->first_block + args->primID];
    for (size_t i = 0; i < kWide; ++i) {
      const uint32_t t = block.planes.triangle[i];
      if (t != kNone && boxOf(block.corners[i]).distance(to.point) <= to.distance_m) to.triangles.push_back(t);
    }
    return false;  // the distance stays
  };
  static constexpr auto inParts = [](RTCPointQueryFunctionArguments* args) {
    auto& to = *static_cast<Answer*>(args->userPtr);
    const State::Visit visit(to.state.parts[args->primID]);
    to.part = &to.state.parts[args->primID];
    if (visit.tree()) rtcPointQuery(visit.tree(), args->query, args->context, inPart, &to);
    return false;
  };
  rtcPointQuery(state_->top, &query, &context, state_->part_count > 1 ? +inParts : +inPart, &answer);
  state_->checkTrees();
  std::sort(triangles.begin(), triangles.end());
}

// Some 25 units in the last place of the largest coordinate.
float RayCaster::surfaceOffset(uint32_t triangle) const { return state_->offsets[triangle]; }

}  // namespace ff::bake
