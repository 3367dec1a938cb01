// The rate at which this machine's threads can read memory: what bandwidth fractions are fractions of.
#pragma once
#include <chrono>
#include <vector>

#include "runtime/solver/worker_pool.h"

namespace ff::chart {

// A buffer far larger than the caches, read by all threads of a pool.
class ReadBandwidth {
 public:
  explicit ReadBandwidth(runtime::WorkerPool& pool)
      : pool_(pool), buffer_(kParts * kPartVecs, Vec{1, 1, 1, 1}), sums_(kParts) {}

  // Bytes a second of one pass.
  double pass() {
    const auto start = std::chrono::steady_clock::now();
    pool_.run(kParts, [&](uint32_t part) {
      const Vec* v = buffer_.data() + part * kPartVecs;
      Vec sum[8] = {};
      for (size_t i = 0; i < kPartVecs; i += 8)
        for (size_t n = 0; n < 8; ++n) sum[n] += v[i + n];
      for (size_t n = 1; n < 8; ++n) sum[0] += sum[n];
      sums_[part] = sum[0][0];
    });
    const double s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    // The check keeps the sums from being optimised away.
    return sums_[0] > 0 ? static_cast<double>(buffer_.size() * sizeof(Vec)) / s : 0;
  }

 private:
  using Vec = float __attribute__((vector_size(16)));
  static constexpr uint32_t kParts = 64;
  static constexpr size_t kPartVecs = size_t{1} << 18;  // 4 MiB a part, 256 MiB in all
  runtime::WorkerPool& pool_;
  std::vector<Vec> buffer_;
  std::vector<float> sums_;
};

}  // namespace ff::chart
