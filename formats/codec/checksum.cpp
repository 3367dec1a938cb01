#include "formats/codec/checksum.h"

#include <xxhash.h>

namespace ff::formats {

uint64_t hashBytes(std::span<const std::byte> bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

}  // namespace ff::formats
