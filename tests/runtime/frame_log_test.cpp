#include "runtime/frame_log.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace ff::runtime {
namespace {

// Against a list that is sorted.
TEST(FrameLog, TimesAreThoseOfTheFramesKept) {
  constexpr uint32_t kKept = 200;
  FrameLog log(kKept);
  EXPECT_EQ(log.times().max_ms, 0) << "no frame yet";
  std::mt19937 random(3);
  std::vector<float> all_ms;
  for (uint32_t frame = 1; frame <= 3 * kKept; ++frame) {
    all_ms.push_back(static_cast<float>(random() % 10000) * 0.001f);
    log.add(std::chrono::steady_clock::now(), static_cast<double>(all_ms.back()), {}, {}, {}, {});
    std::vector<float> kept_ms(all_ms.end() - std::min(frame, kKept), all_ms.end());
    std::ranges::sort(kept_ms);
    const FrameLog::Times times = log.times();
    ASSERT_EQ(times.p50_ms, static_cast<double>(kept_ms[kept_ms.size() / 2])) << frame;
    ASSERT_EQ(times.p99_ms, static_cast<double>(kept_ms[kept_ms.size() * 99 / 100])) << frame;
    ASSERT_EQ(times.max_ms, static_cast<double>(kept_ms.back())) << frame;
  }
}

}  // namespace
}  // namespace ff::runtime
