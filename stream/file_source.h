// Reads stored strips from a world's shards. Two implementations behind one interface: io_uring, and a few threads that read
// through the world's storage, for kernels and containers that refuse io_uring and for storage that is not files.
#pragma once
#include <memory>

#include "formats/read/reader.h"
#include "stream/tile_source.h"

namespace ff::stream {

// What shares a read where worlds lie on a disk: a page of the kernel's between two strips.
inline constexpr SharedReads kLocalReads{.gap_bytes = 4 << 10, .max_bytes = 64 << 10};

// Each lives on the files of `world`, which must outlive it. Destruction waits for what is in flight.

// io_uring if this kernel lets us, else threads.
std::unique_ptr<TileSource> makeFileSource(const formats::World& world);
// kIo where the kernel refuses io_uring or its read operation, or the world's files have no descriptors.
Result<std::unique_ptr<TileSource>> makeUringSource(const formats::World& world);
std::unique_ptr<TileSource> makeThreadSource(const formats::World& world, int threads = 4, SharedReads shared = kLocalReads);

}  // namespace ff::stream
