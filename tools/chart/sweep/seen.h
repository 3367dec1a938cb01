// What is seen: the light of pixels against the truth at the points that they show.
//
// Eyes look around by rays that cover the sphere evenly. Of the points that they see, every n-th is a pixel of the score: it
// compares the irradiance that its patch is given (light is one value a patch; the viewer interpolates) with the truth
// averaged over all points of that patch that any of the eyes sees. Irradiance, because that is what a person sees as light
// and dark: a texture's texels or two materials of one patch do not blur it.
#pragma once
#include <span>
#include <vector>

#include "tools/chart/report.h"
#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

struct SeenSettings {
  uint32_t rays = 16384;           // an eye
  uint32_t pixels = 512;           // of the score, all eyes together
  uint64_t paths = 12'000'000;     // in one light, all pixels together: most go where the light is noisy
  uint64_t seed = 1;
  int threads = 0;                 // 0: all cores; the result does not depend on it
};

struct SeenPixels {
  std::vector<Vec3> eyes;                     // those that look on air, not out of a solid
  std::vector<SeenSurface> surfaces;          // each with the points of one patch; what has no patch is one as well
  std::vector<std::vector<uint32_t>> pixels;  // by eye: numbers of surfaces, one for every n-th point
  double not_drawn = 0;                       // share of the points that have no patch

  size_t count() const;
};

// Eyes more than half of whose rays end on backs stand in a solid or behind a wall: they are left out.
SeenPixels lookAround(const PathTracer& tracer, std::span<const Vec3> eyes, const SeenSettings& settings);

// The truth of the surfaces in a light: a pilot finds where paths are needed, another seed walks them.
std::vector<PatchTruth> truthOfSeen(const PathTracer& tracer, const SeenPixels& seen, const Lighting& light,
                                    const SeenSettings& settings);

// Errors: unreadable strips; kUsage where no eye sees a surface.
Result<SeenScore> scoreSeen(MeasuredWorld& world, const SeenPixels& seen, const Lighting& light, const Knobs& standard,
                            const SeenSettings& settings);

// In words, one line a light.
Table tableOf(std::span<const SeenScore> scores);

}  // namespace ff::chart
