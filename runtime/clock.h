// The clock that steps are timed with.
#pragma once
#include <chrono>

namespace ff::runtime {

using Clock = std::chrono::steady_clock;
inline double msSince(Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); }

}  // namespace ff::runtime
