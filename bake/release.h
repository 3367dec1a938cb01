// Memory that is needed no more goes back to the system, so that it does not count as the bake's.
#pragma once
#include <malloc.h>

namespace ff::bake {

// Empties a container and gives its memory back. (`v = {}` keeps it: that assigns a list of no elements.)
template <class Container>
void release(Container& c) {
  Container().swap(c);
}

// What was freed in small pieces as well. Takes a few milliseconds a GB.
inline void giveBackMemory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace ff::bake
