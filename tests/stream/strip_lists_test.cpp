#include "stream/strip_lists.h"

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <thread>

namespace ff::stream {
namespace {

// However others hold lists and let go of them meanwhile: a list that is given out is empty, nobody else has it, and what somebody holds stays as it is.
TEST(StripLists, AListIsEmptyAndOnesOwnWheneverOthersLetGo) {
  StripLists lists(4);
  std::mutex mutex;
  StripList handed;
  std::atomic<bool> stop = false;
  std::atomic<uint64_t> broken = 0;
  std::thread other([&] {
    StripList held;
    while (!stop) {
      {
        const std::lock_guard lock(mutex);
        held = handed;  // and lets go of the one before
      }
      if (held && held->size() != 3) ++broken;
    }
  });
  for (int turn = 0; turn < 1000000; ++turn) {
    const auto list = lists.next();
    ASSERT_TRUE(list->empty()) << "turn " << turn;
    for (int k = 0; k < 3; ++k) list->push_back(nullptr);
    {
      const std::lock_guard lock(mutex);
      handed = list;
    }
    if (turn % 3 == 0) lists.forgetIdle();
  }
  stop = true;
  other.join();
  EXPECT_EQ(broken, 0u);
}

TEST(StripLists, WhatNobodyHoldsLetsGoOfItsStrips) {
  StripLists lists(4);
  const auto strip = std::make_shared<const ResidentStrip>();
  StripList held = [&] {
    const auto list = lists.next();
    list->push_back(strip);
    return list;
  }();
  lists.forgetIdle();
  EXPECT_EQ(strip.use_count(), 2);
  held.reset();
  lists.forgetIdle();
  EXPECT_EQ(strip.use_count(), 1);
}

}  // namespace
}  // namespace ff::stream
