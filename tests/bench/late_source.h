// A source whose reads all take some time longer: a slow disk, a network.
#pragma once
#include <chrono>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <thread>

#include "stream/tile_source.h"

namespace ff::bench {

class LateSource final : public stream::TileSource {
 public:
  LateSource(std::unique_ptr<TileSource> below, std::chrono::microseconds delay) : below_(std::move(below)), delay_(delay), thread_([this] { work(); }) {}
  ~LateSource() override {
    below_.reset();  // answers what is in flight
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_one();
    thread_.join();
  }
  void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    const auto due = Clock::now() + delay_;
    below_->read(id, extent, options, [this, due, done = std::move(done)](formats::TileId of, Result<std::vector<std::byte>> bytes) mutable {
      {
        const std::lock_guard lock(mutex_);
        waiting_.push_back({due, of, std::move(bytes), std::move(done)});
      }
      wake_.notify_one();
    });
  }
  stream::SharedReads sharedReads() const override { return below_->sharedReads(); }
  int readsAtOnce() const override { return below_->readsAtOnce(); }
  const char* name() const override { return "late"; }

 private:
  using Clock = std::chrono::steady_clock;
  struct Item {
    Clock::time_point due;
    formats::TileId id;
    Result<std::vector<std::byte>> bytes;
    Done done;
  };
  void work() {
    std::unique_lock lock(mutex_);
    for (;;) {
      wake_.wait(lock, [this] { return stop_ || !waiting_.empty(); });
      if (waiting_.empty()) return;
      Item item = std::move(waiting_.front());
      waiting_.pop_front();
      lock.unlock();
      std::this_thread::sleep_until(item.due);
      item.done(item.id, std::move(item.bytes));
      lock.lock();
    }
  }
  std::unique_ptr<TileSource> below_;
  const std::chrono::microseconds delay_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Item> waiting_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace ff::bench
