#include "tests/support/counted_memory.h"

#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <new>

namespace {

thread_local ff::MemoryCalls calls;
thread_local bool exempt = false;
std::atomic<uint32_t> refused_every = 0, asked = 0;

void* counted(std::size_t bytes, std::size_t alignment) {
  ++calls.allocated;
  calls.bytes += bytes;
  if (const uint32_t n = refused_every; n > 0 && !exempt && ++asked % n == 0) throw std::bad_alloc();
  void* const memory = alignment > alignof(std::max_align_t)
                           ? std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment)
                           : std::malloc(bytes > 0 ? bytes : 1);
  if (!memory) throw std::bad_alloc();
  return memory;
}

void release(void* memory) {
  if (!memory) return;
  ++calls.freed;
  std::free(memory);
}

}  // namespace

ff::MemoryCalls ff::memoryCalls() { return calls; }
void ff::refuseOthersEveryNth(uint32_t n) {
  exempt = true;
  refused_every = n;
}

// The other forms call these, by the standard; a sanitizer's own does not, so the one that drivers use is here as well.
void* operator new(std::size_t bytes) { return counted(bytes, 1); }
void* operator new(std::size_t bytes, std::align_val_t alignment) {
  return counted(bytes, static_cast<std::size_t>(alignment));
}
void* operator new(std::size_t bytes, const std::nothrow_t&) noexcept {
  try {
    return counted(bytes, 1);
  } catch (...) {
    return nullptr;
  }
}
void operator delete(void* memory) noexcept { release(memory); }
void operator delete(void* memory, std::size_t) noexcept { release(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { release(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { release(memory); }
