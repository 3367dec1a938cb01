#include "runtime/cut/range_allocator.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

namespace ff::runtime {
namespace {

TEST(RangeAllocator, KnowsItsLongestFreeRangeAndWhatARangeWouldLeave) {
  RangeAllocator ranges(100);
  EXPECT_EQ(ranges.longest(), 100u);
  for (const uint64_t size : {10, 20, 30, 40}) ASSERT_TRUE(ranges.allocate(size, 1));
  EXPECT_EQ(ranges.longest(), 0u);
  EXPECT_EQ(ranges.longWithout(30, 30), 30u);
  ranges.release(0, 10);
  ranges.release(60, 40);
  EXPECT_EQ(ranges.longest(), 40u);
  EXPECT_EQ(ranges.longWithout(10, 20), 30u);
  EXPECT_EQ(ranges.longWithout(30, 30), 70u);
}

TEST(RangeAllocator, GivesRangesThatNeverOverlapAndComeBackWhole) {
  constexpr uint64_t kSize = 4096;
  RangeAllocator ranges(kSize);
  std::vector<bool> used(kSize, false);
  struct Taken {
    uint64_t at, size;
  };
  std::vector<Taken> taken;
  std::mt19937 rng(7);
  int granted = 0, refused = 0;
  for (int step = 0; step < 20000; ++step) {
    if (!taken.empty() && rng() % 2 == 0) {
      const size_t i = rng() % taken.size();
      for (uint64_t b = taken[i].at; b < taken[i].at + taken[i].size; ++b) used[b] = false;
      ranges.release(taken[i].at, taken[i].size);
      taken[i] = taken.back();
      taken.pop_back();
      continue;
    }
    const uint64_t size = 1 + rng() % 300, alignment = uint64_t{1} << rng() % 8;
    const auto at = ranges.allocate(size, alignment);
    if (!at) {
      ++refused;
      // A refusal must be honest: no aligned free run of that size exists.
      for (uint64_t a = 0; a + size <= kSize; a += alignment) {
        bool all_free = true;
        for (uint64_t b = a; b < a + size && all_free; ++b) all_free = !used[b];
        ASSERT_FALSE(all_free) << "refused " << size << " at " << a;
      }
      continue;
    }
    ++granted;
    ASSERT_EQ(*at % alignment, 0u);
    ASSERT_LE(*at + size, kSize);
    for (uint64_t b = *at; b < *at + size; ++b) {
      ASSERT_FALSE(used[b]);
      used[b] = true;
    }
    taken.push_back({*at, size});
  }
  EXPECT_GT(granted, 1000);
  EXPECT_GT(refused, 10);
  for (const Taken& t : taken) ranges.release(t.at, t.size);
  EXPECT_TRUE(ranges.empty());
  EXPECT_EQ(ranges.allocate(kSize, 256), 0u);
}

TEST(RangeAllocator, TilesThatComeAndGoAlwaysFindRoomWhereAnEighthIsFree) {
  constexpr uint64_t kSlots = 65536, kMost = kSlots / 8 * 7;
  RangeAllocator ranges(kSlots);
  std::vector<std::pair<uint64_t, uint64_t>> taken;  // at, size
  std::mt19937 rng(3);
  uint64_t used = 0;
  for (int step = 0; step < 4000; ++step) {
    for (auto leaving = rng() % 12; leaving > 0 && !taken.empty(); --leaving) {
      std::swap(taken[rng() % taken.size()], taken.back());
      ranges.release(taken.back().first, taken.back().second);
      used -= taken.back().second;
      taken.pop_back();
    }
    for (uint64_t size; used + (size = 64 + rng() % 193) <= kMost; used += size) {
      const auto at = ranges.allocate(size, 1);
      ASSERT_TRUE(at) << size << " of " << kSlots - used << " free slots, step " << step;
      taken.emplace_back(*at, size);
    }
  }
}

}  // namespace
}  // namespace ff::runtime
