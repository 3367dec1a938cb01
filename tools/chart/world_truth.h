// What the run time is compared with: the double-precision solve of a whole world under sun, sky and lamps, and the sums of a
// comparison over the patches near an observer.
#pragma once
#include <cmath>
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/cut/node_values.h"
#include "runtime/updater.h"

namespace ff::chart {

// Everything that does not depend on the observer.
struct WorldTruth {
  std::vector<formats::Strip> patches;  // by level-0 tile
  std::vector<float> areas_m2;
  runtime::NodeValues sun;  // irradiance, all levels
  runtime::Sky sky{{1.1f, 1.4f, 1.9f}, {{0, 0.4f, 0}, {0, 0.5f, 0}, {0, 0.7f, 0}}};
  runtime::Lamps lamps;           // their switches
  std::vector<double> radiosity;  // reflected, 3 per patch
  double rms = 0;                 // of radiosity, over patches and channels
};

// lamps: what surfaces emit lights them, too. Errors: unreadable strips or geometry.
Result<WorldTruth> solveWorldTruth(const formats::WholeWorld& world, bool lamps);

// Sums over patches and channels of a comparison with the truth.
struct Difference {
  double reflected = 0, reflected_truth = 0;  // squares
  double bounced = 0;                         // squares of the truth's indirect part alone
  uint32_t patches = 0;
  double meanTruth() const { return patches ? std::sqrt(reflected_truth / (3.0 * patches)) : 0; }
  double relative() const { return std::sqrt(reflected / reflected_truth); }
  Difference& operator+=(const Difference& b) {
    reflected += b.reflected;
    reflected_truth += b.reflected_truth;
    bounced += b.bounced;
    patches += b.patches;
    return *this;
  }
  double relativeBounced() const { return std::sqrt(reflected / bounced); }
};

struct Case {
  Vec3 observer;
  float local_radius_m = 0;  // to the nearest patch that is not active
};

// Distance from the observer to the nearest patch that is not active, m.
float localRadius(const WorldTruth& truth, std::span<const stream::StripPtr> active, Vec3 observer);

// Of the active patches within half the local radius. radiosity, source: by slot.
Difference compare(const WorldTruth& truth, const runtime::LocalMatrix& matrix,
                   std::span<const runtime::Vec4> radiosity, std::span<const runtime::Vec4> source, const Case& at);

// The best constant for the outside: the area-weighted mean radiosity of the patches that are not active.
runtime::Vec4 meanOutside(const WorldTruth& truth, const runtime::LocalMatrix& matrix);

// M per slot of the matrix under the truth's light. active: what the matrix was built from.
std::vector<runtime::Vec4> sourceOf(const WorldTruth& truth, const formats::WholeWorld& world,
                                    const runtime::LocalMatrix& matrix, std::span<const stream::StripPtr> active);

// Eyes half a cell off patches that are spread evenly over the world's order: streets, fields, roofs and rooms.
std::vector<Vec3> observersOf(const WorldTruth& truth, int count, float cell_m);

}  // namespace ff::chart
