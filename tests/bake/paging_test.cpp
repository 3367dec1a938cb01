#include "bake/paging.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <thread>

#include "bake/memory.h"
#include "bake/rays/sobol.h"
#include "bake/spill.h"
#include "tests/support/random_world.h"

namespace ff::bake::test {
namespace {

constexpr size_t kNumbers = size_t{8} << 20;  // 64 MB

PagedVector<uint64_t> numbers() {
  PagedVector<uint64_t> made(kNumbers);
  for (size_t i = 0; i < made.size(); ++i) made[i] = mix64(i);
  return made;
}

void expectNumbers(const PagedVector<uint64_t>& made) {
  ASSERT_EQ(made.size(), kNumbers);
  for (size_t i = 0; i < made.size(); ++i) ASSERT_EQ(made[i], mix64(i)) << i;
}

TEST(Paging, ArraysAreInMemoryWithoutItOrWhileThereIsRoom) {
  expectNumbers(numbers());
  const Paging paging(".", uint64_t{64} << 30);
  const auto made = numbers();
  EXPECT_EQ(pagedBytes().now, 0u);
  expectNumbers(made);
}

TEST(Paging, WhatMemoryHasNoRoomForIsAFileWithoutAName) {
  const formats::TemporaryFolder folder;
  PagedVector<uint64_t> kept;
  {
    const uint64_t before = residentMemory().all;
    const Paging paging(folder.path(), before + (uint64_t{24} << 20));
    kept = numbers();
    const auto other = numbers();
    EXPECT_EQ(pagedBytes().now, 2 * kNumbers * sizeof(uint64_t));
    EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
    // What is held comes down although 128 MB were touched; how soon is the system's affair.
    for (int tries = 0; tries < 2000 && residentMemory().all > before + (uint64_t{24} << 20); ++tries) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    EXPECT_LE(residentMemory().all, before + (uint64_t{24} << 20));
    expectNumbers(kept);
    expectNumbers(other);
    const PagedVector<uint64_t> copy = kept, moved = std::move(kept);
    expectNumbers(copy);
    kept = copy;
    expectNumbers(moved);
  }
  EXPECT_EQ(pagedBytes().now, kNumbers * sizeof(uint64_t));
  expectNumbers(kept);  // after the last limit has gone as well
  release(kept);
  EXPECT_EQ(pagedBytes().now, 0u);
}

TEST(Paging, GrowsFromManyThreads) {
  const formats::TemporaryFolder folder;
  const Paging paging(folder.path(), 1);
  std::vector<std::thread> threads;
  std::vector<PagedVector<uint64_t>> made(4);
  for (auto& own : made)
    threads.emplace_back([&own] {
      for (size_t i = 0; i < kNumbers / 8; ++i) own.push_back(mix64(i));
    });
  for (std::thread& t : threads) t.join();
  for (const auto& own : made)
    for (size_t i = 0; i < own.size(); ++i) ASSERT_EQ(own[i], mix64(i));
}

TEST(Paging, SaysWhereThereIsNoRoom) {
  const Paging paging("/nowhere/at/all", 1);
  try {
    const auto made = numbers();
    FAIL();
  } catch (const SpillFailed& failed) {
    EXPECT_EQ(failed.error.code, ErrorCode::kIo);
    EXPECT_NE(failed.error.line().find("/nowhere/at/all"), std::string::npos) << failed.error.line();
    EXPECT_NE(failed.error.line().find("or give more --memory"), std::string::npos) << failed.error.line();
  }
}

}  // namespace
}  // namespace ff::bake::test
