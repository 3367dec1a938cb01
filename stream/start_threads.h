// Threads of a room's own.
#pragma once
#include <pthread.h>
#include <sched.h>

#include <chrono>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace ff::stream {

// How a thread waits for what a frame asks of it: it looks, so that no frame has to wake it, which takes 10 to 30 us there and may cost it its core.
inline constexpr std::chrono::milliseconds kLook{1};
inline constexpr int kLooks = 250;  // in vain; then it sleeps until it is woken after all

// A thread that leaves a frame its core: woken, it waits for an idle one or for its turn, and takes none over (SCHED_BATCH of Linux). Its share of the cores is that of any other
// thread. Where whoever starts it has chosen a policy of scheduling, it has the same. Throws std::system_error where the system has no more threads.
template <class Work>
std::thread startThread(Work work) {
  return std::thread([work = std::move(work)]() mutable {
    sched_param parameters{};
    int policy = 0;
    if (pthread_getschedparam(pthread_self(), &policy, &parameters) == 0 && policy == SCHED_OTHER) (void)pthread_setschedparam(pthread_self(), SCHED_BATCH, &parameters);
    work();
  });
}

// Starts up to `wanted` threads. Where the system has no more, the ones that there are will do; throws std::system_error where there are none.
template <class Work>
void startThreads(std::vector<std::thread>& threads, int wanted, const Work& work) {
  threads.reserve(static_cast<size_t>(wanted));
  try {
    while (threads.size() < static_cast<size_t>(wanted)) threads.push_back(startThread(work));
  } catch (const std::system_error&) {
    if (threads.empty()) throw;
  }
}

}  // namespace ff::stream
