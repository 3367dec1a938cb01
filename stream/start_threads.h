// Threads of a room's own.
#pragma once
#include <pthread.h>
#include <sched.h>

#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace ff::stream {

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
