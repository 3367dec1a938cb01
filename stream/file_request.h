// One strip on its way from a shard through io_uring: where the rest of it lies, and what became of it. Not thread-safe; one
// owner at a time.
#pragma once
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "formats/reader.h"

namespace ff::stream {

class FileRequest {
 public:
  FileRequest(const formats::World& world, formats::TileId id, const formats::ReadOptions& options)
      : world_(&world), info_(&world.tiles(id.level)[id.tile]), options_(options), bytes_(info_->stored_bytes) {}

  formats::TileId id() const { return info_->id; }
  int descriptor() const { return world_->shards()[info_->shard].descriptor; }
  uint64_t offset() const { return info_->offset + done_; }
  std::span<std::byte> remaining() { return std::span(bytes_).subspan(done_); }
  bool finished() const { return ended_ || failure_ != 0 || done_ == bytes_.size(); }
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
    if (ended_) return Error{ErrorCode::kIo, world_->shards()[info_->shard].name, "offset " + std::to_string(offset()), ended_, ""};
    if (failure_ == 0) return std::move(bytes_);
    return Error{
        failure_ == kEndOfFile ? ErrorCode::kInvalidFile : ErrorCode::kIo, world_->shards()[info_->shard].name, "offset " + std::to_string(offset()),
        failure_ == kEndOfFile ? "the file ends here" : std::string("read: ") + std::strerror(failure_),
        failure_ == kEndOfFile ? "restore this file from a copy, or bake again" : "check the disk"};
  }

 private:
  static constexpr int kEndOfFile = -1;
  const formats::World* world_;
  const formats::TileInfo* info_;
  formats::ReadOptions options_;
  std::vector<std::byte> bytes_;
  size_t done_ = 0;
  int failure_ = 0;  // errno
  const char* ended_ = nullptr;  // why it ended before it was done
};

}  // namespace ff::stream
