// Zeroed memory for matrices: aligned to huge pages, which are asked for where the system has them (a column every few
// KiB would otherwise need an address translation each).
#pragma once
#include <cstdlib>
#include <cstring>
#include <memory>
#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace ff::runtime {

template <class T>
class PageMemory {
 public:
  PageMemory() = default;
  // Null where there is too little memory.
  explicit PageMemory(size_t count) : bytes_((count * sizeof(T) + kPage - 1) / kPage * kPage) {
    memory_.reset(static_cast<T*>(std::aligned_alloc(kPage, bytes_)));
    if (!memory_) return;
#if defined(__linux__)
    (void)madvise(memory_.get(), bytes_, MADV_HUGEPAGE);
#endif
    std::memset(static_cast<void*>(memory_.get()), 0, bytes_);
  }
  explicit operator bool() const { return memory_ != nullptr; }
  T* data() { return memory_.get(); }
  const T* data() const { return memory_.get(); }

 private:
  static constexpr size_t kPage = size_t{2} << 20;
  struct Free {
    void operator()(T* p) const { std::free(p); }
  };
  size_t bytes_ = 0;
  std::unique_ptr<T, Free> memory_;
};

}  // namespace ff::runtime
