// Nearest hits against a scene's triangles. The only file that sees Embree, which finds the blocks of triangles whose boxes a ray comes
// through; what is hit is decided here, the same on every processor (triangle_hit.h).
#pragma once
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "bake/rays/ray_trail.h"
#include "bake/rays/triangle_hit.h"
#include "bake/scene.h"

namespace ff::bake {

struct Hit {
  uint32_t triangle = kNone;  // of the scene; kNone: the sky
  bool front = true;
  Vec3 point;                 // m
};

struct SightLine {
  Ray ray;
  float length_m;
  bool occluded = false;  // as RayCaster::occlude() has found
};

class RayCaster {
 public:
  static constexpr uint64_t kNoLimit = ~uint64_t{0};
  // Builds the acceleration structure; the scene must outlive the caster. memory_bytes: most for trees, and for blocks of triangles where a Paging lives, about.
  // Where the whole scene's take more, parts of it have trees that are built when a ray comes there, and let go when others need the room; and blocks are
  // in a file (BlockStore). It changes no hit. embree: configuration of its device, for tests ("isa=sse2"). Errors: kIo (device, out of memory). Throws SpillFailed.
  // Where a tree cannot be built or a block not read later, casting throws std::runtime_error.
  static Result<RayCaster> create(const Scene& scene, uint64_t memory_bytes = kNoLimit, const char* embree = nullptr);
  // Casts at the same triangles, and leaves a trail (null: none) of nearest(), occluded() and occlude(), which are no longer thread-safe then.
  RayCaster leaving(RayTrail* trail) const;
  // Casts at the same triangles, none of which has holes or lets light pass: chance, which decides that ray by ray, has no part in what is hit.
  RayCaster withoutHoles() const;

  // Thread-safe, the same answers whatever the processor and number of threads; of equally near triangles the lowest number. Rays pass through the holes of cutout materials, and backs where Scene::backs says so. Where a back and a surface that
  // faces the ray lie in one place to rounding, the latter is hit.
  Hit nearest(const Ray& ray, float within_m = std::numeric_limits<float>::infinity()) const;
  bool occluded(const Ray& ray, float distance_m) const;
  // The same of many rays at once, in any order: up to twice as fast where they start close to each other, as those of a patch. hits: one a ray.
  void nearest(std::span<const Ray> rays, std::span<Hit> hits) const;
  void occlude(std::span<SightLine> lines) const;
  // The triangles whose bounding boxes come within a distance of a point, ascending.
  void near(Vec3 point, float distance_m, std::vector<uint32_t>& triangles) const;
  // How far to lift an origin off this triangle so that rounding cannot put it behind, m: some 25 units in the last place of the
  // triangle's own largest coordinate, whatever else is in the scene.
  float surfaceOffset(uint32_t triangle) const;

 private:
  struct State;
  RayCaster(std::shared_ptr<const State> state, RayTrail* trail, bool holes);
  std::shared_ptr<const State> state_;
  RayTrail* trail_ = nullptr;
  bool holes_ = true;
};

}  // namespace ff::bake
