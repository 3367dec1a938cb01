// Light for tests of the dense solvers, and what it should come to.
#pragma once
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "tests/support/hand_made.h"

namespace ff::runtime {

inline std::vector<Vec4> randomSource(const LocalMatrix& matrix, uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto next = [&] { return static_cast<float>(random() >> 40) / 16777216.0f; };
  std::vector<Vec4> source(matrix.slots());
  for (const uint32_t s : matrix.leaves) source[s] = {next(), 10 * next(), next() < 0.5f ? 0.0f : next(), 0};
  return source;
}

// The gather solver run until nothing changes any more (albedos are at most 0.9, and 0.9^300 = 2e-14).
inline std::vector<Vec4> converged(const LocalMatrix& matrix, std::span<const Vec4> source) {
  const auto gather = makeCpuGather(1);
  std::vector<Vec4> out(matrix.slots());
  EXPECT_TRUE(setMatrix(*gather, matrix));
  EXPECT_TRUE(gather->setSource(source));
  EXPECT_TRUE(gather->iterate(300));
  EXPECT_TRUE(gather->radiosity(out));
  return out;
}

// Relative L2 over leaves and refined slots.
inline double differenceOf(const LocalMatrix& matrix, std::span<const Vec4> a, std::span<const Vec4> b) {
  double difference = 0, norm = 0;
  const auto add = [&](uint32_t s) {
    for (const auto channel : {&Vec4::x, &Vec4::y, &Vec4::z}) {
      const auto x = static_cast<double>(a[s].*channel), y = static_cast<double>(b[s].*channel);
      difference += (x - y) * (x - y);
      norm += y * y;
    }
  };
  for (const uint32_t s : matrix.leaves) add(s);
  for (const auto& refined : matrix.refined) add(refined.slot);
  EXPECT_GT(norm, 0);
  return std::sqrt(difference / norm);
}

}  // namespace ff::runtime
