// What a bake puts aside because its memory has no room for it: blocks of bytes, packed; in memory at first, then in a file that has no name, and
// so is gone with the process however that ends.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "formats/storage/storage.h"

namespace ff::bake {

// Thrown where a spill's file fails (a full disk); caught by bakeWorld().
struct SpillFailed {
  Error error;
};

// Thread-safe.
class Spill {
 public:
  // path: of the file that is made once there are more than memory_bytes of blocks; others of the same name are none of its business.
  Spill(std::string path, uint64_t memory_bytes, formats::StoragePtr storage = formats::posixStorage());
  Spill(const Spill&) = delete;
  Spill& operator=(const Spill&) = delete;

  struct Block {
    uint64_t at = kHeld;              // offset in the file
    uint64_t packed_bytes = 0, bytes = 0;
    std::vector<std::byte> held{};    // where it is in memory: packed
    static constexpr uint64_t kHeld = ~uint64_t{0};
  };
  Block put(std::span<const std::byte> raw);
  std::vector<std::byte> get(const Block& block) const;

  uint64_t written() const;  // bytes of the file

 private:
  const std::string path_;
  const uint64_t memory_bytes_;
  const formats::StoragePtr storage_;
  mutable std::mutex mutex_;
  uint64_t held_ = 0, written_ = 0;
  std::unique_ptr<formats::NewFile> out_;
  std::unique_ptr<formats::StoredFile> in_;
};

}  // namespace ff::bake
