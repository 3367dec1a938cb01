#include "stream/file_source.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <thread>

#include "formats/read/whole_world.h"
#include "formats/storage/memory_storage.h"
#include "tests/support/synthetic_world.h"

namespace ff::stream {
namespace {

using formats::TileId;

struct Opened {
  explicit Opened(const SyntheticSettings& settings = {}) {
    const auto written = formats::writeWorld(makeSyntheticWorld(settings), folder.file("world.ffm"), 20000);
    EXPECT_TRUE(written) << written.error().line();
    auto opened = formats::WholeWorld::open(folder.file("world.ffm"));
    EXPECT_TRUE(opened) << opened.error().line();
    world = std::make_unique<formats::WholeWorld>(std::move(*opened));
  }
  formats::TemporaryFolder folder;
  std::unique_ptr<formats::WholeWorld> world;
};

// The two implementations, by the same tests.
class FileSource : public testing::TestWithParam<const char*> {
 protected:
  std::unique_ptr<TileSource> make(const formats::WholeWorld& world) {
    if (std::string(GetParam()) == "threads") return makeThreadSource(world, 3);
    auto uring = makeUringSource(world);
    if (uring) return std::move(*uring);
    std::cout << "io_uring is refused here: " << uring.error().line() << "\n";
    return nullptr;
  }
};

void readTile(TileSource& source, const formats::TileInfo& tile, const formats::ReadOptions& options, TileSource::Done done) {
  source.read(tile.id, tile.strip, options, std::move(done));
}

struct Collector {
  std::mutex mutex;
  std::condition_variable changed;
  std::multimap<TileId, Result<std::vector<std::byte>>> arrived;

  TileSource::Done callback() {
    return [this](TileId id, Result<std::vector<std::byte>> bytes) {
      const std::lock_guard lock(mutex);
      arrived.emplace(id, std::move(bytes));
      changed.notify_all();
    };
  }
  void await(size_t count) {
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return arrived.size() >= count; });
  }
};

TEST_P(FileSource, BringsTheBytesOfEveryStripOnceFromSeveralShards) {
  const Opened opened;
  const formats::WholeWorld& world = *opened.world;
  ASSERT_GT(world.shards().size(), 2u);
  Collector collector;
  const auto source = make(world);
  if (!source) GTEST_SKIP();
  EXPECT_STREQ(source->name(), GetParam());
  size_t asked = 0;
  for (int round = 0; round < 3; ++round)  // far more than a ring holds
    for (uint32_t level = 0; level < world.levels().size(); ++level)
      for (const formats::TileInfo& info : world.tiles(level)) {
        readTile(*source, info, {}, collector.callback());
        ++asked;
      }
  ASSERT_GT(asked, 100u);
  collector.await(asked);
  ASSERT_EQ(collector.arrived.size(), asked);
  for (auto& [id, bytes] : collector.arrived) {
    ASSERT_TRUE(bytes) << bytes.error().line();
    ASSERT_EQ(bytes->size(), world.tiles(id.level)[id.tile].strip.stored_bytes);
    formats::Strip strip;
    ASSERT_TRUE(world.decodeStrip(world.ref(id), *bytes, strip));
    ASSERT_EQ(collector.arrived.count(id), 3u);
  }
}

TEST_P(FileSource, ReportsAStripThatLiesPastTheEndOfAShrunkenShard) {
  const Opened opened;
  const formats::WholeWorld& world = *opened.world;
  const formats::TileInfo& info = world.tiles(0).back();
  std::filesystem::resize_file(opened.folder.file(world.shards()[info.strip.shard].name),
                               info.strip.offset + info.strip.stored_bytes / 2);
  Collector collector;
  const auto source = make(world);
  if (!source) GTEST_SKIP();
  readTile(*source, info, {}, collector.callback());
  collector.await(1);
  const auto& bytes = collector.arrived.begin()->second;
  ASSERT_FALSE(bytes);
  EXPECT_EQ(bytes.error().code, ErrorCode::kInvalidFile);
  EXPECT_NE(bytes.error().line().find("the file ends here"), std::string::npos) << bytes.error().line();
}

TEST_P(FileSource, AnswersEverythingBeforeItsDestructionEnds) {
  const Opened opened;
  for (int repeat = 0; repeat < 30; ++repeat) {
    Collector collector;
    auto source = make(*opened.world);
    if (!source) GTEST_SKIP();
    for (int i = 0; i < repeat; ++i)
      readTile(*source, opened.world->tiles(0)[static_cast<size_t>(i) % 5], {}, collector.callback());
    source.reset();
    ASSERT_EQ(collector.arrived.size(), static_cast<size_t>(repeat));
  }
}

