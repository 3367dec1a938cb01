// The page on where methods fail: each is driven until it breaks, and what the program does then is counted.
#pragma once
#include <cstdint>
#include <functional>
#include <string>

#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

struct StabilityOptions {
  bool quick = false;  // under a minute on two free cores: fewer swaps, smaller scenes
  uint32_t swaps = 0;  // of the longest walks; 0: 100,000, quick 2,000
  uint64_t seed = 1;   // of scenes, walks and light
  int threads = 0;     // 0: all cores; never changes a figure that is no time
};

// What is being measured, for people who wait: "drift: straight line".
using StabilityProgress = std::function<void(const std::string& what)>;

// Makes its own scenes; bakes into a temporary folder that is gone afterwards. The report's last fact is left to the
// caller: the command. Errors: kIo (no room for the bakes), kUsage.
Result<Report> measureStability(const StabilityOptions& options, const StabilityProgress& progress = {});

}  // namespace ff::chart
