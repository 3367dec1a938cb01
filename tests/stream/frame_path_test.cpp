// What the frame thread must not do: allocate, free, or wait for those who read.
#include <gtest/gtest.h>

#include <future>
#include <map>
#include <set>

#include "formats/read/whole_world.h"
#include "stream/file_source.h"
#include "stream/streamer.h"
#include "tests/stream/test_sources.h"
#include "tests/support/counted_memory.h"
#include "tests/support/synthetic_world.h"

namespace ff::stream {
namespace {

using formats::TileId;

class FramePath : public testing::Test {
 protected:
  FramePath() {
    const auto written = formats::writeWorld(makeSyntheticWorld({.side = 64, .levels = 5, .tile_nodes = 32}),
                                             folder_.file("w.ffm"), 1 << 20);
    if (!written) throw std::runtime_error(written.error().line());
    auto opened = formats::WholeWorld::open(folder_.file("w.ffm"));
    if (!opened) throw std::runtime_error(opened.error().line());
    world_ = std::make_unique<formats::WholeWorld>(std::move(*opened));
  }
  std::unique_ptr<Streamer> make(const StreamSettings& settings, std::unique_ptr<TileSource> source) const {
    auto streamer = Streamer::create(*world_, settings, std::move(source));
    EXPECT_TRUE(streamer) << streamer.error().line();
    return std::move(*streamer);
  }
  // Turns, straight lines and a teleport now and then.
  std::vector<Vec3> walk(int steps, uint64_t seed) const {
    std::mt19937_64 random(seed);
    std::vector<Vec3> places;
    Vec3 at{32, 1, 32}, step{0.3f, 0, 0.1f};
    for (int i = 0; i < steps; ++i) {
      if (i % 40 == 0)
        step = {static_cast<float>(random() % 100) / 100 - 0.5f, 0, static_cast<float>(random() % 100) / 100 - 0.5f};
      if (i % 500 == 499) at = {static_cast<float>(random() % 64), 1, static_cast<float>(random() % 64)};
      at = ff::max(ff::min(at + step, {64, 1, 64}), {0, 1, 0});
      places.push_back(at);
    }
    return places;
  }

  formats::TemporaryFolder folder_;
  std::unique_ptr<formats::WholeWorld> world_;
};

// Passes reads on to the shards, but lets every fifth fail or arrive damaged, and those of some patches' tiles always fail.
class FaultySource final : public TileSource {
 public:
  explicit FaultySource(std::unique_ptr<TileSource> good) : good_(std::move(good)) {}
  void read(TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    const uint32_t n = id.level == 0 && id.tile % 11 == 0 ? kFails : reads_++;
    good_->read(id, extent, options, [n, done = std::move(done)](TileId of, Result<std::vector<std::byte>> bytes) {
      if (n > 50 && n % 5 == 0) return done(of, Error{ErrorCode::kIo, "faulty", "", "made to fail at some length", ""});
      if (n > 50 && n % 5 == 1) (*bytes)[bytes->size() / 2] ^= std::byte{1};
      done(of, std::move(bytes));
    });
  }
  SharedReads sharedReads() const override { return good_->sharedReads(); }
  int readsAtOnce() const override { return good_->readsAtOnce(); }
  const char* name() const override { return "faulty"; }

 private:
  static constexpr uint32_t kFails = 1'000'000'000;
  std::unique_ptr<TileSource> good_;
  std::atomic<uint32_t> reads_{0};
};

TEST_F(FramePath, ALongWalkAllocatesAndFreesNothingOnTheThreadThatUpdates) {
  const std::vector<Vec3> places = walk(4000, 3);
  for (const auto& [faulty, background] : {std::pair(false, false), std::pair(true, false), std::pair(true, true)}) {
    auto source = makeFileSource(*world_);
    if (faulty) source = std::make_unique<FaultySource>(std::move(source));
    const auto streamer = make({.radius_m = 8, .memory_bytes = 300000, .decode_threads = 2, .background = background}, std::move(source));
    // A user who shares the active strips for a while, as the runtime does.
    std::vector<StripPtr> held;
    held.reserve(world_->tiles(0).size() * 2);
    uint32_t changes = 0;
    const MemoryCalls before = memoryCalls();
    // However slowly strips arrive: until enough have come and gone.
    const auto enough = [&] { return changes > 200 && streamer->stats().evicted > 200; };
    for (size_t i = 0; i < places.size() || (i < 20 * places.size() && !enough()); ++i) {
      const bool changed = streamer->update(places[i % places.size()], {1, 0, 0});
      changes += changed;
      if (changed && i % 3 == 0) held.assign(streamer->active().begin(), streamer->active().end());
      if (i % 10 == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));  // so that there are arrivals
    }
    const StreamStats stats = streamer->stats();
    const MemoryCalls after = memoryCalls();
    EXPECT_EQ(after.allocated - before.allocated, 0u);
    EXPECT_EQ(after.freed - before.freed, 0u);
    EXPECT_GT(changes, 200u);
    EXPECT_GT(stats.evicted, 200u);
    EXPECT_EQ(stats.failed > 0, faulty);
    EXPECT_EQ(streamer->lastFailure().empty(), !faulty);
  }
}

TEST_F(FramePath, TheCounterSeesWhatThisThreadAllocatesAndFreesAndNoOther) {
  const auto once = [] { ::operator delete(::operator new(100)); };  // which may not be optimised away
  const MemoryCalls before = memoryCalls();
  std::thread other([&] {
    for (int i = 0; i < 100; ++i) once();
  });
  other.join();
  const MemoryCalls between = memoryCalls();
  once();
  const MemoryCalls after = memoryCalls();
  EXPECT_LE(between.allocated - before.allocated, 1u);  // the thread's own state
  EXPECT_EQ(after.allocated - between.allocated, 1u);
  EXPECT_EQ(after.freed - between.freed, 1u);
}

TEST_F(FramePath, MemoryThatRunsOutOnOtherThreadsIsAFailureOfStripsThatComeLater) {
  for (const char* kind : {"io_uring", "threads"}) {
    auto uring = makeUringSource(*world_);
    if (!uring && kind == std::string("io_uring")) continue;
    const auto streamer = make({.radius_m = 8, .decode_threads = 2}, kind == std::string("threads") ? makeThreadSource(*world_) : std::move(*uring));
    const auto visit = [&](std::initializer_list<Vec3> places) {
      for (const Vec3 at : places) {
        streamer->update(at, {});
        ASSERT_TRUE(streamer->settle());
      }
    };
    visit({{10, 1, 10}});
    refuseOthersEveryNth(7);
    visit({{50, 1, 50}, {10, 1, 50}, {10, 1, 10}});
    refuseOthersEveryNth(0);
    EXPECT_GT(streamer->stats().failed, 0u) << kind;
    EXPECT_NE(streamer->lastFailure().find("out of memory"), std::string::npos) << streamer->lastFailure();
    const uint64_t failed = streamer->stats().failed;
    visit({{50, 1, 50}});
    EXPECT_EQ(streamer->stats().failed, failed);
    EXPECT_EQ(streamer->stats().pending_tiles, 0u);
    EXPECT_EQ(streamer->active().front()->id.level, 0u);
  }
}

// read() itself blocks until it is let go.
class StuckSource final : public TileSource {
 public:
  explicit StuckSource(std::unique_ptr<TileSource> good) : good_(std::move(good)) {}
  void read(TileId id, const formats::Extent& extent, const formats::ReadOptions& options, Done done) override {
    stuck_.wait(true);
    good_->read(id, extent, options, std::move(done));
  }
  void stick(bool stuck) {
    stuck_ = stuck;
    stuck_.notify_all();
  }
  SharedReads sharedReads() const override { return good_->sharedReads(); }
  int readsAtOnce() const override { return good_->readsAtOnce(); }
  const char* name() const override { return "stuck"; }

