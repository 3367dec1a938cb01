// Sources for tests: a memory copy of a world's strips with an unhurried thread, and faults on demand.
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <limits>
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
  // Where strips lie, for those who let them share reads.
  struct Sharing {
    SharedReads allowed;
    std::map<formats::TileId, formats::Extent> extents;
  };
  // bytes: by tile. fate: null for always good; called on the thread of read().
  // Where strips share a read, an error, a truncated and an empty answer of one is that of all.
  MemorySource(std::map<formats::TileId, std::vector<std::byte>> bytes, uint64_t seed = 1, FateOf fate = nullptr, Sharing sharing = {})
      : bytes_(std::move(bytes)), sharing_(std::move(sharing)), random_(seed), fate_(std::move(fate)), thread_([this] { work(); }) {}

  ~MemorySource() override {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    thread_.join();
  }

  void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions&, Done done) override {
    const std::lock_guard lock(mutex_);
    Item item{id, std::move(done), {}, Fate::kGood};
    if (sharing_.extents.empty() || sharing_.extents.at(id) == extent) {
      item.fate = fateOf(id);
      item.bytes = spoilt(bytes_.at(id), item.fate);
    } else {
      share(extent, item);
    }
    queue_.push_back(std::move(item));
    max_waiting_ = std::max(max_waiting_, queue_.size());
    wake_.notify_one();
  }

  SharedReads sharedReads() const override { return sharing_.allowed; }
  int readsAtOnce() const override { return reads_at_once_; }
  void setReadsAtOnce(int reads) { reads_at_once_ = reads; }  // before it is used
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
  // Of several strips.
  uint64_t sharedReadsSeen() {
    const std::lock_guard lock(mutex_);
    return shared_;
  }
  uint32_t largestSharedRead() {
    const std::lock_guard lock(mutex_);
    return largest_;
  }
  size_t maxWaiting() {
    const std::lock_guard lock(mutex_);
    return max_waiting_;
  }

 private:
  int reads_at_once_ = std::numeric_limits<int>::max();
  struct Item {
    formats::TileId id;
    Done done;
    std::vector<std::byte> bytes;
    Fate fate = Fate::kGood;
  };

  Fate fateOf(formats::TileId id) {
    const int attempt = attempts_[id]++;
    return fate_ ? fate_(id, attempt) : Fate::kGood;
  }
  static std::vector<std::byte> spoilt(std::vector<std::byte> bytes, Fate fate) {
    if (fate == Fate::kFlippedByte) bytes[bytes.size() / 2] ^= std::byte{0x10};
    if (fate == Fate::kTruncated) bytes.resize(bytes.size() / 2);
    if (fate == Fate::kEmpty) bytes.clear();
    return bytes;
  }
  void share(const formats::Extent& extent, Item& item) {
    ++shared_;
    largest_ = std::max(largest_, extent.stored_bytes);
    item.bytes.assign(extent.stored_bytes, std::byte{0xee});
    for (const auto& [id, strip] : sharing_.extents) {
      if (strip.shard != extent.shard || strip.offset < extent.offset || strip.offset + strip.stored_bytes > extent.offset + extent.stored_bytes) continue;
      const Fate fate = fateOf(id);
      std::ranges::copy(fate == Fate::kFlippedByte ? spoilt(bytes_.at(id), fate) : bytes_.at(id), item.bytes.begin() + static_cast<std::ptrdiff_t>(strip.offset - extent.offset));
      if (fate != Fate::kGood && fate != Fate::kFlippedByte) item.fate = fate;
    }
    if (item.fate != Fate::kReadError) item.bytes = spoilt(std::move(item.bytes), item.fate);
  }

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
      if (item.fate == Fate::kReadError)
        item.done(item.id, Error{ErrorCode::kIo, "memory", "", "made to fail", ""});
      else
        item.done(item.id, std::move(item.bytes));
    }
  }

  const std::map<formats::TileId, std::vector<std::byte>> bytes_;
  const Sharing sharing_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Item> queue_;
  std::map<formats::TileId, int> attempts_;
  std::mt19937_64 random_;
  FateOf fate_;
  size_t max_waiting_ = 0;
  uint64_t shared_ = 0;
  uint32_t largest_ = 0;
  bool stop_ = false, held_ = false;
  std::thread thread_;
};

}  // namespace ff::stream
