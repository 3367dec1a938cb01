// The last frames of a world: what they took, how its tiles stood, and where its observers were.
#pragma once
#include <array>
#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "runtime/updater.h"
#include "stream/observers.h"
#include "stream/streamer.h"

namespace ff::runtime {

// One thread. Only the constructor and trace() take memory.
class FrameLog {
 public:
  // frames: kept; 0: none.
  explicit FrameLog(uint32_t frames);
  // A frame that began then took so long but for the solver's steps. origin: of the observers' positions, m.
  void add(std::chrono::steady_clock::time_point began, double frame_ms, const FrameStats& frame, const stream::StreamStats& tiles, const stream::Observers& observers,
           const std::array<double, 3>& origin);

  // Of the frames kept, what the frame's thread took but for the solver's steps, ms: half of them at most, 99 of a hundred, the worst. 0: no frame yet.
  struct Times {
    double p50_ms = 0, p99_ms = 0, max_ms = 0;
  };
  Times times();
  // The frames kept, in the format of Chrome's and Perfetto's trace viewers: a bar each for streaming (with "observers": x, y, z in the scene's world space, m,
  // and velocity, m/s, of each), matrix and light, the rest of the frame, and the solver, and counters. ffinspect trace flies that path again.
  std::string trace() const;

 private:
  struct Frame {
    double began_us;  // since the start
    float stream_ms, matrix_ms, rest_ms, solve_ms;
    uint32_t wanted, late, pending, ahead, cut_changed;
    uint64_t resident_bytes, bytes_read, strips_read, reads, strips_failed;
    UploadedBytes uploaded;
    std::array<double, 3> origin;
    size_t observers;
  };
  const std::chrono::steady_clock::time_point start_;
  std::vector<Frame> frames_;  // a ring
  std::vector<stream::Observer> observers_;  // kMaxObservers a frame
  size_t kept_, next_ = 0;
  std::vector<float> scratch_;
};

}  // namespace ff::runtime
