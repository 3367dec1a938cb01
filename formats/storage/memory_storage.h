// Files in memory, for programs that keep worlds in packages of their own, and for tests: it knows what a power cut would
// leave. Folders are there as soon as they are named.
#pragma once
#include <map>
#include <mutex>
#include <set>

#include "formats/storage/storage.h"

namespace ff::formats {

class MemoryStorage final : public Storage {
 public:
  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options = {}) override;
  Result<std::unique_ptr<NewFile>> create(const std::string& path) override;
  Result<void> rename(const std::string& from, const std::string& to) override;
  Result<void> remove(const std::string& path) override;
  Result<bool> exists(const std::string& path) override;
  Result<std::string> version(const std::string& path, const ReadOptions& options = {}) override;
  Result<bool> syncFolder(const std::string& folder) override;
  Result<std::vector<std::string>> list(const std::string& folder) override;
  Result<std::unique_ptr<Claim>> claim(const std::string& path) override;
  Result<void> checkWritable(const std::string&) override { return {}; }

  // A disk may do more than it was asked to, in any order. Bytes are those of the last sync().
  enum class Unsynced {
    kNamesDropped,    // names are those of the last syncFolder()
    kNewestNameKept,  // the last renaming since then is there, none of those before it
    kNamesKept,       // all names are there
  };
  // What is left after a power cut now.
  std::shared_ptr<MemoryStorage> afterPowerCut(Unsynced unsynced) const;

 private:
  friend class MemoryNewFile;
  friend class MemoryClaim;
  using Bytes = std::vector<std::byte>;
  struct Inode {
    std::shared_ptr<Bytes> bytes = std::make_shared<Bytes>();
    std::shared_ptr<const Bytes> synced = bytes;
    bool held = true;  // others may hold `bytes`: it is copied before it grows
    uint64_t number = 0;  // of those made or emptied so far
  };
  using Names = std::map<std::string, std::shared_ptr<Inode>>;

  mutable std::mutex mutex_;
  Names names_, synced_names_;  // by path
  uint64_t made_ = 0;           // files, so far
  std::set<std::string> claimed_;
  std::string newest_;          // renamed to since the last syncFolder(); empty: none
};

}  // namespace ff::formats
