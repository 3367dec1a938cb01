// What the bake cache keeps, and what it does where it cannot.
#include "bake/plan/cache.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <filesystem>
#include <string>

#include "tests/formats/faulty_storage.h"
#include "tests/support/random_world.h"

namespace ff::bake {
namespace {

std::vector<std::byte> some(size_t size, int value) { return std::vector<std::byte>(size, std::byte(value)); }

std::unique_ptr<BakeCache> open(const std::string& folder, uint64_t limit = 1 << 20, formats::StoragePtr storage = formats::posixStorage()) {
  auto cache = BakeCache::open(folder, limit, std::move(storage));
  EXPECT_TRUE(cache) << cache.error().line();
  return std::move(*cache);
}

TEST(BakeCache, HoldsWhatWasStored) {
  const formats::TemporaryFolder folder;
  const auto cache = open(folder.file("a/b"));
  EXPECT_FALSE(cache->load("rays", {1, 2}));
  cache->store("rays", {1, 2}, some(10, 7));
  cache->store("rays", {1, 3}, {});
  EXPECT_EQ(cache->load("rays", {1, 2}), some(10, 7));
  EXPECT_EQ(cache->load("rays", {1, 3}), some(0, 0));
  EXPECT_FALSE(cache->load("rows", {1, 2}));
  cache->store("rays", {1, 2}, some(5, 8));
  EXPECT_EQ(open(folder.file("a/b"))->load("rays", {1, 2}), some(5, 8));
  EXPECT_EQ(open(folder.file("a/b"))->bytes(), cache->bytes());
  // A file under another's name is not the other.
  std::filesystem::path from, to;
  for (const auto& f : std::filesystem::directory_iterator(folder.file("a/b"))) (f.path().string().ends_with("2.ffu") ? from : to) = f.path();
  std::filesystem::copy_file(from, to, std::filesystem::copy_options::overwrite_existing);
  EXPECT_FALSE(cache->load("rays", {1, 3}));
}

TEST(BakeCache, WithoutALimitHoldsWhatWasStoredLast) {
  const formats::TemporaryFolder folder;
  const auto cache = open(folder.file("c"), ~uint64_t{0});
  cache->store("rays", {1, 2}, some(10, 7));
  cache->store("rays", {1, 2}, some(5, 8));
  EXPECT_EQ(cache->load("rays", {1, 2}), some(5, 8));
  EXPECT_TRUE(cache->warnings().empty());
}

TEST(BakeCache, IsLookedIntoWithoutATrace) {
  const formats::TemporaryFolder folder;
  auto absent = BakeCache::peek(folder.file("c"));
  ASSERT_TRUE(absent);
  EXPECT_EQ((*absent)->bytes(), 0u);
  EXPECT_FALSE((*absent)->load("rays", {1, 2}));
  EXPECT_FALSE(std::filesystem::exists(folder.file("c")));
  const auto cache = open(folder.file("c"));
  cache->store("rays", {1, 2}, some(10, 7));
  auto there = BakeCache::peek(folder.file("c"));
  ASSERT_TRUE(there);
  EXPECT_EQ((*there)->bytes(), cache->bytes());
  EXPECT_EQ((*there)->load("rays", {1, 2}), some(10, 7));
}

TEST(BakeCache, KeepsToItsLimitAndLeavesWhatThisBakeUses) {
  const formats::TemporaryFolder folder;
  for (uint64_t k = 0; k < 10; ++k) open(folder.file("c"))->store("rays", {0, k}, some(1000, 1));
  const auto cache = open(folder.file("c"), 5500);
  EXPECT_TRUE(cache->load("rays", {0, 0}));
  cache->store("rays", {0, 99}, some(1000, 1));
  EXPECT_LE(cache->bytes(), 5500u);
  EXPECT_TRUE(cache->load("rays", {0, 0}));
  EXPECT_TRUE(cache->load("rays", {0, 99}));
  EXPECT_TRUE(cache->warnings().empty());
  cache->store("rays", {0, 100}, some(5000, 1));  // does not fit beside them
  EXPECT_FALSE(cache->load("rays", {0, 100}));
  ASSERT_EQ(cache->warnings().size(), 1u);
  EXPECT_NE(cache->warnings()[0].find("--cache-limit"), std::string::npos);
}

TEST(BakeCache, OnAFullDiskWarnsOnceAndLeavesNoHalves) {
  const formats::TemporaryFolder folder;
  for (uint64_t fail_at = 1; fail_at < 5; ++fail_at) {
    const auto disk = std::make_shared<formats::FaultyStorage>(formats::posixStorage());
    const auto cache = open(folder.file(std::to_string(fail_at)), 1 << 20, disk);
    disk->fail_at = disk->calls + fail_at - 1;
    disk->for_ever = fail_at % 2 == 0;
    cache->store("rays", {0, 1}, some(1000, 1));
    cache->store("rays", {0, 2}, some(1000, 1));
    EXPECT_EQ(cache->warnings().size(), 1u) << fail_at;
    disk->fail_at = ~uint64_t{0};
    disk->for_ever = false;
    const auto again = open(folder.file(std::to_string(fail_at)));
    size_t halves = 0;
    for (const auto& f : std::filesystem::directory_iterator(folder.file(std::to_string(fail_at)))) halves += f.path().extension() == ".tmp" && !disk->for_ever;
    EXPECT_LE(halves, 1u);  // of a writer that is alive: this one, where not even removing went well
    EXPECT_FALSE(again->load("rays", {0, 1}));
  }
}

TEST(BakeCache, RemovesItsOwnFilesAndNoOthers) {
  const formats::TemporaryFolder folder;
  open(folder.file("c"))->store("rays", {0, 1}, some(1000, 1));
  // Half-written: by a process that is gone; by one that is not; by some process of another machine, now and long ago.
  std::array<char, 256> host{};
  ASSERT_EQ(gethostname(host.data(), host.size() - 1), 0);
  const std::string gone = folder.file("c/rays-1.ffu.999999999-0@") + host.data() + ".tmp",
                    alive = folder.file("c/rays-2.ffu.") + std::to_string(getpid()) + "-0@" + host.data() + ".tmp",
                    elsewhere = folder.file("c/rays-3.ffu.999999999-0@elsewhere.tmp"), long_ago = folder.file("c/rays-4.ffu.999999999-0@elsewhere.tmp");
  for (const std::string& half : {gone, alive, elsewhere, long_ago}) formats::writeFile(half, some(3, 1));
  std::filesystem::last_write_time(long_ago, std::filesystem::file_time_type::clock::now() - std::chrono::hours(48));
  formats::writeFile(folder.file("c/mine.txt"), some(3, 1));
  open(folder.file("c"));
  EXPECT_FALSE(std::filesystem::exists(gone));
  EXPECT_FALSE(std::filesystem::exists(long_ago));
  EXPECT_TRUE(std::filesystem::exists(alive));
  EXPECT_TRUE(std::filesystem::exists(elsewhere));
  const auto removed = BakeCache::clean(folder.file("c"));
  ASSERT_TRUE(removed);
  EXPECT_EQ(*removed, 1046u);
  EXPECT_TRUE(std::filesystem::exists(folder.file("c/mine.txt")));
  std::filesystem::remove(folder.file("c/mine.txt"));
  EXPECT_TRUE(BakeCache::clean(folder.file("c")));
  EXPECT_FALSE(std::filesystem::exists(folder.file("c")));
  EXPECT_FALSE(BakeCache::clean(folder.file("c")));
  formats::writeFile(folder.file("file"), some(3, 1));
  EXPECT_FALSE(BakeCache::open(folder.file("file"), 1000));
}

}  // namespace
}  // namespace ff::bake
