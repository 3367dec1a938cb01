// Patches in and out of a dense matrix, with the test failing where the matrix refuses.
#pragma once
#include <gtest/gtest.h>

#include "tools/chart/walks.h"

namespace ff::runtime {

using namespace walks;

inline std::vector<Vec4> relit(BounceMatrix& matrix, std::span<const Vec4> source) {
  std::vector<Vec4> irradiance(matrix.capacity(), Vec4{7, 7, 7, 0});
  const auto done = matrix.relight(source, irradiance);
  EXPECT_TRUE(done) << done.error().line();
  return irradiance;
}

inline void enter(BounceMatrix& matrix, Placement& at, std::span<const uint32_t> patches, uint32_t block) {
  for (size_t i = 0; i < patches.size(); i += block) {
    const auto done = matrix.insert(at.enter(patches.subspan(i, std::min<size_t>(block, patches.size() - i))));
    ASSERT_TRUE(done) << done.error().line();
  }
}

inline void leave(BounceMatrix& matrix, Placement& at, std::span<const uint32_t> patches) {
  const auto done = matrix.remove(at.leave(patches));
  ASSERT_TRUE(done) << done.error().line();
}

inline std::vector<uint32_t> upTo(uint32_t n) {
  std::vector<uint32_t> list(n);
  for (uint32_t i = 0; i < n; ++i) list[i] = i;
  return list;
}

}  // namespace ff::runtime
