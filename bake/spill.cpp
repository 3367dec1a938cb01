#include "bake/spill.h"

#include <unistd.h>

#include <atomic>
#include <new>
#include <utility>

#include "bake/memory.h"
#include "bake/packing.h"

namespace ff::bake {
namespace {

// Of this process and no other: the file has the name for a moment only, but so may another's have.
std::string ownName(const std::string& path) {
  static std::atomic<uint64_t> made{0};
  return path + ".spill." + std::to_string(getpid()) + "-" + std::to_string(made++);
}

template <class Result>
Result orThrow(Result result) {
  if (result) return result;
  Error error = result.error();
  error.remedy = "make room on that disk, or give more --memory";
  throw SpillFailed{std::move(error)};
}

}  // namespace

Spill::Spill(std::string path, uint64_t memory_bytes, formats::StoragePtr storage)
    : path_(ownName(path)), memory_bytes_(memory_bytes), storage_(std::move(storage)) {}

Spill::Block Spill::put(std::span<const std::byte> raw) {
  Block block;
  block.held = packed(raw);
  if (block.held.empty()) throw std::bad_alloc();
  block.bytes = raw.size();
  block.packed_bytes = block.held.size();
  const std::lock_guard lock(mutex_);
  if (held_ + block.packed_bytes <= memory_bytes_) {
    held_ += block.packed_bytes;
    return block;
  }
  if (!in_) {
    out_ = std::move(*orThrow(storage_->create(path_)));
    in_ = std::move(*orThrow(storage_->open(path_)));
    (void)orThrow(storage_->remove(path_));
  }
  (void)orThrow(out_->append(block.held));
  release(block.held);
  block.at = std::exchange(written_, written_ + block.packed_bytes);
  return block;
}

std::vector<std::byte> Spill::get(const Block& block) const {
  std::vector<std::byte> read;
  if (block.at != Block::kHeld) {
    read.resize(block.packed_bytes);
    (void)orThrow(in_->read(block.at, read));
  }
  auto raw = unpacked(block.at == Block::kHeld ? block.held : read, block.bytes);
  if (!raw) throw SpillFailed{{ErrorCode::kIo, path_, "offset " + std::to_string(block.at), "what was put aside is damaged", "check that disk"}};
  return std::move(*raw);
}

uint64_t Spill::written() const {
  const std::lock_guard lock(mutex_);
  return written_;
}

}  // namespace ff::bake
