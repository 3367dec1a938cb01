// XXH3-64 (Collet. xxHash, 2020) as FORMAT.md uses it.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>

namespace ff::formats {

uint64_t hashBytes(std::span<const std::byte> bytes);

}  // namespace ff::formats
