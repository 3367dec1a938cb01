// XXH3-64 (Collet. xxHash, 2020) as FORMAT.md uses it.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>

namespace ff::formats {

uint64_t hashBytes(std::span<const std::byte> bytes);

// Hash of a stored strip without its checksum field: of header bytes 0..55 followed by the payload's hash.
// stored.size() >= kStripHeaderBytes.
uint64_t hashStripContent(std::span<const std::byte> stored);

// What the checksum field holds: the content's hash mixed with the strip's identity and place, so that a strip that was
// swapped with another, or copied to another offset or shard, does not pass.
struct StripPlace {
  uint32_t kind = 0;   // 0 rows, 1 geometry
  uint32_t level = 0;
  uint32_t tile = 0;
  uint32_t shard = 0;  // index in the manifest's shard table
  uint64_t offset = 0;
};
uint64_t mixStripChecksum(uint64_t content_hash, const StripPlace& place);

}  // namespace ff::formats
