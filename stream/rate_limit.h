// At most so many bytes a second, of what begins when it is let. Time is whatever its owner says it is.
#pragma once
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <functional>

namespace ff::stream {

using Clock = std::chrono::steady_clock;
using Now = std::function<Clock::time_point()>;

// Not thread-safe. In any time T at most bytes_per_second * (T + kBurst) bytes begin, and what began last.
class RateLimit {
 public:
  static constexpr std::chrono::milliseconds kBurst{50};

  // 0: no limit.
  explicit RateLimit(uint64_t bytes_per_second) : bytes_per_second_(bytes_per_second) {}
  bool limits() const { return bytes_per_second_ > 0; }
  bool lets(Clock::time_point now) const { return bytes_per_second_ == 0 || now >= next_; }
  void begin(uint64_t bytes, Clock::time_point now) {
    if (bytes_per_second_ == 0) return;
    const std::chrono::duration<double> takes(static_cast<double>(bytes) / static_cast<double>(bytes_per_second_));
    next_ = std::max(next_, now - kBurst) + std::chrono::duration_cast<Clock::duration>(takes);
  }

 private:
  uint64_t bytes_per_second_;
  Clock::time_point next_;  // from when on something may begin
};

}  // namespace ff::stream
