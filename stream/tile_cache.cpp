#include "stream/tile_cache.h"

#include <algorithm>

#include "stream/wanted_tiles.h"

namespace ff::stream {

bool TileCache::insert(StripPtr strip, bool wanted) {
  const uint64_t key = keyOf(strip->id), bytes = decodedBytes(*strip);
  if (items_.count(key) != 0 || (!wanted && bytes_ + bytes > memory_bytes_)) return false;
  while (bytes_ + bytes > memory_bytes_ && !unwanted_.empty()) {
    const auto oldest = items_.find(unwanted_.front());
    bytes_ -= oldest->second.bytes;
    items_.erase(oldest);
    unwanted_.pop_front();
    ++evicted_;
  }
  Item item{std::move(strip), bytes, wanted, {}};
  if (!wanted) item.queued = unwanted_.insert(unwanted_.end(), key);
  items_.emplace(key, std::move(item));
  bytes_ += bytes;
  peak_bytes_ = std::max(peak_bytes_, bytes_);
  return true;
}

TileCache::StripPtr TileCache::find(formats::TileId id) const {
  const auto found = items_.find(keyOf(id));
  return found == items_.end() ? nullptr : found->second.strip;
}

void TileCache::setWanted(formats::TileId id, bool wanted) {
  const auto found = items_.find(keyOf(id));
  if (found == items_.end() || found->second.wanted == wanted) return;
  found->second.wanted = wanted;
  if (wanted)
    unwanted_.erase(found->second.queued);
  else
    found->second.queued = unwanted_.insert(unwanted_.end(), found->first);
}

}  // namespace ff::stream
