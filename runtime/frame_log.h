// The last frames of a world: what they took, and how its tiles stood.
#pragma once
#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "runtime/updater.h"
#include "stream/streamer.h"

namespace ff::runtime {

// One thread. Only the constructor and trace() take memory.
class FrameLog {
 public:
  // frames: kept; 0: none.
  explicit FrameLog(uint32_t frames);
  // A frame that began then has just ended.
  void add(std::chrono::steady_clock::time_point began, const FrameStats& frame, const stream::StreamStats& tiles);

  // Of the frames kept, what the frame's thread took but for the solver's steps, ms: half of them at most, 99 of a hundred, the worst. 0: no frame yet.
  struct Times {
    double p50_ms = 0, p99_ms = 0, max_ms = 0;
  };
  Times times();
  // The frames kept, in the format of Chrome's and Perfetto's trace viewers: a bar each for streaming, matrix and light, and the solver, and counters.
  std::string trace() const;

 private:
  struct Frame {
    double began_us;  // since the start
    float stream_ms, matrix_ms, solve_ms;
    uint32_t wanted, late, pending, ahead, cut_changed;
    uint64_t resident_bytes, bytes_read, strips_failed;
  };
  const std::chrono::steady_clock::time_point start_;
  std::vector<Frame> frames_;  // a ring
  size_t kept_, next_ = 0;
  std::vector<float> scratch_;
};

}  // namespace ff::runtime
