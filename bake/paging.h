// Arrays as long as the world, where memory has no room for them: files without a name, mapped, whose pages the system reads and writes as they are
// touched. Code that works on them works on arrays; what comes next to each other in the world lies next to each other in them, so that few pages are in use
// at a time.
#pragma once
#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <string>
#include <vector>

namespace ff::bake {

// While one lives, large arrays that are made are files once those in memory come to a sixteenth of the limit, and no more of their pages are held than what
// the process holds besides leaves room for. Several may live; the smallest limit counts. Where the disk is full, arrays throw SpillFailed (spill.h) as they are made.
class Paging {
 public:
  // folder: of the files. limit_bytes: most that the process is to hold; 0: what it holds and what is free now.
  Paging(std::string folder, uint64_t limit_bytes);
  ~Paging();
  Paging(const Paging&) = delete;
  Paging& operator=(const Paging&) = delete;
};

// Whether one lives.
bool isPaging();

inline constexpr size_t kPagedBytes = size_t{1} << 20;  // smaller arrays are always in memory

// Of arrays that are files, whole, and of UnnamedFiles, B: at present, and the most since the first Paging that lives began.
struct PagedBytes {
  uint64_t now = 0, most = 0;
};
PagedBytes pagedBytes();

// At least kPagedBytes; aligned to a page. Thread-safe.
void* allocateLarge(size_t bytes);
void freeLarge(void* at, size_t bytes) noexcept;

// A file that no folder names, in that of the Paging that lives; gone with the process however that ends. Throws SpillFailed.
class UnnamedFile {
 public:
  UnnamedFile();
  ~UnnamedFile();
  UnnamedFile(const UnnamedFile&) = delete;
  UnnamedFile& operator=(const UnnamedFile&) = delete;

  void append(std::span<const std::byte> bytes);
  // Fills out with what was appended there. Thread-safe, but for append().
  void read(uint64_t at, std::span<std::byte> out) const;

 private:
  std::string folder_;
  int file_;
  uint64_t bytes_ = 0;
};

template <class T>
struct PagedAllocator {
  using value_type = T;
  PagedAllocator() = default;
  template <class U>
  PagedAllocator(const PagedAllocator<U>&) noexcept {}

  T* allocate(size_t n) {
    if (n > ~size_t{0} / sizeof(T)) throw std::bad_array_new_length();
    const size_t bytes = n * sizeof(T);
    return static_cast<T*>(bytes < kPagedBytes ? ::operator new(bytes, std::align_val_t(alignof(T))) : allocateLarge(bytes));
  }
  void deallocate(T* at, size_t n) noexcept {
    const size_t bytes = n * sizeof(T);
    if (bytes < kPagedBytes) ::operator delete(at, std::align_val_t(alignof(T)));
    else freeLarge(at, bytes);
  }
  template <class U>
  friend bool operator==(const PagedAllocator&, const PagedAllocator<U>&) noexcept {
    return true;
  }
};

template <class T>
using PagedVector = std::vector<T, PagedAllocator<T>>;

}  // namespace ff::bake
