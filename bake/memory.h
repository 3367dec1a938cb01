// What memory there is, and how what is needed no more goes back to the system, so that it does not count as the bake's.
#pragma once
#include <cstdint>

namespace ff::bake {

// Memory that this process may still take, B: what the machine has free, or its control group, whichever is less.
uint64_t freeMemory();

// What it holds, B: all of it, and of that pages of files, which may leave at any time (paging.h).
struct ResidentMemory {
  uint64_t all = 0, files = 0;
};
ResidentMemory residentMemory();

// What it may still take of limit_bytes, or of what is free where that is 0, B; a little at least. Pages of files do not count as taken.
uint64_t spareMemory(uint64_t limit_bytes);

// Empties a container and gives its memory back. (`v = {}` keeps it: that assigns a list of no elements.)
template <class Container>
void release(Container& c) {
  Container().swap(c);
}

// What was freed in small pieces as well.
void giveBackMemory();

}  // namespace ff::bake
