// The pipeline between the streamer and its source: reads the most urgent tiles, a few at a time, and decodes them on
// its own threads. The owner is one thread, which must not be held up: its calls allocate and free nothing, start no
// reads, and share a lock with the loader's threads that only ever guards a swap of lists (and, on their side, the
// addition of one arrival).
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "formats/reader.h"
#include "stream/resident_strip.h"
#include "stream/tile_source.h"

namespace ff::stream {

// From stored bytes to a strip to keep. Errors: as World::decodeStrip and pack.
Result<StripPtr> decodeAndPack(const formats::World& world, formats::TileId id, std::span<const std::byte> stored);

class StripLoader {
 public:
  struct Arrival {
    formats::TileId id;
    StripPtr strip;             // null: reading or decoding failed
    uint64_t stored_bytes = 0;  // read, also of strips that failed to decode
  };
  struct Backlog {
    uint32_t queued = 0, under_way = 0, arrived = 0;
    bool idle() const { return queued + under_way + arrived == 0; }
  };

  // Throws std::system_error where no thread can be started. Memory that runs out later is a failure of the strip that it was for.
  // depth: strips being read or decoded at any time; at most 4 * depth more wait to be taken.
  // most_queued: tiles in a queue, at most. most_retired: strips that leave at once, at most.
  StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads, size_t most_queued,
              size_t most_retired);
  // Drops the queue, cancels the reads that are under way and waits for their answers.
  ~StripLoader();

  // The owner's calls.
  // The list to fill for submit(), the most urgent tile last. Empty after submit().
  std::vector<formats::TileId>& queue() { return next_queue_; }
  // Strips to be let go of. The loader's threads keep each until nobody else holds it and then free it, so that no
  // owner of a strip ever frees one. Empty after submit(), unless the loader is late: then they wait for the next.
  std::vector<StripPtr>& retired() { return next_retired_; }
  // Replaces what is still queued by queue(). Tiles under way, or arrived since the last take(), are left out.
  void submit();
  // Whether take() would bring something; no lock.
  bool anyArrived() const { return arrived_count_.load() != 0; }
  // What has arrived, for the caller to empty. Valid until the next call, which forgets what is left in it.
  std::vector<Arrival>& take();

  // From any thread.
  Backlog backlog() const;
  // Tiles that were dropped from the queue after the loader's threads had seen them there.
  uint64_t cancelled() const { return cancelled_.load(); }
  // The last strip that could not be read or decoded, as a line; empty: none yet. Allocates.
  std::string lastFailure() const;
  // Blocks until something has arrived or nothing is queued or under way.
  void awaitProgress() const;

 private:
  struct Stored {
    formats::TileId id;
    std::vector<std::byte> bytes;
  };
  void work();
  void pickUp();
  void freeRetired();  // with pipeline_mutex_ held
  void startReads();
  std::optional<formats::TileId> nextRead();
  std::optional<Stored> nextToDecode();
  void onRead(formats::TileId id, Result<std::vector<std::byte>> bytes);
  void decode(const Stored& stored);
  // Both with pipeline_mutex_ held; they need no memory.
  void arrive(formats::TileId id, StripPtr strip, uint64_t stored_bytes);
  void fail(formats::TileId id, const Error& error, uint64_t stored_bytes);
  void wake();
  void progress();

  const formats::World& world_;
  TileSource& source_;
  const size_t depth_;

  // The owner's.
  std::vector<formats::TileId> next_queue_;
  std::vector<StripPtr> next_retired_;
  std::vector<Arrival> taken_;
  uint32_t taken_count_ = 0;  // arrivals taken so far

  // What is handed over, in both directions.
  std::mutex hand_over_mutex_;
  std::vector<formats::TileId> submitted_;
  std::vector<StripPtr> submitted_retired_;
  std::vector<Arrival> arrived_;
  uint32_t submitted_taken_ = 0;  // taken_count_ when submitted_ was made
  uint32_t arrivals_ = 0;         // so far
  bool fresh_ = false;            // submitted_ has not been picked up

  // The loader's threads' and the source's; locked before hand_over_mutex_.
  mutable std::mutex pipeline_mutex_;
  std::condition_variable reads_done_;
  std::vector<formats::TileId> queue_, incoming_;  // the most urgent last
  uint32_t queue_taken_ = 0;
  std::vector<formats::TileId> under_way_;       // being read, waiting for a decoder or being decoded; depth_ at most
  std::vector<std::pair<uint32_t, formats::TileId>> since_taken_;  // arrivals after the queue_taken_-th, with their numbers from 1
  std::vector<formats::TileId> sorted_;          // of incoming_
  std::vector<StripPtr> retired_, incoming_retired_;
  std::deque<Stored> to_decode_;
  Error failure_;
  uint32_t reads_ = 0;  // callbacks still to come
  bool stop_ = false;
  std::atomic<bool> cancel_reads_{false};

  // A tile is counted by the next of these before the one before forgets it, so that reading them in this order misses
  // none.
  std::atomic<uint32_t> submitted_count_{0}, queued_count_{0}, under_way_count_{0}, arrived_count_{0};
  std::atomic<uint64_t> cancelled_{0};
  std::atomic<uint32_t> wake_{0}, progress_{0};  // change when there may be work, or something to see
  std::vector<std::thread> threads_;
};

}  // namespace ff::stream
