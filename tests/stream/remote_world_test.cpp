// A world behind a web server is streamed as one on the disk is.
#include <gtest/gtest.h>

#include <filesystem>

#include "formats/codec/records.h"
#include "formats/read/reader.h"
#include "formats/storage/cached_storage.h"
#include "formats/storage/http_storage.h"
#include "stream/file_source.h"
#include "stream/streamer.h"
#include "tests/support/nginx.h"
#include "tests/support/synthetic_world.h"
#include "tests/support/web_server.h"

namespace ff::stream {
namespace {

using namespace std::chrono_literals;

class RemoteWorld : public testing::Test {
 protected:
  RemoteWorld() {
    const auto written = formats::writeWorld(makeSyntheticWorld({.side = 128, .levels = 6, .tile_nodes = 64, .quanta = 15}), local(), 1 << 19);
    EXPECT_TRUE(written) << written.error().line();
  }
  std::string local() const { return folder_.file("w.ffm"); }
  formats::StoragePtr cached() const { return formats::cachedStorage(formats::httpStorage(), {.folder = cache_.file("cache")}); }
  static std::unique_ptr<formats::World> open(const std::string& path, const formats::StoragePtr& storage = nullptr) {
    auto world = formats::World::open(path, storage);
    EXPECT_TRUE(world) << world.error().line();
    return std::make_unique<formats::World>(std::move(*world));
  }
  static std::unique_ptr<Streamer> start(const formats::World& world) {
    auto streamer = Streamer::create(world, {.radius_m = 8, .hysteresis = 1});
    EXPECT_TRUE(streamer) << streamer.error().line();
    return std::move(*streamer);
  }
  static Vec3 at(int step) { return {2 + 0.5f * static_cast<float>(step), 1, 20 + 0.25f * static_cast<float>(step)}; }
  static constexpr int kSteps = 160;
  static constexpr Vec3 kVelocity{30, 0, 15};  // 60 steps a second

  static void settle(Streamer& streamer, Vec3 observer) {
    streamer.update(observer, {});
    const auto settled = streamer.settle();
    EXPECT_TRUE(settled) << settled.error().line();
  }
  static void expectSame(const Streamer& a, const Streamer& b) {
    ASSERT_EQ(a.active().size(), b.active().size());
    for (size_t i = 0; i < a.active().size(); ++i) {
      ASSERT_EQ(a.active()[i]->id, b.active()[i]->id);
      ASSERT_EQ(a.active()[i]->words, b.active()[i]->words);
      ASSERT_EQ(a.active()[i]->row_start, b.active()[i]->row_start);
    }
    EXPECT_EQ(a.active().front()->id.level, 0u);
  }

