// At what number a method breaks: the first past a limit along a knob that is turned from easy to hard.
#pragma once
#include <span>
#include <string>
#include <vector>

#include "tools/chart/report.h"

namespace ff::chart {

// The first number at which the error is above the limit, as text: "3,200", "0.5 m"; "never to 100,000".
std::string passes(const Measured& measured, double limit);
std::string notFinite(const Measured& measured);
// The largest error; infinity is "not finite".
std::string worst(const Measured& measured);

// A line of a chart. Errors above kMaxDrawn end the line there, errors below kLeastDrawn lie on it; the hover has the
// number itself.
inline constexpr double kMaxDrawn = 10, kLeastDrawn = 1e-9;
Series seriesOf(const Measured& measured, const std::string& name);

// One row a method and case.
Table breakingTable(std::span<const Measured> measured);

// "12,345", "0.98", "1.2e-07"; 5.3 %.
std::string numberText(double x);
std::string percentText(double x);

}  // namespace ff::chart
