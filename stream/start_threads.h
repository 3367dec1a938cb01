// Threads of a room's own.
#pragma once
#include <system_error>
#include <thread>
#include <vector>

namespace ff::stream {

// Starts up to `wanted` threads. Where the system has no more, the ones that there are will do; throws std::system_error where there are none.
template <class Work>
void startThreads(std::vector<std::thread>& threads, int wanted, const Work& work) {
  threads.reserve(static_cast<size_t>(wanted));
  try {
    while (threads.size() < static_cast<size_t>(wanted)) threads.emplace_back(work);
  } catch (const std::system_error&) {
    if (threads.empty()) throw;
  }
}

}  // namespace ff::stream
