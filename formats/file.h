// A file descriptor that closes itself, and reading at an offset. Errors name the file and carry errno's text.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "formats/result.h"

namespace ff::formats {

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor();
  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

struct OpenFile {
  Descriptor descriptor;
  uint64_t bytes = 0;  // size when it was opened
};

// Regular files only.
Result<OpenFile> openForReading(const std::string& path);
// Fills `out` from `offset` on; thread-safe. A file that ends early is kInvalidFile.
Result<void> readAt(int descriptor, uint64_t offset, std::span<std::byte> out, const std::string& path);
Error systemError(const std::string& path, const std::string& what);

}  // namespace ff::formats
