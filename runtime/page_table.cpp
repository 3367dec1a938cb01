#include "runtime/page_table.h"

namespace ff::runtime {

PageTable::PageTable(const formats::World& world, std::span<const SlotRange> tiles, uint32_t outside)
    : world_(world), outside_(outside) {
  size_t size = 1024;
  while (size < 4 * tiles.size()) size *= 2;
  buckets_.resize(size);
  pages_.reserve(2 * tiles.size() + 256);
  for (const SlotRange& range : tiles) {
    Page& page = pages_.emplace_back();
    for (uint32_t i = 0; i < range.nodes; ++i) page[i] = static_cast<uint16_t>(range.first_slot + i);
    insert(keyOf(range.id), active_pages_++);
  }
}

size_t PageTable::find(uint64_t key) const {
  const size_t mask = buckets_.size() - 1;
  // Fibonacci hashing spreads neighbouring tiles. Knuth. The Art of Computer Programming 3, 6.4. 1973.
  size_t at = static_cast<size_t>((key * 0x9e3779b97f4a7c15ull) >> 32) & mask;
  while (buckets_[at].key != 0 && buckets_[at].key != key) at = (at + 1) & mask;
  return at;
}

void PageTable::insert(uint64_t key, uint32_t page) {
  if (2 * (used_ + 1) > buckets_.size()) {
    std::vector<Bucket> old(buckets_.size() * 2);
    old.swap(buckets_);
    for (const Bucket& bucket : old)
      if (bucket.key != 0) buckets_[find(bucket.key)] = bucket;
  }
  buckets_[find(key)] = {key, page};
  ++used_;
}

bool PageTable::isActive(formats::TileId id) const {
  const Bucket& bucket = buckets_[find(keyOf(id))];
  return bucket.key != 0 && bucket.page < active_pages_;
}

uint32_t PageTable::pageOf(formats::TileId id) {
  const Bucket& bucket = buckets_[find(keyOf(id))];
  return bucket.key != 0 ? bucket.page : addPage(id);
}

uint32_t PageTable::addPage(formats::TileId id) {
  Page page{};
  if (outside_ != kNoSlot)
    page.fill(static_cast<uint16_t>(outside_));
  else
    fillFromAncestors(id, page);
  const uint32_t number = static_cast<uint32_t>(pages_.size());
  pages_.push_back(page);
  insert(keyOf(id), number);
  return number;
}

void PageTable::fillFromAncestors(formats::TileId id, Page& page) {
  const uint32_t above = id.level + 1;
  if (above >= world_.levels().size()) {
    incomplete_ = true;
    return;
  }
  const formats::TileInfo& info = world_.tiles(id.level)[id.tile];
  // Parents of consecutive nodes never descend, so the page of the parents' tile changes a few times at most.
  uint32_t tile_first = 0, tile_end = 0, number = 0;
  for (uint32_t i = 0; i < info.nodes; ++i) {
    const uint32_t parent = world_.parent(id.level, info.first_node + i);
    if (parent < tile_first || parent >= tile_end) {
      const uint32_t tile = world_.tileOf(above, parent);
      const formats::TileInfo& parents = world_.tiles(above)[tile];
      tile_first = parents.first_node;
      tile_end = tile_first + parents.nodes;
      number = pageOf({above, tile});  // one step of a recursion as deep as the pyramid
    }
    page[i] = pages_[number][parent - tile_first];
  }
}

}  // namespace ff::runtime
