// Tells how far a phase is, while it lasts.
#pragma once
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>

#include "bake/work_count.h"

namespace ff::bake {

// Called from a thread of the baker's own, at most ten times a second, never concurrently. What it throws is ignored.
using Progress = std::function<void(const char* phase, uint64_t done, uint64_t total)>;

// Reports a count from a thread of its own until it goes out of scope.
class ProgressReport {
 public:
  // stop: WorkCount's.
  ProgressReport(const Progress& progress, const char* phase, uint64_t total, const std::atomic<bool>* stop)
      : count(total, stop), progress_(progress), phase_(phase) {
    if (!progress_) return;
    say(0);
    thread_ = std::thread([this] {
      std::unique_lock lock(mutex_);
      while (!wake_.wait_for(lock, std::chrono::milliseconds(100), [this] { return over_; })) say(count.done());
    });
  }
  ~ProgressReport() {
    if (!thread_.joinable()) return;
    {
      const std::lock_guard lock(mutex_);
      over_ = true;
    }
    wake_.notify_one();
    thread_.join();
    say(std::uncaught_exceptions() > exceptions_ ? count.done() : count.total());
  }
  WorkCount count;

 private:
  // A terminal that is gone is no reason to end a bake.
  void say(uint64_t done) const noexcept {
    try {
      progress_(phase_, done, count.total());
    } catch (...) {
    }
  }

  const Progress& progress_;
  const char* const phase_;
  const int exceptions_ = std::uncaught_exceptions();
  std::mutex mutex_;
  std::condition_variable wake_;
  bool over_ = false;
  std::thread thread_;
};

}  // namespace ff::bake
