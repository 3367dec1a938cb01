// Keeps on the disk, or where there is no folder in memory, what was read of a storage that is slow to read: of files whose names tell their content (shards), in pieces of kCachePiece
// bytes, each with a checksum on the disk. A piece that is missing or damaged is read from below, once however many threads want it, and kept; so what is read below is
// at most what is wanted and a piece at either end. What is named by StoredFile::bring()
// is read in as many requests at once as there are pieces, within limits; what is expected whole, 4 MiB ahead. All other files (manifests, settings) are read from below each time. Such a file that is in the cache is
// opened without asking below. One file of the cache for each that is kept: a header with its name and size, then its pieces, each
// at its place behind its checksum; holes where there is none yet. Any number of processes may use a folder: they write the same bytes to the same place,
// and what is half written is damaged. Past the limit the files that were opened longest ago are emptied. What cannot be written (no folder, a full disk) turns the
// folder off; warning() says so, and pieces are kept in memory from then on.
#pragma once
#include "formats/storage/storage.h"

namespace ff::formats {

inline constexpr uint64_t kCachePiece = 64 << 10;

struct CacheSettings {
  std::string folder;  // made where it is absent; empty: pieces are kept in memory
  uint64_t limit_bytes = uint64_t{4} << 30;   // of the folder
  uint64_t memory_bytes = uint64_t{16} << 20;  // of pieces in memory, of all files together; those that were read longest ago go first
  std::string warning{};  // of cacheSettings(): for Storage::warning()
};

// By the environment: FORMFIELD_CACHE, a folder or "off"; else formfield in XDG_CACHE_HOME, else in ~/.cache. FORMFIELD_CACHE_LIMIT: MiB.
CacheSettings cacheSettings();

// Read only. Its files outlive it.
StoragePtr cachedStorage(StoragePtr below, const CacheSettings& settings);

}  // namespace ff::formats