 private:
  std::unique_ptr<TileSource> good_;
  std::atomic<bool> stuck_{false};
};

TEST_F(FramePath, UpdatesGoOnWhileTheSourceItselfBlocks) {
  auto source = std::make_unique<StuckSource>(makeThreadSource(*world_));
  StuckSource* const stuck = source.get();
  const auto streamer = make({.radius_m = 8}, std::move(source));
  stuck->stick(true);
  for (const Vec3 at : walk(500, 4)) streamer->update(at, {});  // would hang here if it started reads
  EXPECT_GT(streamer->stats().pending_tiles, 0u);
  stuck->stick(false);
  ASSERT_TRUE(streamer->settle());
  EXPECT_EQ(streamer->stats().pending_tiles, 0u);
  EXPECT_EQ(streamer->active().front()->id.level, 0u);
}

TEST_F(FramePath, AStripThatIsHeldOutlivesItsEviction) {
  const auto streamer = make({.radius_m = 8, .memory_bytes = 220000, .kept_bytes = 0}, makeFileSource(*world_));
  streamer->update({10, 1, 10}, {});
  ASSERT_TRUE(streamer->settle());
  const std::vector<StripPtr> held(streamer->active().begin(), streamer->active().end());
  std::vector<uint32_t> nodes;
  for (const StripPtr& strip : held) nodes.push_back(strip->nodes.front().quanta);
  for (uint64_t seed = 5; seed < 50 && streamer->stats().evicted <= held.size(); ++seed)
    for (const Vec3 at : walk(20, seed)) {
      streamer->update(at, {});
      ASSERT_TRUE(streamer->settle());
    }
  EXPECT_GT(streamer->stats().evicted, held.size());
  for (size_t i = 0; i < held.size(); ++i) EXPECT_EQ(held[i]->nodes.front().quanta, nodes[i]);
}

TEST_F(FramePath, WhatAStreamerTakesIsForWhatIsNearAndNotForTheWorld) {
  std::map<size_t, uint64_t> bytes;  // by tiles of the world
  for (const uint32_t side : {64u, 128u}) {
    const auto path = folder_.file(std::to_string(side) + ".ffm");
    ASSERT_TRUE(formats::writeWorld(makeSyntheticWorld({.side = side, .levels = 6, .tile_nodes = 16, .quanta = 15}), path, 1 << 20));
    const auto world = formats::WholeWorld::open(path);
    ASSERT_TRUE(world) << world.error().line();
    size_t tiles = 0;
    for (const formats::LevelInfo& level : world->levels()) tiles += level.tiles;
    auto source = makeFileSource(*world);
    const uint64_t before = memoryCalls().bytes;
    const auto streamer = Streamer::create(*world, {.radius_m = 8, .max_level0_nodes = 64, .max_nodes = 96}, std::move(source));
    ASSERT_TRUE(streamer) << streamer.error().line();
    bytes[tiles] = memoryCalls().bytes - before;
  }
  const auto [few, few_bytes] = *bytes.begin();
  const auto [many, many_bytes] = *bytes.rbegin();
  ASSERT_GT(many, 3 * few);
  EXPECT_LT(many_bytes, few_bytes + 48 * (many - few)) << "the heap of a walk alone has room for all tiles of a small world: 24 bytes each";
}

}  // namespace
}  // namespace ff::stream
