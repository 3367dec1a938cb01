// What every storage promises, and that no fault of one, at any call, costs a world.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <optional>
#include <set>
#include <thread>

#include "formats/read/whole_world.h"
#include "formats/storage/memory_storage.h"
#include "formats/write/writer.h"
#include "tests/formats/faulty_storage.h"
#include "tests/support/random_world.h"

namespace ff::formats {
namespace {

std::vector<std::byte> bytesOf(std::string_view text) {
  const auto bytes = std::as_bytes(std::span(text));
  return {bytes.begin(), bytes.end()};
}

class StorageContract : public testing::TestWithParam<const char*> {
 protected:
  StoragePtr storage_ = std::string_view(GetParam()) == "posix" ? posixStorage() : std::make_shared<MemoryStorage>();
  TemporaryFolder folder_;
  std::string path(const char* name) const { return folder_.file(name); }
  Result<void> write(const char* name, std::string_view text) { return writeWholeFile(*storage_, path(name), bytesOf(text)); }
};

TEST_P(StorageContract, GivesBackWhatWasWritten) {
  ASSERT_TRUE(write("a", "light"));
  const auto all = readWholeFile(*storage_, path("a"));
  ASSERT_TRUE(all);
  EXPECT_EQ(*all, bytesOf("light"));
  auto file = storage_->open(path("a"));
  ASSERT_TRUE(file);
  EXPECT_EQ((*file)->bytes(), 5u);
  std::vector<std::byte> part(3);
  ASSERT_TRUE((*file)->read(2, part));
  EXPECT_EQ(part, bytesOf("ght"));
  const auto past = (*file)->read(3, part);
  ASSERT_FALSE(past);
  EXPECT_EQ(past.error().code, ErrorCode::kInvalidFile);
  EXPECT_EQ(past.error().place, "offset 5");
}

TEST_P(StorageContract, AnOpenFileOutlivesItsName) {
  ASSERT_TRUE(write("a", "old"));
  auto file = storage_->open(path("a"));
  ASSERT_TRUE(file);
  ASSERT_TRUE(write("a", "new light"));
  std::vector<std::byte> bytes(3);
  ASSERT_TRUE((*file)->read(0, bytes));
  EXPECT_EQ(bytes, bytesOf("old"));
  ASSERT_TRUE(storage_->remove(path("a")));
  ASSERT_TRUE((*file)->read(0, bytes));
  EXPECT_EQ(bytes, bytesOf("old"));
}

// Piece by piece, through a storage that lets a test watch.
TEST_P(StorageContract, AReadCanBeCancelledAndHasADeadline) {
  const size_t pieces = 3;
  ASSERT_TRUE(write("a", std::string(pieces * kReadPiece, 'x')));
  FaultyStorage watched(storage_);
  auto file = watched.open(path("a"));
  ASSERT_TRUE(file);
  std::vector<std::byte> bytes(pieces * kReadPiece);
  size_t read = 0;
  std::atomic<bool> cancelled = false;
  watched.on_read = [&] { cancelled = ++read == 2; };
  const auto stopped = (*file)->read(0, bytes, {.cancelled = &cancelled});
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().code, ErrorCode::kIo);
  EXPECT_EQ(stopped.error().file, path("a"));
  EXPECT_EQ(stopped.error().place, "offset " + std::to_string(2 * kReadPiece));
  EXPECT_EQ(read, 2u);
  watched.on_read = [&] { ++read; };
  const auto in = [](std::chrono::milliseconds time) { return ReadOptions{.deadline = std::chrono::steady_clock::now() + time}; };
  EXPECT_FALSE((*file)->read(0, bytes, in(std::chrono::milliseconds(0))));
  EXPECT_EQ(read, 2u);
  const ReadOptions soon = in(std::chrono::milliseconds(20));
  watched.on_read = [&] { std::this_thread::sleep_until(soon.deadline); };
  const auto late = (*file)->read(0, bytes, soon);
  ASSERT_FALSE(late);
  EXPECT_NE(late.error().message.find("deadline"), std::string::npos) << late.error().line();
  watched.on_read = nullptr;
  cancelled = false;
  ASSERT_TRUE((*file)->read(0, bytes, {.cancelled = &cancelled, .deadline = in(std::chrono::hours(1)).deadline}));
  EXPECT_EQ(std::count(bytes.begin(), bytes.end(), std::byte{'x'}), static_cast<std::ptrdiff_t>(bytes.size()));
  // Of the storage itself, too.
  auto own = storage_->open(path("a"));
  ASSERT_TRUE(own);
  cancelled = true;
  EXPECT_FALSE((*own)->read(0, bytes, {.cancelled = &cancelled}));
  EXPECT_TRUE((*own)->read(0, bytes));
}

TEST_P(StorageContract, ListsNamesInOrderAndSaysWhatIsAbsent) {
  ASSERT_TRUE(write("b", "2"));
  ASSERT_TRUE(write("a", "1"));
  EXPECT_EQ(*storage_->list(folder_.path() + "/"), (std::vector<std::string>{"a", "b"}));
  ASSERT_TRUE(storage_->rename(path("b"), path("a")));
  EXPECT_EQ(*storage_->list(folder_.path() + "/"), (std::vector<std::string>{"a"}));
  EXPECT_EQ(*readWholeFile(*storage_, path("a")), bytesOf("2"));
  EXPECT_TRUE(*storage_->exists(path("a")));
  EXPECT_FALSE(*storage_->exists(path("b")));
  for (const Error& e : {storage_->open(path("b")).error(), storage_->remove(path("b")).error(), storage_->rename(path("b"), path("c")).error()}) {
    EXPECT_EQ(e.code, ErrorCode::kIo);
    EXPECT_FALSE(e.file.empty()) << e.line();
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, StorageContract, testing::Values("posix", "memory"), [](const auto& of) { return std::string(of.param); });

// Two bakes of a scene, and what of them is there.
class Rebake : public testing::Test {
 protected:
  static RandomWorld world(uint64_t seed) {
    RandomWorldSettings settings;
    settings.level0_tiles = 3;
    settings.levels = 2;
    settings.max_tile_nodes = 6;
    RandomWorld w = makeRandomWorld(settings);
    w.strips[0][1].nodes[0].area_m2 += static_cast<float>(seed);
    w.info.seed = seed;
    return w;
  }
  static Result<void> bake(uint64_t seed, const StoragePtr& storage) { return writeWorld(world(seed), "out/w.ffm", 2000, storage); }

  // How often it calls the storage, where a world is.
  static uint64_t callsOf(const std::function<void(const StoragePtr&)>& work) {
    const auto disk = std::make_shared<MemoryStorage>();
    EXPECT_TRUE(bake(1, disk));
    const auto counting = std::make_shared<FaultyStorage>(disk);
    work(counting);
    return counting->calls;
  }

  static std::vector<std::string> shardNames(const StoragePtr& storage) {
    std::vector<std::string> names;
    const auto w = WholeWorld::open("out/w.ffm", storage);
    for (const ShardInfo& shard : w->shards()) names.push_back(shard.name);
    return names;
  }

  // Seed of the world that is whole there.
  static std::optional<uint64_t> whole(const StoragePtr& storage) {
    const auto w = WholeWorld::open("out/w.ffm", storage);
    if (!w) return {};
    for (uint32_t level = 0; level < w->levels().size(); ++level)
      for (uint32_t tile = 0; tile < w->tiles(level).size(); ++tile)
        if (!w->strip({level, tile})) return {};
    for (uint32_t tile = 0; tile < w->tiles(0).size(); ++tile)
      if (!w->geometry(tile)) return {};
    return w->info().seed;
  }
};

TEST_F(Rebake, AFaultAtAnyCallLeavesTheOldWorldOrTheNewOne) {
  uint64_t finished = 0;
  const uint64_t calls = callsOf([](const StoragePtr& storage) { ASSERT_TRUE(bake(2, storage)); });
  ASSERT_GT(calls, 20u);
  for (const bool for_ever : {false, true})
    for (uint64_t at = 0; at < calls; ++at) {
      const auto disk = std::make_shared<MemoryStorage>();
      ASSERT_TRUE(bake(1, disk));
      const auto faulty = std::make_shared<FaultyStorage>(disk);
      faulty->fail_at = at;
      faulty->for_ever = for_ever;
      const auto baked = bake(2, faulty);
      finished += baked.has_value();
      const auto where = [&] { return "call " + std::to_string(at) + (for_ever ? " and all after it" : " alone"); };
      if (!baked) {
        EXPECT_FALSE(baked.error().file.empty()) << where() << ": " << baked.error().line();
      }
      const std::pair<const char*, StoragePtr> disks[] = {
          {"as it is", disk},
          {"after a power cut that loses names", disk->afterPowerCut(MemoryStorage::Unsynced::kNamesDropped)},
          {"after a power cut that keeps the newest name", disk->afterPowerCut(MemoryStorage::Unsynced::kNewestNameKept)},
          {"after a power cut that keeps names", disk->afterPowerCut(MemoryStorage::Unsynced::kNamesKept)}};
      for (const auto& [what, left] : disks) {
        const auto seed = whole(left);
        ASSERT_TRUE(seed) << where() << ", " << what << ": no whole world";
        if (baked) {
          EXPECT_EQ(*seed, 2u) << where() << ", " << what << ": said to be finished";
        }
        EXPECT_TRUE(bake(3, left)) << where() << ", " << what << ": the next bake";
        EXPECT_EQ(whole(left), 3u);
      }
    }
  EXPECT_GT(finished, 0u) << "what is removed after the new manifest is there may fail";
}

TEST_F(Rebake, LeavesWhatTheManifestNamesAndNothingElseOfItsOwn) {
  const auto disk = std::make_shared<MemoryStorage>();
  const auto put = [&](const char* name) { ASSERT_TRUE(writeWholeFile(*disk, std::string("out/") + name, bytesOf("x"))); };
  const std::vector<std::string> others = {"town.0123456789abcdef.ffs", "w.2.0123456789abcdef.ffs", "w.2.0000.part", "w.0123456789abcdef.ffs.old", "w.settings.json", "w.glb"};
  for (const std::string& name : others) put(name.c_str());
  for (const char* left_by_the_killed : {"w.0017.part", "w.geometry.0000.part", "w.ffm.part", "w.0123456789abcdef.ffs", "w.geometry.0123456789abcdef.ffs", "w.index.0123456789abcdef.ffs", "w.index.0003.part"}) put(left_by_the_killed);
  ASSERT_TRUE(bake(1, disk));
  ASSERT_TRUE(bake(2, disk));
  std::vector<std::string> expected = others;
  expected.push_back("w.ffm");
  for (const std::string& name : shardNames(disk)) expected.push_back(name);
  std::sort(expected.begin(), expected.end());
  expected.erase(std::unique(expected.begin(), expected.end()), expected.end());  // shards of the same bytes have one name
  EXPECT_EQ(*disk->list("out/"), expected);
}

TEST_F(Rebake, KeepsTheNameOfAShardThatDidNotChange) {
  const auto disk = std::make_shared<MemoryStorage>();
  ASSERT_TRUE(bake(1, disk));
  const auto before = shardNames(disk);
  ASSERT_GT(before.size(), 3u);
  ASSERT_TRUE(bake(1, disk));
  EXPECT_EQ(shardNames(disk), before);
  ASSERT_TRUE(bake(2, disk));
  const auto after = shardNames(disk);
  ASSERT_EQ(after.size(), before.size());
  size_t changed = 0, of_index = 0;
  for (size_t i = 0; i < after.size(); ++i) (after[i].find(".index.") == std::string::npos ? changed : of_index) += after[i] != before[i];
  EXPECT_EQ(changed, 1u) << "one strip was another";
  EXPECT_GT(of_index, 0u) << "and so is the record of its chunk";
}

TEST_F(Rebake, IsNotLostWhereAFolderCannotBeSynced) {
  const auto faulty = std::make_shared<FaultyStorage>(std::make_shared<MemoryStorage>());
  faulty->folders_can_sync = false;
  std::vector<std::string> warnings;
  ASSERT_TRUE(writeWorld(world(1), "out/w.ffm", 2000, faulty, &warnings));
  EXPECT_EQ(whole(faulty), 1u);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("out/"), std::string::npos) << warnings[0];
}

// One whose shards it has opened needs none of their names any more.
TEST_F(Rebake, AReaderThatHasOpenedAllShardsOutlivesThem) {
  TemporaryFolder folder;
  const std::string path = folder.file("w.ffm");
  ASSERT_TRUE(writeWorld(world(1), path, 2000));
  const auto old = World::open(path);
  ASSERT_TRUE(old && old->openShards());
  ASSERT_GT(old->shards().size(), 4u);
  ASSERT_TRUE(writeWorld(world(2), path, 2000));
  EXPECT_NE(World::open(path)->checksum(), old->checksum());
  for (uint32_t level = 0; level < old->levels().size(); ++level)
    for (uint32_t tile = 0; tile < old->levels()[level].tiles; ++tile) ASSERT_TRUE(old->strip(TileId{level, tile}));
  std::filesystem::remove(shardOf(path));
  const auto torn = World::open(path)->openShards();
  ASSERT_FALSE(torn);
  EXPECT_EQ(torn.error().code, ErrorCode::kIo);
}

TEST(Storage, AVersionTellsAFileFromTheOneThatTakesItsPlace) {
  TemporaryFolder folder;
  for (const StoragePtr& storage : {posixStorage(), StoragePtr(std::make_shared<MemoryStorage>())}) {
    const std::string path = folder.file("a");
    EXPECT_FALSE(storage->version(path));
    const std::vector<std::byte> bytes(10);
    std::set<std::string> seen;
    for (int i = 0; i < 5; ++i) {
      ASSERT_TRUE(writeWholeFile(*storage, path, bytes));
      const auto version = storage->version(path);
      ASSERT_TRUE(version);
      EXPECT_TRUE(seen.insert(*version).second);
      EXPECT_EQ(*storage->version(path), *version);
    }
  }
}

TEST_F(Rebake, AReaderGoesOnWithTheWorldThatItOpened) {
  TemporaryFolder folder;
  const std::string path = folder.file("w.ffm");
  ASSERT_TRUE(writeWorld(world(1), path, 2000));
  const auto old = WholeWorld::open(path);
  ASSERT_TRUE(old);
  const float area = old->strip(TileId{0, 1})->nodes[0].area_m2;
  ASSERT_TRUE(writeWorld(world(2), path, 2000));
  const auto strip = old->strip(TileId{0, 1});
  ASSERT_TRUE(strip) << strip.error().line();
  EXPECT_EQ(strip->nodes[0].area_m2, area);
  EXPECT_EQ(WholeWorld::open(path)->strip(TileId{0, 1})->nodes[0].area_m2, area + 1);
}

TEST_F(Rebake, AFaultAtAnyReadIsAnErrorWithFileAndPlace) {
  const auto disk = std::make_shared<MemoryStorage>();
  ASSERT_TRUE(bake(1, disk));
  const uint64_t calls = callsOf([](const StoragePtr& storage) { ASSERT_TRUE(whole(storage)); });
  ASSERT_GT(calls, 15u);
  for (uint64_t at = 0; at < calls; ++at) {
    const auto faulty = std::make_shared<FaultyStorage>(disk);
    faulty->fail_at = at;
    const auto w = WholeWorld::open("out/w.ffm", faulty);
    int refused = 0;
    const auto look = [&](const auto& read) {
      if (read) return;
      ++refused;
      EXPECT_EQ(read.error().code, ErrorCode::kIo);
      EXPECT_TRUE(read.error().file.starts_with("out/w.")) << read.error().line();
      EXPECT_NE(read.error().line().find("fault"), std::string::npos) << read.error().line();
    };
    look(w);
    if (w) {
      for (uint32_t level = 0; level < w->levels().size(); ++level)
        for (uint32_t tile = 0; tile < w->tiles(level).size(); ++tile) look(w->strip({level, tile}));
      for (uint32_t tile = 0; tile < w->tiles(0).size(); ++tile) look(w->geometry(tile));
    }
    EXPECT_EQ(refused, 1) << "call " << at;
  }
}

}  // namespace
}  // namespace ff::formats
