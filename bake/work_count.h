// How far a phase of the bake is; and the way to end it early.
#pragma once
#include <atomic>
#include <cstdint>

namespace ff::bake {

// Thrown out of a phase that is asked to stop; caught by bakeWorld().
struct Stopped {};

// Thread-safe.
class WorkCount {
 public:
  // stop: once it is true, work ends at the next add(). Null: nobody asks for that.
  explicit WorkCount(uint64_t total = 0, const std::atomic<bool>* stop = nullptr) : total_(total), stop_(stop) {}
  void add(uint64_t more = 1) {
    done_.fetch_add(more, std::memory_order_relaxed);
    if (stop_ && stop_->load(std::memory_order_relaxed)) throw Stopped{};
  }
  // More work than was known at first.
  void expect(uint64_t more) { total_.fetch_add(more, std::memory_order_relaxed); }
  uint64_t done() const { return done_.load(std::memory_order_relaxed); }
  uint64_t total() const { return total_.load(std::memory_order_relaxed); }

 private:
  std::atomic<uint64_t> done_{0}, total_;
  const std::atomic<bool>* const stop_;
};

}  // namespace ff::bake
