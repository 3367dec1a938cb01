#include "runtime/solver/worker_pool.h"

#include <algorithm>
#include <system_error>

namespace ff::runtime {
namespace {

// About 10 us: longer than the gap between two passes of an iteration, much shorter than a frame.
constexpr int kSpins = 2000;

void pause() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#endif
}

// Returns once `value` differs from `old`.
void awaitChange(const std::atomic<uint32_t>& value, uint32_t old) {
  for (int i = 0; i < kSpins; ++i) {
    if (value.load(std::memory_order_acquire) != old) return;
    pause();
  }
  while (value.load(std::memory_order_acquire) == old) value.wait(old, std::memory_order_acquire);
}

}  // namespace

WorkerPool::WorkerPool(int threads) {
  const int wanted = threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  workers_.reserve(static_cast<size_t>(wanted));
  try {
    for (int i = 1; i < wanted; ++i) workers_.emplace_back([this] { work(); });
  } catch (const std::system_error&) {  // those that there are and the caller's own will do
  }
}

WorkerPool::~WorkerPool() {
  stop_ = true;
  generation_.fetch_add(1, std::memory_order_release);
  generation_.notify_all();
  for (std::thread& worker : workers_) worker.join();
}

void WorkerPool::runErased(uint32_t parts, Call call, void* task) {
  if (workers_.empty() || parts <= 1) {
    for (uint32_t part = 0; part < parts; ++part) call(task, part);
    return;
  }
  call_ = call;
  task_ = task;
  parts_ = parts;
  next_part_.store(0, std::memory_order_relaxed);
  busy_.store(static_cast<uint32_t>(workers_.size()), std::memory_order_relaxed);
  generation_.fetch_add(1, std::memory_order_release);
  generation_.notify_all();
  takeParts();
  // Every worker reports, also those that found nothing left: none may still look at this task when the next one is
  // set.
  for (uint32_t busy; (busy = busy_.load(std::memory_order_acquire)) != 0;) awaitChange(busy_, busy);
}

void WorkerPool::takeParts() {
  for (uint32_t part; (part = next_part_.fetch_add(1, std::memory_order_relaxed)) < parts_;) call_(task_, part);
}

void WorkerPool::work() {
  for (uint32_t seen = 0;;) {
    awaitChange(generation_, seen);
    ++seen;
    if (stop_) return;
    takeParts();
    if (busy_.fetch_sub(1, std::memory_order_acq_rel) == 1) busy_.notify_one();
  }
}

}  // namespace ff::runtime
