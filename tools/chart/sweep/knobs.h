// Everything that can be chosen about a world and its run time: what ffchart varies, one knob at a time.
#pragma once
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "stream/streamer.h"
#include "tools/chart/report.h"

namespace ff::chart {

enum class Method { kGather, kMultibounce, kMultibounceHalf, kMultibounceLuminance, kSeed, kPlainLocal };

// What the baker is told.
struct BakeKnobs {
  float cell_m = 0;       // patch size
  uint32_t rays = 4096;   // per patch
  uint32_t quanta = 512;  // Q
  friend bool operator==(const BakeKnobs&, const BakeKnobs&) = default;
};

struct Knobs {
  BakeKnobs bake;
  Method method = Method::kGather;
  int iterations = 1;          // k: solver steps a frame
  uint32_t places = 4096;      // of a dense matrix
  float radius_m = stream::StreamSettings{}.radius_m;  // r_0
  float growth = stream::StreamSettings{}.growth;      // g
  uint32_t max_patches = stream::StreamSettings{}.max_level0_nodes;  // active at once
  bool pyramid = true;         // false: one constant for all that is far
  int every = 1;               // the cut follows the observer every so many frames
  uint32_t shadow_rays = 256;  // per patch, of the direct light that the run time is given
};

inline bool isDense(Method m) { return m != Method::kGather; }
const char* nameOf(Method m);
// As the page shows them, one line a knob.
std::vector<std::pair<std::string, std::string>> described(const Knobs& knobs);
RunSettings runSettings(const Knobs& knobs);

}  // namespace ff::chart
