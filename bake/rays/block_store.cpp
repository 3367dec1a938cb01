#include "bake/rays/block_store.h"

#include <algorithm>
#include <functional>
#include <new>
#include <thread>

#include "bake/spill.h"

namespace ff::bake {
namespace {

constexpr uint32_t kGroup = 16;              // blocks that are read together: 6 KiB
constexpr size_t kGroupBytes = kGroup * sizeof(Block);
constexpr uint32_t kShards = 16;
constexpr uint32_t kPinsACore = 4, kLeastPins = 64;  // readers at a time; a thread has two where it builds a tree on its way

void freeHeld(std::byte* at) { ::operator delete[](at, std::align_val_t(alignof(Block))); }

// For want of the right one.
const Block& noTriangles() {
  static const Block block = [] {
    Block b{};
    for (size_t i = 0; i < TriangleBlock::kTriangles; ++i) b.planes.clear(i);
    return b;
  }();
  return block;
}

}  // namespace

BlockStore::BlockStore(uint64_t cache_bytes) : file_(std::in_place), cache_bytes_(cache_bytes) {}

uint32_t BlockStore::add(std::vector<Block> blocks) {
  const uint32_t first = size_, added = static_cast<uint32_t>(blocks.size());
  if (file_) file_->append(std::as_bytes(std::span(blocks)));
  else if (first == 0) whole_ = std::move(blocks);
  else whole_.insert(whole_.end(), blocks.begin(), blocks.end());
  size_ += added;
  return first;
}

void BlockStore::finish() {
  if (!file_) return;
  const uint32_t groups = (size_ + kGroup - 1) / kGroup;
  const uint64_t wanted = std::min<uint64_t>(groups, cache_bytes_ / kGroupBytes);
  const uint32_t pins = std::max(kLeastPins, kPinsACore * std::thread::hardware_concurrency());
  const auto of_shard = static_cast<uint32_t>(std::max<uint64_t>(pins + 1, wanted / kShards));  // one is free, whatever readers hold
  slot_of_ = std::vector<std::atomic<uint32_t>>(groups);
  for (auto& slot : slot_of_) slot.store(kNothing, std::memory_order_relaxed);
  slots_ = std::vector<Slot>(size_t{kShards} * of_shard);
  shards_ = std::vector<Shard>(kShards);
  for (uint32_t s = 0; s < kShards; ++s) shards_[s].first_slot = s * of_shard, shards_[s].slots = of_shard;
  pins_ = std::vector<Pin>(pins);
  held_ = {static_cast<std::byte*>(::operator new[](slots_.size() * kGroupBytes, std::align_val_t(alignof(Block)))), freeHeld};
}

std::string BlockStore::error() const {
  const std::lock_guard lock(error_mutex_);
  return error_;
}

Block* BlockStore::blocksOf(uint32_t slot) const { return reinterpret_cast<Block*>(held_.get() + slot * kGroupBytes); }

std::atomic<uint32_t>& BlockStore::claim() const {
  for (size_t i = std::hash<std::thread::id>()(std::this_thread::get_id());; ++i) {
    std::atomic<uint32_t>& pin = pins_[i % pins_.size()].slot;
    uint32_t free = kFree;
    if (pin.load(std::memory_order_relaxed) == kFree && pin.compare_exchange_strong(free, kNothing)) return pin;
  }
}

// A slot is pinned first and looked at again then: whoever empties one forgets its group first and looks at pins then, so that one of both sees the other.
const Block& BlockStore::find(uint32_t number, std::atomic<uint32_t>& pinned) const {
  const uint32_t group = number / kGroup;
  for (uint32_t slot; (slot = slot_of_[group].load()) != kNothing;) {
    if (pinned.load(std::memory_order_relaxed) != slot) pinned.store(slot);
    if (slot_of_[group].load() != slot) continue;
    if (!slots_[slot].used.load(std::memory_order_relaxed)) slots_[slot].used.store(true, std::memory_order_relaxed);
    return blocksOf(slot)[number % kGroup];
  }
  return bring(group, pinned) ? blocksOf(pinned)[number % kGroup] : noTriangles();
}

bool BlockStore::bring(uint32_t group, std::atomic<uint32_t>& pinned) const {
  pinned.store(kNothing);
  Shard& shard = shards_[group % kShards];
  const std::lock_guard lock(shard.mutex);
  uint32_t slot = slot_of_[group];  // another thread may have brought it
  if (slot != kNothing) {
    pinned.store(slot);
    return true;
  }
  slot = emptySlot(shard);
  const uint32_t first = group * kGroup;
  try {
    file_->read(first * sizeof(Block), std::as_writable_bytes(std::span(blocksOf(slot), std::min(kGroup, size_ - first))));
  } catch (const SpillFailed& failed) {  // it may not go through Embree
    const std::lock_guard error(error_mutex_);
    error_ = failed.error.message;
    failed_ = true;
    return false;
  }
  slots_[slot].group = group;
  slots_[slot].used.store(true, std::memory_order_relaxed);
  pinned.store(slot);
  slot_of_[group].store(slot);
  return true;
}

// The next that was not used since the hand came by.
uint32_t BlockStore::emptySlot(Shard& shard) const {
  for (;; shard.hand = (shard.hand + 1) % shard.slots) {
    const uint32_t number = shard.first_slot + shard.hand;
    Slot& slot = slots_[number];
    if (slot.used.exchange(false, std::memory_order_relaxed)) continue;
    if (slot.group == kNothing) return number;
    slot_of_[slot.group].store(kNothing);
    if (!isPinned(number)) {
      slot.group = kNothing;
      return number;
    }
    slot_of_[slot.group].store(number);
  }
}

bool BlockStore::isPinned(uint32_t slot) const {
  return std::any_of(pins_.begin(), pins_.end(), [&](const Pin& pin) { return pin.slot.load() == slot; });
}

}  // namespace ff::bake
