// Which settings are worth having: what they cost, how far off they are, and those that no other beats in both.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/report.h"

namespace ff::chart {

enum class Cost { kRelightMs, kMemoryMiB, kDiskMiB, kBakeSeconds };

Figure costOf(const Setting& setting, Cost cost);

// The lights that any setting was measured in, in the order that they come up.
std::vector<std::string> lightsOf(const Report& report);

// Of a setting in one light; null where it was not measured.
const Accuracy* accuracyIn(const Setting& setting, const std::string& light);

// Relative L2 error. light "": the worst over all of the report's lights; not measured unless all are.
Figure errorOf(const Report& report, const Setting& setting, const std::string& light);
// The light of that worst error; "" where it is not measured.
std::string worstLight(const Report& report, const Setting& setting);

// The Pareto set: nothing is at most as dear and at most as far off, and better in one of them. Indices by rising cost;
// settings without both figures are not in it.
std::vector<size_t> front(const Report& report, const std::string& light, Cost cost);

// Sets on_front of all settings, by relighting time. light "": the worst.
void markFront(Report& report, const std::string& light);

}  // namespace ff::chart
