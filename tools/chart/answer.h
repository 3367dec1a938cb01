// The setting that is just enough: found among what was measured, and written beside the world, where `auto` takes it up.
#pragma once
#include <limits>
#include <optional>
#include <string>

#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

struct Candidates {
  bool other_bakes = true;  // false: only settings of the default's bake
  bool baselines = false;   // true: also what `auto` cannot choose
};

struct Answer {
  std::optional<size_t> setting;  // of report.settings
  std::string line;               // the setting and its figures; without one, why, and what comes nearest
};

// A question with its answer.
struct Answered {
  std::string asked;                                     // "cheapest with error <= 3 %"
  std::optional<double> rel_l2, relight_ms, memory_mib;  // the limits asked for
  Answer answer;
  std::string written;                                   // where `auto` finds the setting; empty: nowhere
};

// The fastest to relight whose worst error over all lights is at most rel_l2 (0.05: 5 %); of equally fast ones that with
// the least memory. Settings that lack a figure that is asked for are none.
Answer cheapestWithin(const Report& report, double rel_l2, const Candidates& candidates = {});

// The most accurate, by its worst light, of at most so many ms and MiB; of equally accurate ones the fastest. Infinity: any.
Answer bestWithin(const Report& report, double relight_ms, double memory_mib, const Candidates& candidates = {});

// Writes NAME.settings.json beside NAME.ffm: what runtime/choose_solver.h reads, and what was measured. The world is that of
// the setting's own bake. The same setting gives the same bytes; the file is replaced at once. Returns its path. Errors:
// kUsage where `auto` cannot choose such a setting; kIo.
Result<std::string> writeRecommendation(const std::string& world_path, const Report& report, size_t setting);

}  // namespace ff::chart
