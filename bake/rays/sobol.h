// Four-dimensional Owen-scrambled Sobol points, seeded by an integer: a patch's rays depend on its name alone.
// Stephen Joe, Frances Kuo. Constructing Sobol sequences with better two-dimensional projections. 2008 (directions).
// Brent Burley. Practical hash-based Owen scrambling. Journal of Computer Graphics Techniques 9(4), 2020 (scrambling).
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/wide.h"

namespace ff::bake {

// Finaliser of MurmurHash3 over 64 bits: spreads patch numbers and seeds.
inline uint64_t mix64(uint64_t h) {
  h ^= h >> 33;
  h *= 0xff51afd7ed558ccdull;
  h ^= h >> 33;
  h *= 0xc4ceb9fe1a85ec53ull;
  h ^= h >> 33;
  return h;
}

// A number in [0, 1) of an integer.
inline double unitOf(uint64_t h) { return static_cast<double>(mix64(h) >> 11) * 0x1p-53; }

class SobolTable {
 public:
  explicit SobolTable(uint32_t count) {
    // Direction numbers of dimensions 1-4 (van der Corput; x+1; x^2+x+1; x^3+x+1), 32 bits each.
    static constexpr uint32_t kDegree[4] = {0, 1, 2, 3};
    static constexpr uint32_t kPoly[4] = {0, 0, 1, 1};
    static constexpr uint32_t kInit[4][3] = {{}, {1}, {1, 3}, {1, 3, 1}};
    std::array<std::array<uint32_t, 32>, 4> v{};
    for (uint32_t d = 0; d < 4; ++d) {
      const uint32_t s = kDegree[d];
      for (uint32_t k = 0; k < 32; ++k) {
        if (d == 0) {
          v[d][k] = 1u << (31 - k);
        } else if (k < s) {
          v[d][k] = kInit[d][k] << (31 - k);
        } else {
          v[d][k] = v[d][k - s] ^ (v[d][k - s] >> s);
          for (uint32_t j = 1; j < s; ++j) v[d][k] ^= ((kPoly[d] >> (s - 1 - j)) & 1u) * v[d][k - j];
        }
      }
    }
    for (uint32_t d = 0; d < 4; ++d) {
      reversed_[d].resize(count);
      for (uint32_t i = 0; i < count; ++i) {
        uint32_t x = 0;
        for (uint32_t k = 0; k < 32 && (i >> k); ++k) x ^= (i >> k & 1u) * v[d][k];
        reversed_[d][i] = reverse(x);
      }
    }
  }

  // Point i of the sequence scrambled by `seeds`, in [0, 1)^4.
  std::array<float, 4> point(uint32_t i, const std::array<uint32_t, 4>& seeds) const {
    std::array<float, 4> u;
    for (uint32_t d = 0; d < 4; ++d) u[d] = scrambled(reversed_[d][i], seeds[d]);
    return u;
  }
  // One dimension of the points from `first` on, as many as `u` holds.
  void points(uint32_t first, uint32_t dimension, const std::array<uint32_t, 4>& seeds, std::span<float> u) const {
    onWidest<ScrambleAll>(reversed_[dimension].data() + first, seeds[dimension], u.data(), u.size());
  }

  static std::array<uint32_t, 4> seeds(uint64_t seed, uint64_t patch) {
    const uint64_t a = mix64(seed * 0x9e3779b97f4a7c15ull + patch), b = mix64(a + 0x632be59bd9b4e019ull);
    return {static_cast<uint32_t>(a), static_cast<uint32_t>(a >> 32), static_cast<uint32_t>(b),
            static_cast<uint32_t>(b >> 32)};
  }

 private:
  [[gnu::always_inline]] static uint32_t reverse(uint32_t x) {
    x = __builtin_bswap32(x);
    x = (x & 0x0f0f0f0fu) << 4 | (x >> 4 & 0x0f0f0f0fu);
    x = (x & 0x33333333u) << 2 | (x >> 2 & 0x33333333u);
    return (x & 0x55555555u) << 1 | (x >> 1 & 0x55555555u);
  }
  [[gnu::always_inline]] static float scrambled(uint32_t x, uint32_t seed) {
    x += seed;  // Laine-Karras permutation: each bit depends only on lower bits of the reversed number
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return static_cast<float>(reverse(x) >> 8) * 0x1p-24f;
  }
  struct ScrambleAll {
    [[gnu::always_inline]] static void run(const uint32_t* reversed, uint32_t seed, float* u, size_t points) {
      for (size_t i = 0; i < points; ++i) u[i] = scrambled(reversed[i], seed);
    }
  };
  std::array<std::vector<uint32_t>, 4> reversed_;  // by dimension, then point; the bits reversed, ready for scrambling
};

}  // namespace ff::bake
