// Where stored strips come from: a world's shards, memory, or a faulty twin for tests. Asynchronous: read() returns at
// once and the bytes arrive on another thread.
#pragma once
#include <cstddef>
#include <functional>
#include <limits>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::stream {

// Which strips may share a read: those that lie in one shard with little between them.
struct SharedReads {
  uint32_t gap_bytes = 0;        // between two strips, at most: reading these, too, costs less than another read
  uint32_t max_bytes = 0;        // of a read of several strips; 0: each strip has a read of its own
  uint32_t strips_per_read = 1;  // so many times as many strips as reads may be under way when a read begins
};

class TileSource {
 public:
  using Done = std::function<void(formats::TileId, Result<std::vector<std::byte>>)>;
  virtual ~TileSource() = default;
  // Calls `done` exactly once, from any thread but never from inside read(), and not at all where read() throws std::bad_alloc.
  // options: of formats/storage/storage.h; what waits behind other reads is answered when its turn comes.
  // extent: of the tile's strip, or one that holds the strips of several tiles, as sharedReads() allows; `done` then gets the tile that was given here.
  virtual void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) = 0;
  virtual SharedReads sharedReads() const { return {}; }  // always the same
  // More wait in it, in the order in which they came. Always the same.
  virtual int readsAtOnce() const { return std::numeric_limits<int>::max(); }
  virtual const char* name() const = 0;  // "io_uring", "threads", "memory"
};

}  // namespace ff::stream
