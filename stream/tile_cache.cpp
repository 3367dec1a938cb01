#include "stream/tile_cache.h"

#include <algorithm>

#include "stream/wanted_tiles.h"

namespace ff::stream {

TileCache::TileCache(const formats::World& world, uint64_t memory_bytes)
    : numbers_(world), memory_bytes_(memory_bytes), items_(numbers_.tiles()) {}

void TileCache::insert(StripPtr strip, bool wanted, std::vector<StripPtr>& leaving) {
  const uint32_t number = numbers_.of(strip->id);
  const uint64_t bytes = residentBytes(*strip);
  if (items_[number].strip || (!wanted && bytes_ + bytes > memory_bytes_)) {
    leaving.push_back(std::move(strip));
    return;
  }
  while (bytes_ + bytes > memory_bytes_ && oldest_ != kNone) {
    Item& oldest = items_[oldest_];
    dequeue(oldest_);
    bytes_ -= oldest.bytes;
    --tiles_;
    ++evicted_;
    leaving.push_back(std::move(oldest.strip));
    oldest.strip = nullptr;
  }
  Item& item = items_[number];
  item.strip = std::move(strip);
  item.bytes = bytes;
  item.wanted = wanted;
  if (!wanted) enqueue(number);
  ++tiles_;
  bytes_ += bytes;
  peak_bytes_ = std::max(peak_bytes_, bytes_);
}

void TileCache::setWanted(formats::TileId id, bool wanted) {
  const uint32_t number = numbers_.of(id);
  Item& item = items_[number];
  if (!item.strip || item.wanted == wanted) return;
  item.wanted = wanted;
  if (wanted)
    dequeue(number);
  else
    enqueue(number);
}

void TileCache::enqueue(uint32_t number) {
  items_[number].before = newest_;
  items_[number].after = kNone;
  (newest_ == kNone ? oldest_ : items_[newest_].after) = number;
  newest_ = number;
}

void TileCache::dequeue(uint32_t number) {
  const Item& item = items_[number];
  (item.before == kNone ? oldest_ : items_[item.before].after) = item.after;
  (item.after == kNone ? newest_ : items_[item.after].before) = item.before;
}

}  // namespace ff::stream
