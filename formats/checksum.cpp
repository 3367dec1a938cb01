#include "formats/checksum.h"

#include <xxhash.h>

#include <algorithm>
#include <array>

#include "formats/bytes.h"
#include "formats/records.h"

namespace ff::formats {

uint64_t hashBytes(std::span<const std::byte> bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

uint64_t hashStripContent(std::span<const std::byte> stored) {
  std::array<std::byte, kStripChecksumOffset + 8> b{};
  std::copy_n(stored.begin(), kStripChecksumOffset, b.begin());
  storeLittle(b.data() + kStripChecksumOffset, hashBytes(stored.subspan(kStripHeaderBytes)));
  return hashBytes(b);
}

uint64_t mixStripChecksum(uint64_t content_hash, const StripPlace& place) {
  std::array<std::byte, 32> b{};
  storeLittle(b.data(), content_hash);
  storeLittle(b.data() + 8, place.kind);
  storeLittle(b.data() + 12, place.level);
  storeLittle(b.data() + 16, place.tile);
  storeLittle(b.data() + 20, place.shard);
  storeLittle(b.data() + 24, place.offset);
  return hashBytes(b);
}

}  // namespace ff::formats
