#include "runtime/frame_log.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <span>

#include "runtime/clock.h"

namespace ff::runtime {

FrameLog::FrameLog(uint32_t frames) : start_(Clock::now()), kept_(frames) {
  frames_.reserve(kept_);
  observers_.resize(kept_ * stream::kMaxObservers);
  scratch_.reserve(kept_);
}

void FrameLog::add(Clock::time_point began, double frame_ms, const FrameStats& frame, const stream::StreamStats& tiles, const stream::Observers& observers,
                   const std::array<double, 3>& origin) {
  if (kept_ == 0) return;
  const double rest_ms = std::max(frame_ms - frame.stream_ms - frame.matrix_ms, 0.0);
  const Frame now{std::chrono::duration<double, std::micro>(began - start_).count(), static_cast<float>(frame.stream_ms), static_cast<float>(frame.matrix_ms), static_cast<float>(rest_ms),
                  static_cast<float>(frame.solve_ms), tiles.wanted_tiles, tiles.late_tiles, tiles.pending_tiles, tiles.ahead_tiles, frame.matrix_changed,
                  tiles.resident_bytes, tiles.bytes_read, tiles.strips_read, tiles.reads, tiles.failed, frame.uploaded, origin, observers.size()};
  std::ranges::copy(observers, observers_.begin() + static_cast<ptrdiff_t>(next_ * stream::kMaxObservers));
  if (frames_.size() < kept_)
    frames_.push_back(now);
  else
    frames_[next_] = now;
  next_ = (next_ + 1) % kept_;
}

FrameLog::Times FrameLog::times() {
  if (frames_.empty()) return {};
  scratch_.clear();
  for (const Frame& frame : frames_) scratch_.push_back(frame.stream_ms + frame.matrix_ms + frame.rest_ms);
  const auto rank = [&](double share) { return static_cast<ptrdiff_t>(share * static_cast<double>(scratch_.size())); };
  const auto p50 = scratch_.begin() + rank(0.5), p99 = scratch_.begin() + rank(0.99);
  std::ranges::nth_element(scratch_, p99);
  std::ranges::nth_element(scratch_.begin(), p50, p99);  // the same one where there are few
  return {*p50, *p99, *std::max_element(p99, scratch_.end())};
}

std::string FrameLog::trace() const {
  using Json = nlohmann::ordered_json;
  Json events = Json::array();
  double at_us = 0;
  const auto bar = [&](const char* name, float ms) -> Json& {
    Json& event = events.emplace_back(Json{{"name", name}, {"ph", "X"}, {"ts", at_us}, {"dur", 1000 * static_cast<double>(ms)}, {"pid", 1}, {"tid", 1}});
    at_us += 1000 * static_cast<double>(ms);
    return event;
  };
  const auto counter = [&](const char* name, double began_us, Json values) { events.push_back({{"name", name}, {"ph", "C"}, {"ts", began_us}, {"pid", 1}, {"args", std::move(values)}}); };
  for (size_t k = 0; k < frames_.size(); ++k) {
    const size_t number = frames_.size() < kept_ ? k : (next_ + k) % kept_;
    const Frame& frame = frames_[number];
    Json observers = Json::array();
    for (const stream::Observer& o : std::span(observers_).subspan(number * stream::kMaxObservers, frame.observers)) {
      Json& list = observers.emplace_back(Json::array());
      for (int a = 0; a < 3; ++a) list.push_back(frame.origin[static_cast<size_t>(a)] + static_cast<double>(o.at[a]));
      for (int a = 0; a < 3; ++a) list.push_back(o.velocity[a]);
    }
    at_us = frame.began_us;
    bar("stream", frame.stream_ms)["args"] = {{"observers", std::move(observers)}};
    bar(frame.cut_changed ? "new cut, matrix and light" : "matrix and light", frame.matrix_ms);
    bar("rest", frame.rest_ms);
    bar("solver", frame.solve_ms);
    counter("tiles", frame.began_us, {{"wanted", frame.wanted}, {"late", frame.late}, {"ahead", frame.ahead}, {"pending", frame.pending}});
    counter("MB resident", frame.began_us, {{"strips", static_cast<double>(frame.resident_bytes) * 1e-6}});
    counter("MB read", frame.began_us, {{"strips", static_cast<double>(frame.bytes_read) * 1e-6}});
    counter("MB uploaded", frame.began_us, {{"rows", static_cast<double>(frame.uploaded.rows) * 1e-6}, {"light", static_cast<double>(frame.uploaded.light) * 1e-6}});
    counter("read", frame.began_us, {{"strips", frame.strips_read}, {"reads", frame.reads}});
    counter("failed", frame.began_us, {{"strips", frame.strips_failed}});
  }
  return Json{{"displayTimeUnit", "ms"}, {"traceEvents", std::move(events)}}.dump();
}

}  // namespace ff::runtime