TEST_P(FileSource, ReadsThatAreCancelledOrLateEndWithAnError) {
  const Opened opened;
  const auto source = make(*opened.world);
  if (!source) GTEST_SKIP();
  const std::atomic<bool> yes = true, no = false;
  const auto now = std::chrono::steady_clock::now();
  struct Case {
    formats::ReadOptions options;
    const char* message;  // null: the read is good
  };
  for (const Case& c : {Case{{.cancelled = &yes}, "cancelled"}, Case{{.cancelled = &no, .deadline = now}, "deadline"},
                        Case{{.cancelled = &no, .deadline = now + std::chrono::hours(1)}, nullptr}}) {
    Collector collector;
    // More than the ring has places.
    for (int i = 0; i < 200; ++i) readTile(*source, opened.world->tiles(0)[static_cast<size_t>(i) % 5], c.options, collector.callback());
    collector.await(200);
    for (const auto& [id, bytes] : collector.arrived) {
      ASSERT_EQ(bytes.has_value(), c.message == nullptr);
      if (c.message) {
        ASSERT_NE(bytes.error().line().find(c.message), std::string::npos) << bytes.error().line();
      }
    }
  }
}

TEST_P(FileSource, TakesRequestsFromSeveralThreads) {
  const Opened opened;
  Collector collector;
  const auto source = make(*opened.world);
  if (!source) GTEST_SKIP();
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 4; ++t)
    threads.emplace_back([&, t] {
      for (uint32_t i = 0; i < 50; ++i)
        readTile(*source, opened.world->tiles(0)[(t * 50 + i) % opened.world->levels()[0].tiles], {}, collector.callback());
    });
  for (std::thread& thread : threads) thread.join();
  collector.await(200);
  for (const auto& [id, bytes] : collector.arrived) ASSERT_TRUE(bytes);
}

TEST(FileSourceOfMemory, ReadsWithThreads) {
  const auto memory = std::make_shared<formats::MemoryStorage>();
  ASSERT_TRUE(formats::writeWorld(makeSyntheticWorld({}), "world.ffm", 20000, memory));
  const auto world = formats::WholeWorld::open("world.ffm", memory);
  ASSERT_TRUE(world) << world.error().line();
  EXPECT_FALSE(makeUringSource(*world));
  const auto source = makeFileSource(*world);
  EXPECT_STREQ(source->name(), "threads");
  Collector collector;
  const formats::TileInfo& tile = world->tiles(0).front();
  readTile(*source, tile, {}, collector.callback());
  collector.await(1);
  const auto& bytes = collector.arrived.begin()->second;
  ASSERT_TRUE(bytes) << bytes.error().line();
  formats::Strip strip;
  EXPECT_TRUE(world->decodeStrip(world->ref(tile.id), *bytes, strip));
}

// As where a sandbox closes in while the program runs: the ring's descriptor is something else from one read to the next.
TEST(UringSource, ReadsItselfOnceTheKernelRefusesItsRing) {
  const Opened opened;
  auto source = makeUringSource(*opened.world);
  if (!source) GTEST_SKIP() << source.error().line();
  Collector collector;
  readTile(**source, opened.world->tiles(0)[0], {}, collector.callback());
  collector.await(1);
  int ring = -1;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    if (std::filesystem::read_symlink(entry, gone) == "anon_inode:[io_uring]") ring = std::stoi(entry.path().filename());
  }
  ASSERT_GE(ring, 0);
  const int other = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
  ASSERT_EQ(::dup2(other, ring), ring);
  ::close(other);
  size_t asked = 1;
  for (const formats::TileInfo& info : opened.world->tiles(0)) {
    readTile(**source, info, {}, collector.callback());
    ++asked;
  }
  collector.await(asked);
  formats::Strip strip;
  for (const auto& [id, bytes] : collector.arrived) {
    ASSERT_TRUE(bytes) << bytes.error().line();
    EXPECT_TRUE(opened.world->decodeStrip(opened.world->ref(id), *bytes, strip));
  }
}

// From now on the kernel answers every io_uring_enter of this process with an error. False: it does not let us.
bool refuseUringEnter(uint32_t error) {
  sock_filter filter[] = {BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)), BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, __NR_io_uring_enter, 0, 1),
                          BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | error), BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)};
  const sock_fprog program{4, filter};
  return ::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 && ::syscall(__NR_seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC, &program) == 0;
}

TEST(UringSource, WhateverErrorTheKernelHasForItsRingTheStripsCome) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const auto readAll = [](uint32_t error) {
    constexpr int kGood = 0, kSkipped = 3;
    const Opened opened;
    auto source = makeUringSource(*opened.world);
    Collector collector;
    if (!source) std::_Exit(kSkipped);
    readTile(**source, opened.world->tiles(0)[0], {}, collector.callback());
    collector.await(1);
    if (!refuseUringEnter(error)) std::_Exit(kSkipped);
    size_t asked = 1;
    for (const formats::TileInfo& info : opened.world->tiles(0)) readTile(**source, info, {}, collector.callback()), ++asked;
    collector.await(asked);
    for (const auto& [id, bytes] : collector.arrived)
      if (!bytes) std::cerr << bytes.error().line() << "\n", std::_Exit(1);
    source->reset();  // ends, too
    std::_Exit(kGood);
  };
  for (const uint32_t error : {EAGAIN, EBUSY, ENOMEM, EPERM, EBADF})
    EXPECT_EXIT(readAll(error), [](int status) { return WIFEXITED(status) && (WEXITSTATUS(status) == 0 || WEXITSTATUS(status) == 3); }, "") << error;
}

INSTANTIATE_TEST_SUITE_P(Both, FileSource, testing::Values("io_uring", "threads"),
                         [](const auto& p) { return std::string(p.param); });

}  // namespace
}  // namespace ff::stream
