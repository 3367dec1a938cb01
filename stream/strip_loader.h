// The pipeline between the streamer and its source: reads the most urgent tiles, a few at a time, in one read those that lie beside each other, and decodes them on
// its own threads, which also read the index of chunks that are asked for, all of them at once. The owner is one thread, which must not be held up: its calls allocate and free nothing, start no
// reads, and share a lock with the loader's threads that only ever guards a swap of lists (and, on their side, the
// addition of one arrival).
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "formats/read/reader.h"
#include "stream/rate_limit.h"
#include "stream/resident_strip.h"
#include "stream/tile_source.h"

namespace ff::stream {

// From stored bytes to a strip to keep. Errors: as World::decodeStrip and pack.
Result<StripPtr> decodeAndPack(const formats::World& world, const formats::TileRef& tile, std::span<const std::byte> stored, const formats::ReadOptions& options = {});

// Reads a strip, too, and waits for it.
Result<StripPtr> readResident(const formats::World& world, const formats::TileRef& tile);

class StripLoader {
 public:
  struct Arrival {
    formats::TileId id;
    StripPtr strip;             // null: reading or decoding failed
    uint64_t stored_bytes = 0;  // of the strip, read, also where it failed to decode
  };
  struct ChunkArrival {
    formats::TileId id;
    formats::ChunkPtr chunk;    // null: reading failed
  };
  struct Backlog {
    uint32_t queued = 0, under_way = 0, arrived = 0;
    bool idle() const { return queued + under_way + arrived == 0; }
  };

  // Throws std::system_error where no thread can be started. Memory that runs out later is a failure of the strip that it was for.
  // depth: reads at any time. None begins while as many strips (SharedReads::strips_per_read times as many) are being read or decoded, or 2 * depth, 32 at most, wait to be taken.
  // max_queued: tiles in a queue, at most. max_retired: strips that leave at once, at most. limit: when strips may be read, at the time `now`.
  StripLoader(const formats::World& world, TileSource& source, int depth, int decode_threads, size_t max_queued,
              size_t max_retired, RateLimit limit = RateLimit(0), Now now = std::chrono::steady_clock::now);
  // Drops the queue, cancels the reads that are under way and waits for their answers.
  ~StripLoader();

  // The owner's calls.
  // The lists to fill for submit(), the most urgent last. Empty after submit().
  std::vector<formats::TileRef>& queue() { return next_.tiles; }
  std::vector<formats::ChildRef>& chunkQueue() { return next_.chunks; }
  // Strips and chunks to be let go of. The loader's threads keep each until nobody else holds it and then free it, so that no
  // owner ever frees one. Empty after submit(), unless the loader is late: then they wait for the next.
  std::vector<std::shared_ptr<const void>>& retired() { return next_retired_; }
  // Replaces what is still queued by queue() and chunkQueue(). What is under way, or arrived since the last take(), is left out.
  void submit();
  // Whether take() or takeChunks() would bring something; no lock.
  bool anyArrived() const { return arrived_count_.load() != 0 || arrived_chunk_count_.load() != 0; }
  // What has arrived, for the caller to empty. Valid until the next call, which forgets what is left in it.
  std::vector<Arrival>& take();
  std::vector<ChunkArrival>& takeChunks();

  // From any thread.
  Backlog backlog() const;
  // Tiles that were dropped from the queue after the loader's threads had seen them there.
  uint64_t cancelled() const { return cancelled_.load(); }
  // Reads that began later than they could have, since the limit did not let them.
  uint64_t readsHeld() const { return reads_held_.load(); }
  // Reads that have begun: of one strip, or of several that lie beside each other.
  uint64_t reads() const { return reads_begun_.load(); }
  // What they have brought that lies between strips.
  uint64_t gapBytes() const { return gap_bytes_.load(); }
  // What decoding has taken of its threads' time, ms.
  double decodeMs() const { return 1e-6 * static_cast<double>(decode_ns_.load()); }
  // Of strips that were read and not decoded yet, at most.
  uint64_t peakStoredBytes() const { return peak_stored_bytes_.load(); }
  // From the start of a strip's read to its arrival, s: longestOfLate().
  float latencySeconds() const { return latency_seconds_.load(); }
  // The last strip that could not be read or decoded, as a line; empty: none yet. Allocates.
  std::string lastFailure() const;
  // Blocks until something has arrived or nothing is queued or under way.
  void awaitProgress() const;

