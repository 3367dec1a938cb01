// The pipeline between the streamer and its source: reads the most urgent tiles, a few at a time, and decodes them on
// its own threads. The owner (one thread) sets the queue and takes what has arrived; both only ever wait for a swap of
// lists.
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <thread>
#include <vector>

#include "formats/reader.h"
#include "stream/tile_source.h"

namespace ff::stream {

class StripLoader {
 public:
  struct Arrival {
    formats::TileId id;
    std::shared_ptr<const formats::Strip> strip;  // null: reading or decoding failed
    uint64_t stored_bytes = 0;                    // read, also of strips that failed to decode
    Error error;                                  // where it failed
  };
  struct Backlog {
    uint32_t queued = 0, under_way = 0, arrived = 0;
    bool idle() const { return queued + under_way + arrived == 0; }
  };

  // depth: strips being read or decoded at any time; at most 4 * depth more wait to be taken.
  StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads);
  // Drops the queue and waits for the reads that are under way.
  ~StripLoader();

  // Replaces what is still queued, the most urgent tile first. Tiles under way or arrived are left out by the loader.
  // Returns how many tiles queued before are no longer.
  uint32_t setQueue(std::vector<formats::TileId> urgent_first);
  // Whether take() would bring something; no lock.
  bool anyArrived() const { return arrived_count_.load(std::memory_order_acquire) != 0; }
  // Appends what has arrived to `out`.
  void take(std::vector<Arrival>& out);
  Backlog backlog() const;
  // Blocks until something has arrived or nothing is queued or under way.
  void awaitProgress();

 private:
  struct Stored {
    formats::TileId id;
    std::vector<std::byte> bytes;
  };
  void startReads();
  void onRead(formats::TileId id, Result<std::vector<std::byte>> bytes);
  void decode();
  void arrive(Arrival arrival);  // with mutex_ held

  const formats::World& world_;
  TileSource& source_;
  const size_t depth_;
  mutable std::mutex mutex_;
  std::condition_variable to_decode_changed_, progress_;
  std::vector<formats::TileId> queue_;   // the most urgent last
  std::set<formats::TileId> under_way_;  // being read, waiting for a decoder or being decoded
  std::deque<Stored> to_decode_;
  std::vector<Arrival> arrived_;
  std::atomic<uint32_t> arrived_count_{0};
  uint32_t reads_ = 0;  // callbacks still to come
  bool stop_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace ff::stream
