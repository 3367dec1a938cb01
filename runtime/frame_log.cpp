#include "runtime/frame_log.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "runtime/clock.h"

namespace ff::runtime {

FrameLog::FrameLog(uint32_t frames) : start_(Clock::now()), kept_(frames) {
  frames_.reserve(kept_);
  scratch_.reserve(kept_);
}

void FrameLog::add(Clock::time_point began, const FrameStats& frame, const stream::StreamStats& tiles) {
  if (kept_ == 0) return;
  const Frame now{std::chrono::duration<double, std::micro>(began - start_).count(), static_cast<float>(frame.stream_ms), static_cast<float>(frame.matrix_ms),
                  static_cast<float>(frame.solve_ms), tiles.wanted_tiles, tiles.late_tiles, tiles.pending_tiles, tiles.ahead_tiles, frame.matrix_changed,
                  tiles.resident_bytes, tiles.bytes_read, tiles.failed};
  if (frames_.size() < kept_)
    frames_.push_back(now);
  else
    frames_[next_] = now;
  next_ = (next_ + 1) % kept_;
}

FrameLog::Times FrameLog::times() {
  if (frames_.empty()) return {};
  scratch_.clear();
  for (const Frame& frame : frames_) scratch_.push_back(frame.stream_ms + frame.matrix_ms);
  std::ranges::sort(scratch_);
  const auto at = [&](double share) { return static_cast<double>(scratch_[std::min(scratch_.size() - 1, static_cast<size_t>(share * static_cast<double>(scratch_.size())))]); };
  return {at(0.5), at(0.99), static_cast<double>(scratch_.back())};
}

std::string FrameLog::trace() const {
  using Json = nlohmann::ordered_json;
  Json events = Json::array();
  const auto bar = [&](const char* name, double at_us, float ms) {
    events.push_back({{"name", name}, {"ph", "X"}, {"ts", at_us}, {"dur", 1000 * static_cast<double>(ms)}, {"pid", 1}, {"tid", 1}});
  };
  const auto counter = [&](const char* name, double at_us, Json values) { events.push_back({{"name", name}, {"ph", "C"}, {"ts", at_us}, {"pid", 1}, {"args", std::move(values)}}); };
  for (size_t k = 0; k < frames_.size(); ++k) {
    const Frame& frame = frames_[frames_.size() < kept_ ? k : (next_ + k) % kept_];
    double at = frame.began_us;
    for (const auto& [name, ms] : {std::pair{"stream", frame.stream_ms}, {frame.cut_changed ? "new cut, matrix and light" : "matrix and light", frame.matrix_ms}, {"solver", frame.solve_ms}}) {
      bar(name, at, ms);
      at += 1000 * static_cast<double>(ms);
    }
    counter("tiles", frame.began_us, {{"wanted", frame.wanted}, {"late", frame.late}, {"ahead", frame.ahead}, {"pending", frame.pending}});
    counter("MB resident", frame.began_us, {{"strips", static_cast<double>(frame.resident_bytes) * 1e-6}});
    counter("MB read", frame.began_us, {{"strips", static_cast<double>(frame.bytes_read) * 1e-6}});
    counter("failed", frame.began_us, {{"strips", frame.strips_failed}});
  }
  return Json{{"displayTimeUnit", "ms"}, {"traceEvents", std::move(events)}}.dump();
}

}  // namespace ff::runtime
