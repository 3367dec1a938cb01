// Storage that fails when it is told to: the n-th call, once or from then on, as if the process had been killed there.
#pragma once
#include <atomic>
#include <functional>

#include "formats/storage/storage.h"

namespace ff::formats {

class FaultyStorage final : public Storage {
 public:
  explicit FaultyStorage(StoragePtr below) : below_(std::move(below)) {}

  std::atomic<uint64_t> calls = 0;
  uint64_t fail_at = ~uint64_t{0};  // number of the call
  bool for_ever = false;            // and all that follow
  std::atomic<bool> outage = false; // all calls fail while it lasts
  bool folders_can_sync = true;
  std::function<void()> on_read{};  // with every piece that is read: to take its time, for one

  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options = {}) override {
    if (fails()) return fault(path);
    auto file = below_->open(path, options);
    if (!file) return file.error();
    return std::unique_ptr<StoredFile>(std::make_unique<File>(*this, path, std::move(*file)));
  }
  Result<std::unique_ptr<NewFile>> create(const std::string& path) override {
    if (fails()) return fault(path);
    auto file = below_->create(path);
    if (!file) return file.error();
    return std::unique_ptr<NewFile>(std::make_unique<Writing>(*this, path, std::move(*file)));
  }
  Result<void> rename(const std::string& from, const std::string& to) override {
    if (fails()) return fault(to);
    return below_->rename(from, to);
  }
  Result<void> remove(const std::string& path) override {
    if (fails()) return fault(path);
    return below_->remove(path);
  }
  Result<bool> exists(const std::string& path) override {
    if (fails()) return fault(path);
    return below_->exists(path);
  }
  Result<std::string> version(const std::string& path, const ReadOptions& options = {}) override {
    if (fails()) return fault(path);
    return below_->version(path, options);
  }
  Result<bool> syncFolder(const std::string& folder) override {
    if (fails()) return fault(folder);
    return folders_can_sync ? below_->syncFolder(folder) : Result<bool>(false);
  }
  Result<std::vector<std::string>> list(const std::string& folder) override {
    if (fails()) return fault(folder);
    return below_->list(folder);
  }
  Result<std::unique_ptr<Claim>> claim(const std::string& path) override {
    if (fails()) return fault(path);
    return below_->claim(path);
  }
  Result<void> checkWritable(const std::string& folder) override {
    if (fails()) return fault(folder);
    return below_->checkWritable(folder);
  }

 private:
  class File final : public StoredFile {
   public:
    File(FaultyStorage& storage, std::string path, std::unique_ptr<StoredFile> below)
        : StoredFile(std::move(path)), storage_(storage), below_(std::move(below)) {}
    uint64_t bytes() const override { return below_->bytes(); }

   private:
    Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions&) const override {
      if (storage_.fails()) return fault(path(), "offset " + std::to_string(offset));
      if (storage_.on_read) storage_.on_read();
      return below_->read(offset, out);
    }

    FaultyStorage& storage_;
    std::unique_ptr<StoredFile> below_;
  };
  class Writing final : public NewFile {
   public:
    Writing(FaultyStorage& storage, std::string path, std::unique_ptr<NewFile> below)
        : storage_(storage), path_(std::move(path)), below_(std::move(below)) {}
    // The disk is full after half of it.
    Result<void> append(std::span<const std::byte> data) override {
      if (!storage_.fails()) return below_->append(data);
      (void)below_->append(data.first(data.size() / 2));
      return fault(path_);
    }
    Result<void> sync() override {
      if (storage_.fails()) return fault(path_);
      return below_->sync();
    }

   private:
    FaultyStorage& storage_;
    std::string path_;
    std::unique_ptr<NewFile> below_;
  };

  bool fails() {
    const uint64_t call = calls++;
    return outage || (for_ever ? call >= fail_at : call == fail_at);
  }
  static Error fault(const std::string& path, const std::string& place = "") {
    return {ErrorCode::kIo, path, place, "a fault that a test wants", ""};
  }

  StoragePtr below_;
};

}  // namespace ff::formats
