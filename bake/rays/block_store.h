// All blocks of a scene's triangles with their corners. Where memory has no room for them they are in a file, and a cache holds those that rays meet, a few
// neighbours at a time: rays meet many blocks here and there, for each of which a page of an array (paging.h) would bring far more.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bake/paging.h"
#include "bake/rays/triangle_block.h"

namespace ff::bake {

struct alignas(64) Block {
  TriangleBlock planes;
  std::array<Corners, TriangleBlock::kTriangles> corners;  // m
};

class BlockStore {
 public:
  // Whole in memory.
  BlockStore() = default;
  // In a file (UnnamedFile), of which about so many bytes are held.
  explicit BlockStore(uint64_t cache_bytes);
  BlockStore(const BlockStore&) = delete;
  BlockStore& operator=(const BlockStore&) = delete;

  // Returns the number of the first. Throws SpillFailed.
  uint32_t add(std::vector<Block> blocks);
  // After the last add(), before the first Reader.
  void finish();
  uint32_t size() const { return size_; }

  // What went wrong when a block was read, which then was one of no triangles; empty: nothing.
  bool failed() const { return failed_.load(std::memory_order_relaxed); }
  std::string error() const;

  // Of one thread.
  class Reader {
   public:
    explicit Reader(const BlockStore& store) : store_(store), pinned_(store.file_ ? &store.claim() : nullptr) {}
    ~Reader() {
      if (pinned_) pinned_->store(kFree, std::memory_order_release);
    }
    Reader(const Reader&) = delete;
    Reader& operator=(const Reader&) = delete;

    // Stays until the next is asked for.
    const Block& operator[](uint32_t number) const { return pinned_ ? store_.find(number, *pinned_) : store_.whole_[number]; }

   private:
    const BlockStore& store_;
    std::atomic<uint32_t>* const pinned_;
  };

 private:
  // What a reader is at: a slot of the cache, which stays as long as a pin says so; or one of these.
  static constexpr uint32_t kFree = ~uint32_t{0}, kNothing = kFree - 1;
  struct alignas(64) Pin {
    std::atomic<uint32_t> slot{kFree};
  };
  // A part of the cache: groups of blocks by number, slots in turn.
  struct Shard {
    std::mutex mutex;
    uint32_t first_slot = 0, slots = 0, hand = 0;
  };
  struct Slot {
    uint32_t group = kNothing;
    std::atomic<bool> used{false};  // since the hand came by
  };

  std::atomic<uint32_t>& claim() const;
  const Block& find(uint32_t number, std::atomic<uint32_t>& pinned) const;
  bool bring(uint32_t group, std::atomic<uint32_t>& pinned) const;
  uint32_t emptySlot(Shard& shard) const;
  bool isPinned(uint32_t slot) const;
  Block* blocksOf(uint32_t slot) const;

  uint32_t size_ = 0;
  std::vector<Block> whole_;
  std::optional<UnnamedFile> file_;
  uint64_t cache_bytes_ = 0;

  mutable std::vector<std::atomic<uint32_t>> slot_of_;  // by group; kNothing: not held
  mutable std::vector<Slot> slots_;
  mutable std::vector<Shard> shards_;
  mutable std::vector<Pin> pins_;
  std::unique_ptr<std::byte[], void (*)(std::byte*)> held_{nullptr, nullptr};  // blocks, by slot

  mutable std::atomic<bool> failed_{false};
  mutable std::mutex error_mutex_;
  mutable std::string error_;
};

}  // namespace ff::bake
