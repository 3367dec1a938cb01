// What a bake came to, for people and for programs.
#pragma once
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bake/bake.h"
#include "tools/bake/progress.h"

namespace ff::tools {

// What is odd, a line each; what is not modelled is in the summary.
std::vector<std::string> warningsOf(const bake::BakeStats& stats);

// cache_bytes: of the files in the bake cache; 0: there is none.
void printSummary(const bake::BakeStats& stats, const std::string& world, const PhaseTimes& phases, uint64_t cache_bytes);
nlohmann::json toJson(const bake::BakeStats& stats, const PhaseTimes& phases, uint64_t cache_bytes);

void printStatus(const bake::BakeStatus& status, const std::string& world, uint64_t cache_bytes);
nlohmann::json toJson(const bake::BakeStatus& status, uint64_t cache_bytes);

// Most memory that this process has held, B.
uint64_t peakBytes();

}  // namespace ff::tools
