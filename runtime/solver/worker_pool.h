// Threads that live as long as the pool and share out the parts of one task at a time. Handing out a task takes no lock
// and no memory; idle threads spin for some microseconds, then sleep.
#pragma once
#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

namespace ff::runtime {

class WorkerPool {
 public:
  // threads: the caller of run() counts as one; 0 = all cores.
  explicit WorkerPool(int threads);
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int threads() const { return static_cast<int>(workers_.size()) + 1; }

  // Calls task(0) .. task(parts - 1), each once, on any of the threads; returns when all are done. Which thread takes
  // which part changes from run to run: a task whose parts write disjoint results is deterministic. One caller at a
  // time.
  template <class Task>
  void run(uint32_t parts, Task&& task) {
    runErased(
        parts, [](void* t, uint32_t part) { (*static_cast<std::remove_reference_t<Task>*>(t))(part); }, &task);
  }

 private:
  using Call = void (*)(void*, uint32_t);
  void runErased(uint32_t parts, Call call, void* task);
  void takeParts();
  void work();

  // Written by run() before it raises generation_, read by workers after they saw it.
  Call call_ = nullptr;
  void* task_ = nullptr;
  uint32_t parts_ = 0;
  bool stop_ = false;

  alignas(64) std::atomic<uint32_t> generation_{0};
  alignas(64) std::atomic<uint32_t> next_part_{0};
  alignas(64) std::atomic<uint32_t> busy_{0};
  std::vector<std::thread> workers_;
};

}  // namespace ff::runtime
