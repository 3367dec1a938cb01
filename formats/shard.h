// Opening a shard: header, footer and index, all checked against the file's size and the manifest's record.
#pragma once
#include <span>
#include <string>
#include <vector>

#include "formats/model.h"
#include "formats/records.h"
#include "formats/result.h"
#include "formats/storage.h"

namespace ff::formats {

struct ShardEntry {
  TileInfo info;          // of geometry: entries = triangles
  uint64_t checksum = 0;  // as in the strip's header
};

struct OpenShard {
  std::unique_ptr<StoredFile> file;
  std::vector<ShardEntry> entries;  // in the order of the file
};

// number: index in the manifest's shard table.
Result<OpenShard> openShard(Storage& storage, const std::string& path, const ShardRecord& record, uint32_t number);

// Header and checksum of a geometry strip.
Result<StripHeader> readGeometryHeader(const ShardEntry& entry, std::span<const std::byte> stored);
// "geometry 0:17 at offset 4096"
std::string geometryPlace(const ShardEntry& entry);

}  // namespace ff::formats