  formats::TemporaryFolder folder_, cache_;
};

TEST_F(RemoteWorld, AFlightOverASlowLineEndsInTheStateOfOneFromTheDisk) {
  const auto nginx = formats::Nginx::start(folder_.path(), "limit_rate 400k;");
  if (!nginx) GTEST_SKIP();
  const auto far_world = open(nginx->address("w.ffm"), cached()), near_world = open(local());
  const auto far = start(*far_world), near = start(*near_world);
  for (int step = 0; step < kSteps; ++step) {
    near->update(at(step), kVelocity);
    far->update(at(step), kVelocity);
    std::this_thread::sleep_for(5ms);
    if (step % 80 == 79) {
      settle(*far, at(step));
      settle(*near, at(step));
      expectSame(*far, *near);
    }
  }
  EXPECT_EQ(far->stats().failed, 0u) << far->lastFailure();
  // What was asked for: each piece of the cache at most once, though strips lie scattered and threads ask at the same time.
  uint64_t bytes = 0, size_of_world = 0;
  for (const auto& one : nginx->served(1)) bytes += one.body_bytes;
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) size_of_world += entry.file_size();
  EXPECT_LE(bytes, size_of_world);
  EXPECT_LE(bytes, 4 * far->stats().bytes_read) << "of strips";
}

TEST_F(RemoteWorld, WithoutAFolderForItsCacheAWorldTakesAsFewRequestsAsWithOne) {
  formats::WebServer server;
  server.addFolder(folder_.path());
  std::atomic<uint64_t> of_index = 0;
  server.spoil = [&](const formats::WebServer::Request& request, formats::WebServer::Reply&) { of_index += request.path.find(".index.") != std::string::npos; };
  std::vector<uint64_t> requests;
  std::vector<std::unique_ptr<formats::World>> worlds;
  std::vector<std::unique_ptr<Streamer>> streamers;
  for (const bool folder : {true, false}) {
    const uint64_t before = server.requests, of_index_before = of_index;
    worlds.push_back(open(server.address("/w.ffm"), folder ? cached() : formats::cachedStorage(formats::httpStorage(), {.folder = ""})));
    streamers.push_back(start(*worlds.back()));
    for (const int step : {0, 60, kSteps - 1}) settle(*streamers.back(), at(step));
    requests.push_back(server.requests - before);
    uint64_t pieces = 0;
    for (const formats::ShardInfo& shard : worlds.back()->shards())
      if (shard.kind == formats::kKindIndex) pieces += (shard.bytes + formats::kCachePiece - 1) / formats::kCachePiece;
    EXPECT_LE(of_index - of_index_before, pieces);
  }
  expectSame(*streamers[0], *streamers[1]);
  EXPECT_LE(requests[1], requests[0] + requests[0] / 4) << "which strips share a read is by chance";
}

TEST_F(RemoteWorld, NeighboursAreAskedForTogether) {
  const auto nginx = formats::Nginx::start(folder_.path());
  if (!nginx) GTEST_SKIP();
  const auto world = open(nginx->address("w.ffm"), formats::httpStorage());
  size_t served = nginx->served(1).size();
  std::vector<size_t> requests;
  std::vector<std::unique_ptr<Streamer>> streamers;
  for (const bool shared : {true, false, true, false}) {  // the first two read the index, too
    auto streamer = Streamer::create(*world, {.radius_m = 8, .hysteresis = 1}, shared ? makeFileSource(*world) : makeThreadSource(*world, 16, {}));
    ASSERT_TRUE(streamer) << streamer.error().line();
    settle(**streamer, at(kSteps - 1));
    const StreamStats stats = (*streamer)->stats();
    const size_t now = nginx->served(served + stats.reads).size();
    requests.push_back(now - served);
    served = now;
    EXPECT_EQ(stats.reads < stats.strips_read, shared);
    streamers.push_back(std::move(*streamer));
  }
  expectSame(*streamers[2], *streamers[3]);
  EXPECT_LT(requests[2], requests[3]);
}

TEST_F(RemoteWorld, NoUpdateWaitsForAServerThatDoesNotAnswer) {
  formats::WebServer server;
  server.addFolder(folder_.path());
  const auto far_world = open(server.address("/w.ffm"), formats::httpStorage()), near_world = open(local());
  const auto far = start(*far_world), near = start(*near_world);
  std::atomic<bool> answers = false;
  server.spoil = [&](const formats::WebServer::Request&, formats::WebServer::Reply&) { answers.wait(false); };
  for (int step = 0; step < kSteps; ++step) far->update(at(step), kVelocity);  // would never return
  answers = true;
  answers.notify_all();
  settle(*far, at(kSteps - 1));
  settle(*near, at(kSteps - 1));
  expectSame(*far, *near);
}

TEST_F(RemoteWorld, ClosingWaitsForNoServerThatDoesNotAnswer) {
  formats::WebServer server;
  server.addFolder(folder_.path());
  auto world = open(server.address("/w.ffm"), formats::httpStorage());
  auto streamer = start(*world);
  std::atomic<uint64_t> asked = 0;
  server.spoil = [&](const formats::WebServer::Request&, formats::WebServer::Reply& reply) { ++asked, reply.delay = 60s; };
  for (int step = 0; asked < 2 && step < 10000; ++step) {
    streamer->update(at(step % kSteps), kVelocity);
    std::this_thread::sleep_for(1ms);
  }
  const auto start = std::chrono::steady_clock::now();
  streamer.reset();
  world.reset();
  EXPECT_LT(std::chrono::steady_clock::now() - start, 10s) << "half of the time after which a line that stands still is given up";
  EXPECT_GE(asked, 2u);
}

TEST_F(RemoteWorld, ManyReadsAreUnderWayOverALineThatTakesItsTime) {
  formats::WebServer server;
  server.addFolder(folder_.path());
  const auto world = open(server.address("/w.ffm"), formats::httpStorage());
  const auto streamer = start(*world);
  settle(*streamer, at(0));
  server.spoil = [](const formats::WebServer::Request&, formats::WebServer::Reply& reply) { reply.delay = 50ms; };
  settle(*streamer, at(kSteps - 1));
  EXPECT_GE(server.most_at_a_time, 8u);
}

TEST_F(RemoteWorld, AnOutageOfTheServerIsRecoveredFrom) {
  formats::WebServer server;
  server.addFolder(folder_.path());
  const auto far_world = open(server.address("/w.ffm"), formats::httpStorage()), near_world = open(local());
  auto far = Streamer::create(*far_world, {.radius_m = 8, .hysteresis = 1, .retry_seconds = 0.1f});
  ASSERT_TRUE(far) << far.error().line();
  const auto near = start(*near_world);
  server.spoil = [](const formats::WebServer::Request&, formats::WebServer::Reply& reply) { reply.status = 503; };
  settle(**far, at(kSteps - 1));
  EXPECT_GT((*far)->stats().failed, 0u);
  EXPECT_NE((*far)->lastFailure().find("the server answers 503"), std::string::npos) << (*far)->lastFailure();
  server.spoil = nullptr;
  settle(*near, at(kSteps - 1));
  for (int tries = 0; tries < 1000 && (*far)->active().size() != near->active().size(); ++tries) {
    std::this_thread::sleep_for(10ms);
    settle(**far, at(kSteps - 1));
  }
  expectSame(**far, *near);
}

}  // namespace
}  // namespace ff::stream
