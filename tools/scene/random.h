// Random numbers that are the same on every machine and need no order: a hash of the seed and of what is being decided.
// Steele, Lea, Flood. Fast Splittable Pseudorandom Number Generators. 2014. (SplitMix64)
#pragma once
#include <cstdint>

namespace ff::tools {

inline uint64_t mix(uint64_t x) {
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

inline uint64_t hash(uint64_t seed, int64_t a, int64_t b, int64_t c = 0) {
  return mix(mix(mix(mix(seed) ^ static_cast<uint64_t>(a)) ^ static_cast<uint64_t>(b)) ^ static_cast<uint64_t>(c));
}

class Random {
 public:
  explicit Random(uint64_t seed) : state_(seed) {}
  uint64_t next() { return mix(state_++); }
  // 0 .. n-1, n > 0. The bias of the remainder is below n / 2^64.
  int below(int n) { return static_cast<int>(next() % static_cast<uint64_t>(n)); }
  int between(int lo, int hi) { return lo + below(hi - lo + 1); }  // both ends included
  bool chance(int percent) { return below(100) < percent; }

 private:
  uint64_t state_;
};

}  // namespace ff::tools