 private:
  // What is asked for, the most urgent last. `taken`: strips that its maker had taken when it was made.
  struct Queue {
    std::vector<formats::TileRef> tiles;
    std::vector<formats::ChildRef> chunks;
    uint32_t taken = 0;
    uint32_t size() const { return static_cast<uint32_t>(tiles.size() + chunks.size()); }
    void clear() { tiles.clear(), chunks.clear(); }
  };
  // A strip within what a read has brought.
  struct Stored {
    formats::TileRef tile;
    std::shared_ptr<const std::vector<std::byte>> read;
    std::span<const std::byte> bytes;  // of it
  };
  // One that begins: of the tile, and of what lies beside it.
  struct Read {
    uint32_t number = 0;  // among under_way_; not 0
    formats::TileId id;
    formats::Extent extent;
  };
  // What the strips of a read come to, of those that are under way.
  struct SharedRead {
    uint64_t from = ~uint64_t{0}, to = 0, strip_bytes = 0;
    size_t strips = 0;
  };
  void work();
  void pickUp();
  void freeRetired();  // with pipeline_mutex_ held
  void startReads();
  std::optional<Read> nextRead();
  // With pipeline_mutex_ held; they need no memory.
  std::optional<Read> nextAlone();
  std::optional<Read> nextQueued(Clock::time_point now);
  void addNeighbours(Read& read, Clock::time_point now);
  bool isOnItsWay(formats::TileId id) const;
  void begin(formats::TileRef tile, uint32_t read);
  uint32_t nextNumber();
  std::span<formats::ChildRef> nextChunks(std::span<formats::ChildRef> room);
  std::optional<Stored> nextToDecode();
  void onRead(uint32_t number, Result<std::vector<std::byte>> bytes);
  void readChunks(std::span<formats::ChildRef> requests);
  void readChunk(const formats::ChildRef& request);
  void decode(const Stored& stored);
  // All with pipeline_mutex_ held; they need no memory, or do without.
  void countQueued();
  SharedRead sharedRead(uint32_t number) const;
  void handOut(uint32_t number, const SharedRead& shared, std::vector<std::byte> bytes);
  void readAlone(uint32_t number);
  void arrive(formats::TileId id, StripPtr strip, uint64_t stored_bytes);
  void fail(formats::TileId id, const Error& error, uint64_t stored_bytes);
  void keepFailure(const Error& error);
  void wake();
  void progress();

  const formats::World& world_;
  TileSource& source_;
  const SharedReads shared_;
  const size_t depth_, max_waiting_, strips_at_once_;

  // The owner's.
  Queue next_;
  std::vector<std::shared_ptr<const void>> next_retired_;
  std::vector<Arrival> taken_;
  std::vector<ChunkArrival> taken_chunks_;
  uint32_t taken_count_ = 0;  // strips taken so far

  // What is handed over, in both directions.
  std::mutex hand_over_mutex_;
  Queue submitted_;
  std::vector<std::shared_ptr<const void>> submitted_retired_;
  std::vector<Arrival> arrived_;
  std::vector<ChunkArrival> arrived_chunks_;
  uint32_t arrivals_ = 0;         // of strips, so far
  bool fresh_ = false;            // submitted_ has not been picked up

  // The loader's threads' and the source's; locked before hand_over_mutex_.
  mutable std::mutex pipeline_mutex_;
  std::condition_variable reads_done_;
  Queue queue_, incoming_;
  struct UnderWay {
    formats::TileRef tile;
    std::chrono::steady_clock::time_point since;
    uint32_t read = 0;   // by which its bytes come; 0: they are here, or `alone`
    bool alone = false;  // the read that it shared has failed, so that it is to have one of its own
    formats::TileId id() const { return tile.id(); }
  };
  std::vector<UnderWay> under_way_;              // being read, waiting for a decoder or being decoded
  std::vector<formats::TileId> chunks_under_way_;
  std::vector<std::pair<uint32_t, formats::TileId>> since_taken_;  // arrivals after the queue_.taken-th, with their numbers from 1
  std::vector<formats::TileId> sorted_;          // of incoming_
  std::vector<std::shared_ptr<const void>> retired_, incoming_retired_;
  std::deque<Stored> to_decode_;
  uint64_t stored_bytes_ = 0;  // read and not decoded yet
  Error failure_;
  RateLimit limit_;
  const Now now_;
  bool held_ = false;   // the limit does not let the next read begin: a thread looks again soon
  uint32_t reads_ = 0;  // callbacks still to come
  uint32_t last_read_ = 0;
  bool stop_ = false;
  std::atomic<bool> cancel_reads_{false};

  // What is asked for is counted by the next of these before the one before forgets it, so that reading them in this order misses
  // none.
  std::atomic<uint32_t> submitted_count_{0}, queued_count_{0}, under_way_count_{0}, arrived_count_{0}, arrived_chunk_count_{0};
  std::atomic<uint64_t> cancelled_{0}, reads_held_{0}, reads_begun_{0}, gap_bytes_{0}, decode_ns_{0}, peak_stored_bytes_{0};
  std::atomic<float> latency_seconds_{0};
  std::atomic<uint32_t> wake_{0}, progress_{0};  // change when there may be work, or something to see
  std::vector<std::thread> threads_;
};

}  // namespace ff::stream
