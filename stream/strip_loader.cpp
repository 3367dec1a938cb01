#include "stream/strip_loader.h"

#include <algorithm>
#include <optional>

namespace ff::stream {

using formats::TileId;

StripLoader::StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads)
    : world_(world), source_(source), depth_(static_cast<size_t>(std::max(depth, 1))) {
  for (int i = 0; i < std::max(decode_threads, 1); ++i) threads_.emplace_back([this] { decode(); });
}

StripLoader::~StripLoader() {
  {
    std::unique_lock lock(mutex_);
    stop_ = true;
    queue_.clear();
    progress_.wait(lock, [this] { return reads_ == 0; });
  }
  to_decode_changed_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

uint32_t StripLoader::setQueue(std::vector<TileId> urgent_first) {
  std::reverse(urgent_first.begin(), urgent_first.end());
  uint32_t dropped = 0;
  {
    const std::lock_guard lock(mutex_);
    std::erase_if(urgent_first, [this](TileId id) {
      return under_way_.count(id) != 0 ||
             std::any_of(arrived_.begin(), arrived_.end(), [id](const Arrival& a) { return a.id == id; });
    });
    queue_.swap(urgent_first);
    const std::set<TileId> kept(queue_.begin(), queue_.end());
    for (const TileId id : urgent_first)
      if (kept.count(id) == 0) ++dropped;
  }
  startReads();
  return dropped;
}

void StripLoader::take(std::vector<Arrival>& out) {
  {
    const std::lock_guard lock(mutex_);
    for (Arrival& arrival : arrived_) out.push_back(std::move(arrival));
    arrived_.clear();
    arrived_count_.store(0, std::memory_order_release);
  }
  startReads();
}

StripLoader::Backlog StripLoader::backlog() const {
  const std::lock_guard lock(mutex_);
  return {static_cast<uint32_t>(queue_.size()), static_cast<uint32_t>(under_way_.size()),
          static_cast<uint32_t>(arrived_.size())};
}

void StripLoader::awaitProgress() {
  std::unique_lock lock(mutex_);
  progress_.wait(lock, [this] { return !arrived_.empty() || (queue_.empty() && under_way_.empty()); });
}

void StripLoader::startReads() {
  for (;;) {
    TileId id;
    {
      const std::lock_guard lock(mutex_);
      if (queue_.empty() || under_way_.size() >= depth_ || arrived_.size() >= 4 * depth_) return;
      id = queue_.back();
      queue_.pop_back();
      under_way_.insert(id);
      ++reads_;
    }
    source_.read(id, [this](TileId done, Result<std::vector<std::byte>> bytes) { onRead(done, std::move(bytes)); });
  }
}

void StripLoader::onRead(TileId id, Result<std::vector<std::byte>> bytes) {
  const std::lock_guard lock(mutex_);
  if (bytes && !stop_) {
    to_decode_.push_back({id, std::move(*bytes)});
    to_decode_changed_.notify_one();
  } else {
    arrive({id, nullptr, 0, bytes ? Error{} : bytes.error()});
    // A decoder starts the next read: this thread belongs to the source.
    to_decode_changed_.notify_one();
  }
  // Last, and under the lock: the destructor returns as soon as it sees no read.
  --reads_;
  progress_.notify_all();
}

void StripLoader::arrive(Arrival arrival) {
  under_way_.erase(arrival.id);
  arrived_.push_back(std::move(arrival));
  arrived_count_.store(static_cast<uint32_t>(arrived_.size()), std::memory_order_release);
  progress_.notify_all();
}

void StripLoader::decode() {
  for (;;) {
    std::optional<Stored> stored;
    {
      std::unique_lock lock(mutex_);
      to_decode_changed_.wait(lock, [this] {
        return stop_ || !to_decode_.empty() ||
               (!queue_.empty() && under_way_.size() < depth_ && arrived_.size() < 4 * depth_);
      });
      if (stop_) return;
      if (!to_decode_.empty()) {
        stored = std::move(to_decode_.front());
        to_decode_.pop_front();
      }
    }
    if (stored) {
      auto strip = std::make_shared<formats::Strip>();
      const Result<void> decoded = world_.decodeStrip(stored->id, stored->bytes, *strip);
      Arrival arrival{stored->id, nullptr, stored->bytes.size(), decoded ? Error{} : decoded.error()};
      if (decoded) arrival.strip = std::move(strip);
      const std::lock_guard lock(mutex_);
      arrive(std::move(arrival));
    }
    startReads();
  }
}

}  // namespace ff::stream
