// Sources for tests: a memory copy of a world's strips with an unhurried thread, and faults on demand.
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <random>
#include <thread>

#include "formats/read/reader.h"
#include "stream/tile_source.h"

namespace ff::stream {

// What becomes of the attempt-th read (0, 1, ...) of a tile.
enum class Fate { kGood, kReadError, kFlippedByte, kTruncated, kEmpty };
using FateOf = std::function<Fate(formats::TileId, int attempt)>;

// Holds the stored bytes of a world; answers from its own thread, in an order drawn at random.
class MemorySource final : public TileSource {
 public:
  // bytes: by tile. fate: null for always good; called on the thread of read().
  MemorySource(std::map<formats::TileId, std::vector<std::byte>> bytes, uint64_t seed = 1, FateOf fate = nullptr)
      : bytes_(std::move(bytes)), random_(seed), fate_(std::move(fate)), thread_([this] { work(); }) {}

  ~MemorySource() override {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    thread_.join();
  }

  void read(formats::TileId id, const formats::Extent&, const formats::ReadOptions&, Done done) override {
    const std::lock_guard lock(mutex_);
    const Fate fate = fate_ ? fate_(id, attempts_[id]) : Fate::kGood;
    ++attempts_[id];
    queue_.push_back({id, std::move(done), fate});
    max_waiting_ = std::max(max_waiting_, queue_.size());
    wake_.notify_one();
  }

  const char* name() const override { return "memory"; }
  // While held, nothing is answered. Release before destruction.
  void hold(bool held) {
    const std::lock_guard lock(mutex_);
    held_ = held;
    wake_.notify_all();
  }
  int attempts(formats::TileId id) {
    const std::lock_guard lock(mutex_);
    return attempts_[id];
  }
  size_t maxWaiting() {
    const std::lock_guard lock(mutex_);
    return max_waiting_;
  }

 private:
  struct Item {
    formats::TileId id;
    Done done;
    Fate fate = Fate::kGood;
  };

  void work() {
    for (;;) {
      Item item;
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [this] { return (!held_ && !queue_.empty()) || (stop_ && queue_.empty()); });
        if (queue_.empty()) return;
        std::swap(queue_[random_() % queue_.size()], queue_.back());
        item = std::move(queue_.back());
        queue_.pop_back();
      }
      std::vector<std::byte> bytes = bytes_.at(item.id);
      switch (item.fate) {
        case Fate::kGood:
          break;
        case Fate::kReadError:
          item.done(item.id, Error{ErrorCode::kIo, "memory", "", "made to fail", ""});
          continue;
        case Fate::kFlippedByte:
          bytes[bytes.size() / 2] ^= std::byte{0x10};
          break;
        case Fate::kTruncated:
          bytes.resize(bytes.size() / 2);
          break;
        case Fate::kEmpty:
          bytes.clear();
          break;
      }
      item.done(item.id, std::move(bytes));
    }
  }

  const std::map<formats::TileId, std::vector<std::byte>> bytes_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Item> queue_;
  std::map<formats::TileId, int> attempts_;
  std::mt19937_64 random_;
  FateOf fate_;
  size_t max_waiting_ = 0;
  bool stop_ = false, held_ = false;
  std::thread thread_;
};

}  // namespace ff::stream
