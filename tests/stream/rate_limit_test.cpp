// Bytes read a second: the limiter alone, and a streamer that it holds up, by a clock that the test turns.
#include "stream/rate_limit.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <random>
#include <set>
#include <thread>

#include "formats/read/whole_world.h"
#include "stream/streamer.h"
#include "tests/support/synthetic_world.h"

namespace ff::stream {
namespace {

using namespace std::chrono_literals;

TEST(RateLimit, LetsNoMoreBeginInAnyTimeThanItSays) {
  std::mt19937 random(4);
  for (const uint64_t rate : {1000u, 50000u, 10000000u}) {
    RateLimit limit(rate);
    Clock::time_point now{1h};
    std::vector<std::pair<Clock::time_point, uint64_t>> begun;
    uint64_t largest = 0, all = 0;
    for (int step = 0; step < 3000; ++step) {
      now += std::chrono::microseconds(random() % 5000) + (step % 500 == 0 ? 10s : 0s);  // pauses save up kBurst and no more
      while (limit.lets(now)) {
        const uint64_t bytes = 1 + random() % (rate / 20);
        limit.begin(bytes, now);
        begun.emplace_back(now, bytes);
        largest = std::max(largest, bytes);
        all += bytes;
      }
    }
    for (size_t from = 0; from < begun.size(); from += 7) {
      double bytes = 0;
      for (size_t k = from; k < begun.size(); ++k) {
        bytes += static_cast<double>(begun[k].second);
        const std::chrono::duration<double> took = begun[k].first - begun[from].first + RateLimit::kBurst;
        ASSERT_LE(bytes, took.count() * static_cast<double>(rate) + static_cast<double>(largest) + 1);
      }
    }
    // And uses what it lets: 7.5 s of steps, and 6 pauses of which a burst counts.
    EXPECT_GT(static_cast<double>(all), 7 * static_cast<double>(rate));
  }
  RateLimit none(0);
  none.begin(1 << 30, Clock::time_point{1h});
  EXPECT_TRUE(none.lets(Clock::time_point{}));
}

TEST(RateLimit, HoldsUpAStreamersReadsAndTheNearestComeFirst) {
  const formats::TemporaryFolder folder;
  ASSERT_TRUE(formats::writeWorld(makeSyntheticWorld({.side = 64, .levels = 5, .tile_nodes = 32}), folder.file("w.ffm"), 1 << 20));
  const auto world = formats::WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world);
  StreamSettings settings{.radius_m = 8, .hysteresis = 1.0f, .queue_depth = 1, .ahead_seconds = 0, .hint_bytes = 0};
  const Vec3 at{30, 1, 30};
  std::set<formats::TileId> expected;
  uint64_t bytes = 0, largest = 0;
  {
    const auto free = std::move(*Streamer::create(*world, settings));
    const uint64_t before = free->stats().bytes_read;
    free->update(at, {});
    ASSERT_TRUE(free->settle());
    for (const StripPtr& strip : free->active()) {
      expected.insert(strip->id);
      largest = std::max<uint64_t>(largest, strip->tile.info().strip.stored_bytes);
    }
    bytes = free->stats().bytes_read - before;
    EXPECT_EQ(free->stats().reads_held, 0u);
  }
  settings.read_bytes_per_second = bytes / 2;
  std::atomic<int64_t> clock_ms{3600000};
  const auto limited = std::move(*Streamer::create(*world, settings, nullptr, [&] { return Clock::time_point(std::chrono::milliseconds(clock_ms.load())); }));
  const uint64_t before = limited->stats().bytes_read;
  const auto read = [&] { return static_cast<double>(limited->stats().bytes_read - before); };
  const auto look = [&] {  // until what may come has come: a streamer that reads more than it may has time for it
    for (int i = 0; i < 30; ++i) {
      limited->update(at, {});
      std::this_thread::sleep_for(1ms);
    }
  };
  double seconds = 0;
  float farthest = 0;
  std::set<formats::TileId> there;
  for (; seconds < 6 && read() < static_cast<double>(bytes); seconds += 0.04, clock_ms += 40) {
    look();
    EXPECT_LE(read(), (seconds + 0.05) * static_cast<double>(settings.read_bytes_per_second) + static_cast<double>(largest) + 1);
    // None is nearer over its radius than what came steps before. (At first the index of what is nearest is not here yet.)
    const float before_now = seconds > 0 ? farthest : 0;
    for (const StripPtr& strip : limited->active()) {
      if (!there.insert(strip->id).second || strip->tile.chunk->isTop()) continue;
      const float key = strip->tile.info().bounds.distance(at) / (settings.radius_m * std::pow(settings.growth, static_cast<float>(strip->id.level)));
      EXPECT_GE(key, before_now - 1e-5f) << strip->id.level << ":" << strip->id.tile;
      if (seconds > 0) farthest = std::max(farthest, key);
    }
  }
  EXPECT_GT(seconds, 1.7) << "it takes 2 s but for a burst and a strip";
  EXPECT_LT(seconds, 2.5);
  EXPECT_GT(limited->stats().reads_held, 20u);
  limited->update(at, {});
  std::set<formats::TileId> active;
  for (const StripPtr& strip : limited->active()) active.insert(strip->id);
  EXPECT_EQ(active, expected);
}

}  // namespace
}  // namespace ff::stream
