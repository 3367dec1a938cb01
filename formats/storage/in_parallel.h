// Waiting for several answers at once.
#pragma once
#include <algorithm>
#include <atomic>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

namespace ff::formats {

inline constexpr size_t kRequestsAtOnce = 16;

// work(k) for each k below n, on up to kRequestsAtOnce threads, of which this is one: on fewer where the system has no more. It must not throw.
template <class Work>
void inParallel(size_t n, const Work& work) {
  std::atomic<size_t> next = 0;
  const auto some = [&] {
    for (size_t k = 0; (k = next++) < n;) work(k);
  };
  std::vector<std::thread> threads;
  try {
    while (threads.size() + 1 < std::min(n, kRequestsAtOnce)) threads.emplace_back(some);
  } catch (const std::system_error&) {
  } catch (const std::bad_alloc&) {
  }
  some();
  for (std::thread& thread : threads) thread.join();
}

}  // namespace ff::formats
