// A storage that counts how often one waits for it, as over a network: once for all that is brought together, and for each read of what neither was brought nor read before (by where
// it begins).
#pragma once
#include <atomic>
#include <mutex>
#include <set>

#include "formats/storage/read_only_storage.h"

namespace ff::formats {

class RoundTrips final : public ReadOnlyStorage {
 public:
  explicit RoundTrips(StoragePtr below) : below_(std::move(below)) {}
  // Of files with the index; reads whatever they wait for.
  std::atomic<uint64_t> trips = 0, reads = 0;

  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options) override {
    auto file = below_->open(path, options);
    if (!file || path.find(".index.") == std::string::npos) return file;
    return std::unique_ptr<StoredFile>(std::make_unique<File>(*this, std::move(*file)));
  }
  bool brings() const override { return true; }
  Result<bool> exists(const std::string& path) override { return below_->exists(path); }
  Result<std::string> version(const std::string& path, const ReadOptions& options) override { return below_->version(path, options); }

 private:
  class File final : public StoredFile {
   public:
    File(RoundTrips& storage, std::unique_ptr<StoredFile> below) : StoredFile(below->path()), storage_(storage), below_(std::move(below)) {}
    uint64_t bytes() const override { return below_->bytes(); }
    void bring(std::span<const Range> ranges, const ReadOptions&) const override {
      const std::lock_guard lock(mutex_);
      bool any = false;
      for (const Range& range : ranges) any = here_.insert(range.offset).second || any;
      storage_.trips += any;
    }

   private:
    Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const override {
      {
        const std::lock_guard lock(mutex_);
        storage_.trips += here_.insert(offset).second;
        ++storage_.reads;
      }
      return below_->read(offset, out, options);
    }
    RoundTrips& storage_;
    const std::unique_ptr<StoredFile> below_;
    mutable std::mutex mutex_;
    mutable std::set<uint64_t> here_;  // where what was read or brought begins
  };
  const StoragePtr below_;
};

}  // namespace ff::formats
