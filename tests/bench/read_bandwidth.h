// The rate at which this machine's threads can read memory: what bandwidth fractions are fractions of.
#pragma once
#include <algorithm>
#include <chrono>
#include <vector>

#include "runtime/worker_pool.h"

namespace ff::bench {

// The best of several passes over a buffer far larger than the caches, bytes a second.
inline double readBandwidth(runtime::WorkerPool& pool, int passes = 7) {
  using Vec = float __attribute__((vector_size(16)));
  constexpr uint32_t kParts = 64;
  constexpr size_t kPartVecs = size_t{1} << 18;  // 4 MiB a part, 256 MiB in all
  std::vector<Vec> buffer(kParts * kPartVecs, Vec{1, 1, 1, 1});
  std::vector<float> sums(kParts);
  double best = 0;
  for (int pass = 0; pass < passes; ++pass) {
    const auto start = std::chrono::steady_clock::now();
    pool.run(kParts, [&](uint32_t part) {
      const Vec* v = buffer.data() + part * kPartVecs;
      Vec sum[8] = {};
      for (size_t i = 0; i < kPartVecs; i += 8)
        for (size_t n = 0; n < 8; ++n) sum[n] += v[i + n];
      for (size_t n = 1; n < 8; ++n) sum[0] += sum[n];
      sums[part] = sum[0][0];
    });
    const double s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    // The check keeps the sums from being optimised away.
    if (sums[0] > 0) best = std::max(best, static_cast<double>(buffer.size() * sizeof(Vec)) / s);
  }
  return best;
}

}  // namespace ff::bench
