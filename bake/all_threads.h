// Work that all threads share, taken piece by piece in its own order.
#pragma once
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

namespace ff::bake {

// f() once on each of TBB's threads.
template <class F>
void onAllThreads(F f) {
  tbb::parallel_for(0, tbb::this_task_arena::max_concurrency(), [&](int) { f(); }, tbb::simple_partitioner());
}

}  // namespace ff::bake
