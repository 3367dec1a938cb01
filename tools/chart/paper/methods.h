// Every method of the paper's figures on the patches around one observer: what it gets wrong, what it costs.
#pragma once
#include <string>
#include <vector>

#include "formats/read/whole_world.h"
#include "tools/chart/neighbourhood.h"

namespace ff::chart {

struct MethodCost {
  std::string name;
  uint32_t patches = 0;                          // of the local matrix
  size_t nodes = 0;                              // of the cut, gather only: patches and clusters
  double linear = 0;                             // mean |B - truth| over mean truth, by area, over all active patches
  double picture = 0;                            // mean difference of a picture's value, 0 to 1, same patches
  Difference inner{};                            // of reflected radiosity within half the local radius
  double relight_ms = 0, relight_spread_ms = 0;  // median, and half the distance between the quartiles
  double over_seed = 0;                          // relight over the seed's in the same round, median of the rounds
  double update_ms = 0;                          // a patch leaves and one enters; of blocks, tiles: their share
  double bytes = 0;                              // of the matrix
};

struct MethodSettings {
  uint32_t patches = 4096;  // M: at most so many around the observer
  int threads = 0;
  int rounds = 9;  // of timing; methods take turns within a round
};

struct MethodsThere {
  std::vector<MethodCost> methods;  // seed, multibounce fp32, multibounce fp16, common radiosity, gather
  double bytes_per_s = 0;           // what all threads read, median of the rounds
};

inline constexpr const char* kSeedName = "seed (the paper's, as printed)";
inline constexpr const char* kCommonName = "common radiosity, 3 products";
inline constexpr const char* kExactName = "multibounce fp16";
inline constexpr const char* kExactFloatName = "multibounce fp32";
inline constexpr const char* kGatherName = "gather on the pyramid cut";

// The M patches nearest to the observer, as far as whole tiles go.
Result<Neighbourhood> nearestPatches(const formats::WholeWorld& world, const WorldTruth& truth, Vec3 observer,
                                     uint32_t patches);

Result<MethodsThere> measureMethods(const formats::WholeWorld& world, const WorldTruth& truth, const Neighbourhood& there,
                                    const MethodSettings& settings);

}  // namespace ff::chart
