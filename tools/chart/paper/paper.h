// The two figures of the seed paper, measured again: Shcherbakov, A., Frolov, V. "Implementation of the Radiosity
// Algorithm for Large Scale Scenes." GraphiCon 2019. Figure 3: the local multi-bounce matrix against the full solution,
// on a scene of about 63,125 patches. Figure 4: against common radiosity on the local matrix, for several sizes of it.
#pragma once
#include <cstdint>
#include <functional>
#include <string>

#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

struct PaperOptions {
  std::string scene_path;  // a Minecraft-like .glb in units of its cells; empty: the generated town alone
  bool quick = false;      // a town of 8,000 patches and matrices up to 1024 instead
  uint64_t seed = 1;
  int threads = 0;  // 0: all cores
};

using PaperProgress = std::function<void(const std::string& what)>;

// Bakes into a temporary folder that is gone afterwards. Differences are repeatable, times are this machine's. The
// report's last fact is left to the caller: the command. Errors: an unreadable scene; kIo (no room for the bakes).
Result<Report> measurePaper(const PaperOptions& options, const PaperProgress& progress = {});

}  // namespace ff::chart
