// Where stored strips come from: a world's shards, memory, or a faulty twin for tests. Asynchronous: read() returns at
// once and the bytes arrive on another thread.
#pragma once
#include <cstddef>
#include <functional>
#include <vector>

#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::stream {

class TileSource {
 public:
  using Done = std::function<void(formats::TileId, Result<std::vector<std::byte>>)>;
  virtual ~TileSource() = default;
  // Calls `done` exactly once, from any thread but never from inside read(), and not at all where read() throws std::bad_alloc.
  // options: of formats/storage/storage.h; what waits behind other reads is answered when its turn comes.
  // extent: of the tile's strip.
  virtual void read(formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) = 0;
  virtual const char* name() const = 0;  // "io_uring", "threads", "memory"
};

}  // namespace ff::stream
