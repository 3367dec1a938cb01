// The end-to-end truth: reflected radiosity of patches by path tracing on the scene's own triangles. It shares the
// importer with the baker and nothing else: its own sampling, texture reading and use of Embree, no form factor, no
// patch of the baker's. What a patch is, it takes from the world's drawing geometry.
//
// The model is the one that a world is baked for: surfaces reflect diffusely (a metal's colour counts as its albedo),
// the backs of single-sided ones absorb, the sky is linear in direction, the sun a direction without size. The
// estimator is unbiased but for the absorbed backs (a point all of whose five rays end on backs lies inside a solid
// and takes no part) and float arithmetic.
// Kajiya. The Rendering Equation. 1986. Arvo, Kirk. Particle Transport and Image Synthesis. 1990 (roulette).
#pragma once
#include <memory>
#include <span>
#include <vector>

#include "bake/scene.h"
#include "formats/read/whole_world.h"
#include "tools/chart/truth/lighting.h"

namespace ff::chart {

struct PatchTruth {
  Vec3 reflected;   // mean over the patch of what it reflects, W/m2; its own emission is not in it
  Vec3 error;       // its standard error
  Vec3 sun;         // irradiance from the sun alone
  Vec3 direct;      // of `reflected`, what lamps, sun and sky put there without a bounce
  Vec3 direct_error;
  Vec3 irradiance;      // mean over the patch of what arrives, whatever is reflected of it
  Vec3 irradiance_error;
  bool buried = false;  // inside a solid: nothing can be seen of it
};

struct TraceSettings {
  uint32_t paths = 1024;  // per patch; rounded up to kBatches
  uint64_t seed = 1;
  int threads = 0;        // 0 = all cores; the result does not depend on it
};

// A point of the scene's surface that an eye sees.
struct SeenPoint {
  Vec3 point, normal, albedo;  // point: lifted off the surface; normal: towards the eye
  uint32_t patch = 0;          // whose drawing geometry lies there; PathTracer::kNoPatch: nobody's, nothing is drawn
};

// What an eye sees around it, by rays that cover the sphere evenly. Backs of single-sided surfaces are not looked at.
struct EyeView {
  std::vector<SeenPoint> points;
  uint32_t sky = 0, backs = 0;  // rays
};

// Points to take a mean over, each with the same weight, and by how many paths.
struct SeenSurface {
  std::vector<SeenPoint> points;
  uint32_t paths = 1024;  // rounded up to kBatches
};

inline constexpr uint32_t kBatches = 16;  // independent groups of paths a patch: their spread is the standard error

class PathTracer {
 public:
  // scene: what the world was baked from, without the materials left out there; outlives the tracer, as does the world.
  // Errors: kInvalidFile (a world without drawing geometry; a world that lies elsewhere than the scene), kIo.
  static Result<PathTracer> create(const bake::Scene& scene, const formats::WholeWorld& world);
  PathTracer(PathTracer&&) noexcept;
  PathTracer& operator=(PathTracer&&) noexcept;
  ~PathTracer();

  // patches: level-0 node numbers. One result each. Same numbers for the same settings, patch and light, whatever else
  // is traced.
  std::vector<PatchTruth> trace(std::span<const uint32_t> patches, const Lighting& light,
                                const TraceSettings& settings) const;
  EyeView lookFrom(Vec3 eye, uint32_t rays) const;
  // The mean over what is seen of a surface. One result each; the same numbers for the same seed, light and surface.
  std::vector<PatchTruth> traceSeen(std::span<const SeenSurface> surfaces, const Lighting& light, uint64_t seed,
                                    int threads = 0) const;
  // Irradiance of patches from the sun alone, W/m2, by `rays` shadow rays each: what an engine's own shadows would give.
  std::vector<Vec3> sunIrradiance(std::span<const uint32_t> patches, const Lighting& light, uint32_t rays,
                                  int threads = 0) const;
  // Paths per second of the last trace on its threads: rays cast, counted.
  uint64_t raysCast() const;

  // The patch seen along a ray through the drawing geometry; kNoPatch: none, or a back. Of a double-sided surface, whose
  // sides lie at one place, the side that faces the ray.
  static constexpr uint32_t kNoPatch = 0xffffffffu;
  uint32_t patchSeen(Vec3 origin, Vec3 direction) const { return sight(origin, direction).patch; }
  struct Sight {
    uint32_t patch = kNoPatch;
    float distance_m = 0;  // to what is met, backs as well; infinity: nothing
  };
  Sight sight(Vec3 origin, Vec3 direction) const;  // direction: unit

 private:
  struct State;
  explicit PathTracer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace ff::chart
