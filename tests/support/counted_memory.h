// Counts what each thread allocates and frees with operator new and delete, for tests of frame paths. The program that
// links counted_memory.cpp has its operators replaced.
#pragma once
#include <cstdint>

namespace ff {

struct MemoryCalls {
  uint64_t allocated = 0, freed = 0;
  uint64_t bytes = 0;  // allocated
};

// Calls of this thread so far.
MemoryCalls memoryCalls();

// From now on every n-th allocation of all other threads throws std::bad_alloc; 0: none does.
void refuseOthersEveryNth(uint32_t n);

}  // namespace ff
