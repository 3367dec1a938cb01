// The experiments of stability.h, each a part of its report. Every part is repeatable: its seed decides all.
#pragma once
#include "formats/result.h"
#include "tools/chart/stability/breaking_point.h"
#include "tools/chart/stability/stability.h"
#include "tools/chart/walks.h"

namespace ff::chart {

struct StabilityPart {
  std::vector<Chart> charts;
  std::vector<Measured> measured;
  std::string lead;  // a sentence
};

// Swaps of patches, in scenes that are numbers alone (walks.h).
struct WalkCase {
  std::string name;
  walks::SceneSettings scene;
  walks::WalkKind kind = walks::WalkKind::kStraight;
  uint32_t places = 256, block = 32;
  uint32_t swaps = 0;
  uint32_t seed_swaps = 0;  // likewise, of the seed's method; 0: it is left out
};
// `seed`, `multibounce` in fp32 and fp16 as they are, never built anew unless a block is refused; and what the dense
// solver shows on top of the latter two. Errors after the first block, and then when the swaps have doubled.
Result<std::vector<Measured>> measureWalk(const WalkCase& walk, int threads);
Result<StabilityPart> stabilityOfWalks(const StabilityOptions& options, const StabilityProgress& progress);

// Albedo towards 1 in closed boxes.
Result<StabilityPart> stabilityOfAlbedo(const StabilityOptions& options, const StabilityProgress& progress);
// Energy of a baked furnace against B = M / (1 - albedo).
Result<StabilityPart> stabilityOfEnergy(const StabilityOptions& options, const StabilityProgress& progress);

// Too few rays, against closed forms and in a town.
Result<StabilityPart> stabilityOfRays(const StabilityOptions& options, const StabilityProgress& progress);

// Light in a closed dark room beside a lit one.
Result<StabilityPart> stabilityOfLeaks(const StabilityOptions& options, const StabilityProgress& progress);

// Radius of the cut towards nothing.
Result<StabilityPart> stabilityOfRadius(const StabilityOptions& options, const StabilityProgress& progress);

}  // namespace ff::chart
