// Settings as `auto` reads them (runtime/choose_solver.h), in JSON.
#pragma once
#include <nlohmann/json_fwd.hpp>

#include "tools/chart/report.h"

namespace ff::chart {

// The run time's own values are left out.
nlohmann::ordered_json jsonOf(const RunSettings& run);

}  // namespace ff::chart
