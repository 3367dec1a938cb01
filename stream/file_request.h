// A read on its way from a shard through io_uring: where the rest of it lies, and what became of it. Not thread-safe; one
// owner at a time.
#pragma once
#include <fcntl.h>

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "formats/read/reader.h"

namespace ff::stream {

// Tells the kernel, once a shard, that strips are read here and there: it would read much more around each of them else. Thread-safe.
class RandomReads {
 public:
  explicit RandomReads(const formats::World& world) : told_(world.shards().size()) {}
  void expect(uint32_t shard, const Result<int>& descriptor) {
    if (descriptor && *descriptor >= 0 && !told_[shard].exchange(true)) ::posix_fadvise(*descriptor, 0, 0, POSIX_FADV_RANDOM);
  }

 private:
  std::vector<std::atomic<bool>> told_;
};

class FileRequest {
 public:
  FileRequest(const formats::World& world, formats::TileId id, const formats::Extent& extent, const formats::ReadOptions& options, RandomReads& random)
      : world_(&world), id_(id), extent_(extent), descriptor_(world.descriptor(extent.shard)), options_(options), bytes_(extent.stored_bytes) {
    random.expect(extent.shard, descriptor_);
  }

  formats::TileId id() const { return id_; }
  int descriptor() const { return *descriptor_; }
  uint64_t offset() const { return extent_.offset + done_; }
  std::span<std::byte> remaining() { return std::span(bytes_).subspan(done_); }
  bool finished() const { return !descriptor_ || ended_ || failure_ != 0 || done_ == bytes_.size(); }
  // Whether there is nothing more to read, as its options have it, too.
  bool endsNow() {
    if (!finished()) ended_ = formats::whyReadEnds(options_);
    return finished();
  }

  // outcome: bytes read, 0 at the end of the file, or -errno.
  void advance(int64_t outcome) {
    if (outcome > 0)
      done_ += static_cast<size_t>(outcome);
    else
      failure_ = outcome == 0 ? kEndOfFile : static_cast<int>(-outcome);
  }

  Result<std::vector<std::byte>> take() {
    if (!descriptor_) return descriptor_.error();
    if (ended_) return Error{ErrorCode::kIo, world_->shards()[extent_.shard].name, "offset " + std::to_string(offset()), ended_, ""};
    if (failure_ == 0) return std::move(bytes_);
    return Error{
        failure_ == kEndOfFile ? ErrorCode::kInvalidFile : ErrorCode::kIo, world_->shards()[extent_.shard].name, "offset " + std::to_string(offset()),
        failure_ == kEndOfFile ? "the file ends here" : std::string("read: ") + std::strerror(failure_),
        failure_ == kEndOfFile ? "restore this file from a copy, or bake again" : "check the disk"};
  }

 private:
  static constexpr int kEndOfFile = -1;
  const formats::World* world_;
  formats::TileId id_;
  formats::Extent extent_;
  Result<int> descriptor_;  // of the shard
  formats::ReadOptions options_;
  std::vector<std::byte> bytes_;
  size_t done_ = 0;
  int failure_ = 0;  // errno
  const char* ended_ = nullptr;  // why it ended before it was done
};

}  // namespace ff::stream
