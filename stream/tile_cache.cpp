#include "stream/tile_cache.h"

#include <algorithm>
#include <numeric>

namespace ff::stream {

TileCache::TileCache(uint64_t memory_bytes, uint64_t kept_bytes, size_t max_tiles)
    : memory_bytes_(memory_bytes), kept_bytes_(kept_bytes), items_(max_tiles), free_(max_tiles) {
  std::iota(free_.rbegin(), free_.rend(), 0u);
  places_.reserve(max_tiles);
}

void TileCache::insert(StripPtr strip, bool wanted, std::vector<std::shared_ptr<const void>>& leaving) {
  const uint64_t bytes = residentBytes(*strip);
  const auto isFull = [&] { return bytes_ + bytes > memory_bytes_ || free_.empty(); };
  if (places_.contains(strip->id) || (!wanted && (isFull() || unwanted_bytes_ + bytes > kept_bytes_))) {
    leaving.push_back(std::move(strip));
    return;
  }
  while (isFull() && oldest_ != kNone) evictOldest(leaving);
  const uint32_t place = free_.back();
  free_.pop_back();
  places_[strip->id] = place;
  Item& item = items_[place];
  item.strip = std::move(strip);
  item.bytes = bytes;
  item.wanted = wanted;
  if (!wanted) enqueue(place);
  bytes_ += bytes;
  peak_bytes_ = std::max(peak_bytes_, bytes_);
}

void TileCache::evictOldest(std::vector<std::shared_ptr<const void>>& leaving) {
  Item& oldest = items_[oldest_];
  places_.erase(oldest.strip->id);
  free_.push_back(oldest_);
  dequeue(oldest_);
  bytes_ -= oldest.bytes;
  ++evicted_;
  leaving.push_back(std::move(oldest.strip));
  oldest.strip = nullptr;
}

void TileCache::setWanted(formats::TileId id, bool wanted) {
  const auto at = places_.find(id);
  if (at == places_.end() || items_[at->second].wanted == wanted) return;
  items_[at->second].wanted = wanted;
  if (wanted)
    dequeue(at->second);
  else
    enqueue(at->second);
}

void TileCache::enqueue(uint32_t place) {
  items_[place].before = newest_;
  items_[place].after = kNone;
  (newest_ == kNone ? oldest_ : items_[newest_].after) = place;
  newest_ = place;
  unwanted_bytes_ += items_[place].bytes;
}

void TileCache::dequeue(uint32_t place) {
  const Item& item = items_[place];
  (item.before == kNone ? oldest_ : items_[item.before].after) = item.after;
  (item.after == kNone ? newest_ : items_[item.after].before) = item.before;
  unwanted_bytes_ -= item.bytes;
}

}  // namespace ff::stream
