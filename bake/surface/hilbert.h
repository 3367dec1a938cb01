// Position along a 3-D Hilbert curve. Of a cell's 63-bit key, the first 3 k bits are the key of the cell k levels below
// the root: coarser cells are prefixes, so sorting by key keeps every 2^n cube of cells together.
// John Skilling. Programming the Hilbert curve. AIP Conference Proceedings 707, 2004.
#pragma once
#include <array>
#include <cstdint>

namespace ff::bake {

inline constexpr int kHilbertBits = 21;
inline constexpr int32_t kCellBias = 1 << (kHilbertBits - 1);  // cells -2^20 .. 2^20 - 1 on each axis

using Cell = std::array<int32_t, 3>;

inline uint64_t hilbertKey(const Cell& cell) {
  std::array<uint32_t, 3> x;
  for (int a = 0; a < 3; ++a) x[a] = static_cast<uint32_t>(cell[a] + kCellBias);
  for (uint32_t q = 1u << (kHilbertBits - 1); q > 1; q >>= 1) {  // undo excess work, then Gray encode
    const uint32_t p = q - 1;
    for (int a = 0; a < 3; ++a) {
      if (x[a] & q) {
        x[0] ^= p;
      } else {
        const uint32_t t = (x[0] ^ x[a]) & p;
        x[0] ^= t;
        x[a] ^= t;
      }
    }
  }
  for (int a = 1; a < 3; ++a) x[a] ^= x[a - 1];
  uint32_t t = 0;
  for (uint32_t q = 1u << (kHilbertBits - 1); q > 1; q >>= 1)
    if (x[2] & q) t ^= q - 1;
  for (uint32_t& v : x) v ^= t;
  uint64_t key = 0;
  for (int b = kHilbertBits - 1; b >= 0; --b)
    for (int a = 0; a < 3; ++a) key = key << 1 | (x[a] >> b & 1);
  return key;
}

// Key of the ancestor cell whose edge is 2^level cells.
inline uint64_t hilbertAncestor(uint64_t key, int level) { return key >> (3 * level); }

}  // namespace ff::bake
