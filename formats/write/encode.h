// The stored bytes of a manifest and of a chunk's record. Pure, thread-safe.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/result.h"

namespace ff::formats {

// A section of the manifest: kSectionInfo, ..., and its records.
struct SectionBytes {
  uint32_t kind = 0;
  std::vector<std::byte> bytes;
};
// Header, table of sections and sections, in the order given.
std::vector<std::byte> encodeManifest(std::span<const SectionBytes> sections);

// raw: of encodeChunk. Errors: no memory.
Result<std::vector<std::byte>> compressChunk(std::span<const std::byte> raw);

}  // namespace ff::formats
