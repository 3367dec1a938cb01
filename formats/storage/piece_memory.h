// Pieces of files in memory, within a limit: those that were read longest ago go first.
#pragma once
#include <compare>
#include <cstddef>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

namespace ff::formats {

// Thread-safe. Where memory runs out, nothing is kept.
class PieceMemory {
 public:
  struct Key {
    uint64_t file = 0, piece = 0;  // file: what its pieces are known by
    friend auto operator<=>(const Key&, const Key&) = default;
  };
  using Bytes = std::shared_ptr<const std::vector<std::byte>>;

  explicit PieceMemory(uint64_t limit_bytes) : limit_bytes_(limit_bytes) {}

  // Null: it is not here.
  Bytes find(const Key& key) {
    const std::lock_guard lock(mutex_);
    const auto at = pieces_.find(key);
    if (at == pieces_.end()) return nullptr;
    recent_.splice(recent_.begin(), recent_, at->second.place);
    return at->second.bytes;
  }
  void keep(const Key& key, std::span<const std::byte> bytes) try {
    auto copy = std::make_shared<const std::vector<std::byte>>(bytes.begin(), bytes.end());
    const std::lock_guard lock(mutex_);
    drop(pieces_.find(key));
    recent_.push_front(key);
    try {
      pieces_[key] = {std::move(copy), recent_.begin()};
    } catch (const std::bad_alloc&) {
      recent_.pop_front();
      return;
    }
    bytes_ += bytes.size();
    while (bytes_ > limit_bytes_) drop(pieces_.find(recent_.back()));
  } catch (const std::bad_alloc&) {
  }
  // Those from `first` on, before `end`.
  void forget(const Key& first, const Key& end) {
    const std::lock_guard lock(mutex_);
    for (auto at = pieces_.lower_bound(first); at != pieces_.end() && at->first < end;) at = drop(at);
  }
  uint64_t bytes() const {
    const std::lock_guard lock(mutex_);
    return bytes_;
  }

 private:
  struct Kept {
    Bytes bytes;
    std::list<Key>::iterator place;
  };
  using Pieces = std::map<Key, Kept>;
  Pieces::iterator drop(Pieces::iterator at) {
    if (at == pieces_.end()) return at;
    bytes_ -= at->second.bytes->size();
    recent_.erase(at->second.place);
    return pieces_.erase(at);
  }

  const uint64_t limit_bytes_;
  mutable std::mutex mutex_;
  std::list<Key> recent_;  // the last read first
  Pieces pieces_;
  uint64_t bytes_ = 0;
};

}  // namespace ff::formats
