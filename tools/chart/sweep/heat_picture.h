// Where the light is wrong, as pictures: a view of patches coloured by their error, and the same view as it is lit.
#pragma once
#include <span>
#include <string>
#include <vector>

#include "tools/chart/sweep/measured_world.h"
#include "tools/view/picture.h"

namespace ff::chart {

struct Viewpoint {
  Vec3 eye, target;  // m
};

// The patch behind every sample of a view. The view is 60 degrees wide upright; samples: a side of a pixel.
struct SeenPatches {
  uint32_t width = 0, height = 0, samples = 1;
  std::vector<uint32_t> patch;  // PathTracer::kNoPatch: the sky, or a back
  std::vector<Vec3> direction;  // unit

  std::vector<uint32_t> distinct() const;  // ascending, without kNoPatch
};
SeenPatches lookFrom(const PathTracer& tracer, const Viewpoint& view, uint32_t width = 640, uint32_t height = 400,
                     uint32_t samples = 2);

// A look at a patch from a few cells off, at a slant: of the directions around its normal the one that shows most
// surface. A patch too much hemmed in is seen from `fallback`.
Viewpoint viewpointOf(const MeasuredWorld& world, uint32_t patch, Vec3 fallback);

// By error, 0.05 is 5 %, one per patch of the world (below 0: not known, grey); full_scale is the brightest colour.
view::Picture heatOf(const SeenPatches& seen, std::span<const float> errors, float full_scale, const std::string& title);
// By radiosity, W/m2, one per patch of the world, under that sky; exposed for what is seen.
view::Picture litOf(const SeenPatches& seen, std::span<const Vec3> radiosity, const runtime::Sky& sky);
// Of equal height.
view::Picture sideBySide(const view::Picture& left, const view::Picture& right);

struct WorstPlaces {
  size_t most = 2;
  uint32_t paths = 1000000;  // of all patches that a picture shows, together; at most 4096 each, at least 64
  uint64_t seed = 1;
};

// The places where a setting's settled light is farthest from the path tracer's, each in its worst light: by the patches
// that world.lookAt(places) chose, each patch of the picture by paths of its own. Writes worst-1.png and so on into
// `folder` (which exists). chosen: paths of the patches looked at, where they have not been traced yet.
// Errors: those of the run time and of writing; kUsage (places that the world does not look at).
Result<std::vector<Illustration>> worstPlaces(MeasuredWorld& world, std::span<const Place> places,
                                              std::span<const Lighting> lights, const Knobs& knobs,
                                              const TraceSettings& chosen, const std::string& folder,
                                              const WorstPlaces& options = {});

}  // namespace ff::chart
