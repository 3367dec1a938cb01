#include "formats/storage/memory_storage.h"

#include <algorithm>
#include <utility>

namespace ff::formats {
namespace {

std::string plain(std::string path) {
  while (path.starts_with("./")) path.erase(0, 2);
  return path;
}

Error absent(const std::string& path) { return {ErrorCode::kIo, path, "", "there is no such file in memory", ""}; }

class MemoryFile final : public StoredFile {
 public:
  MemoryFile(std::string path, std::shared_ptr<const std::vector<std::byte>> bytes) : StoredFile(std::move(path)), bytes_(std::move(bytes)) {}
  uint64_t bytes() const override { return bytes_->size(); }

 private:
  Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions&) const override {
    if (offset > bytes_->size() || out.size() > bytes_->size() - offset) return endsEarly(bytes_->size());
    std::copy_n(bytes_->begin() + static_cast<std::ptrdiff_t>(offset), out.size(), out.begin());
    return {};
  }

  std::shared_ptr<const std::vector<std::byte>> bytes_;
};

}  // namespace

class MemoryNewFile final : public NewFile {
 public:
  MemoryNewFile(MemoryStorage& storage, std::shared_ptr<MemoryStorage::Inode> inode) : storage_(storage), inode_(std::move(inode)) {}
  Result<void> append(std::span<const std::byte> data) override {
    const std::lock_guard lock(storage_.mutex_);
    if (std::exchange(inode_->held, false)) inode_->bytes = std::make_shared<MemoryStorage::Bytes>(*inode_->bytes);
    inode_->bytes->insert(inode_->bytes->end(), data.begin(), data.end());
    return {};
  }
  Result<void> sync() override {
    const std::lock_guard lock(storage_.mutex_);
    inode_->synced = inode_->bytes;
    inode_->held = true;
    return {};
  }

 private:
  MemoryStorage& storage_;
  std::shared_ptr<MemoryStorage::Inode> inode_;
};

class MemoryClaim final : public Claim {
 public:
  MemoryClaim(MemoryStorage& storage, std::string path) : storage_(storage), path_(std::move(path)) {}
  ~MemoryClaim() override {
    const std::lock_guard lock(storage_.mutex_);
    storage_.claimed_.erase(path_);
  }

 private:
  MemoryStorage& storage_;
  const std::string path_;
};

Result<std::unique_ptr<StoredFile>> MemoryStorage::open(const std::string& path, const ReadOptions&) {
  const std::lock_guard lock(mutex_);
  const auto found = names_.find(plain(path));
  if (found == names_.end()) return absent(path);
  found->second->held = true;
  return std::unique_ptr<StoredFile>(std::make_unique<MemoryFile>(path, found->second->bytes));
}

Result<std::unique_ptr<NewFile>> MemoryStorage::create(const std::string& path) {
  const std::lock_guard lock(mutex_);
  std::shared_ptr<Inode>& inode = names_[plain(path)];
  if (!inode) inode = std::make_shared<Inode>();
  inode->bytes = std::make_shared<Bytes>();
  inode->number = ++made_;
  return std::unique_ptr<NewFile>(std::make_unique<MemoryNewFile>(*this, inode));
}

Result<void> MemoryStorage::rename(const std::string& from, const std::string& to) {
  const std::lock_guard lock(mutex_);
  const auto found = names_.find(plain(from));
  if (found == names_.end()) return absent(from);
  std::shared_ptr<Inode> inode = found->second;
  names_.erase(found);
  newest_ = plain(to);
  names_[newest_] = std::move(inode);
  return {};
}

Result<void> MemoryStorage::remove(const std::string& path) {
  const std::lock_guard lock(mutex_);
  if (names_.erase(plain(path)) == 0) return absent(path);
  return {};
}

Result<bool> MemoryStorage::exists(const std::string& path) {
  const std::lock_guard lock(mutex_);
  return names_.contains(plain(path));
}

Result<std::string> MemoryStorage::version(const std::string& path, const ReadOptions&) {
  const std::lock_guard lock(mutex_);
  const auto found = names_.find(plain(path));
  if (found == names_.end()) return absent(path);
  return std::to_string(found->second->number) + ' ' + std::to_string(found->second->bytes->size());
}

Result<bool> MemoryStorage::syncFolder(const std::string& folder) {
  const std::lock_guard lock(mutex_);
  const auto inside = [&](const auto& name) { return plain(folderOf(name.first)) == plain(folder); };
  std::erase_if(synced_names_, inside);
  for (const auto& name : names_)
    if (inside(name)) synced_names_.insert(name);
  newest_.clear();
  return true;
}

Result<std::vector<std::string>> MemoryStorage::list(const std::string& folder) {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names;
  for (const auto& [path, inode] : names_)
    if (plain(folderOf(path)) == plain(folder)) names.push_back(fileNameOf(path));
  return names;
}

Result<std::unique_ptr<Claim>> MemoryStorage::claim(const std::string& path) {
  const std::lock_guard lock(mutex_);
  if (!claimed_.insert(plain(path)).second) return Error{ErrorCode::kIo, path, "", "another writer has claimed it", ""};
  return std::unique_ptr<Claim>(std::make_unique<MemoryClaim>(*this, plain(path)));
}

std::shared_ptr<MemoryStorage> MemoryStorage::afterPowerCut(Unsynced unsynced) const {
  const std::lock_guard lock(mutex_);
  auto left = std::make_shared<MemoryStorage>();
  Names names = unsynced == Unsynced::kNamesKept ? names_ : synced_names_;
  if (unsynced == Unsynced::kNewestNameKept && names_.contains(newest_)) names[newest_] = names_.at(newest_);
  for (const auto& [path, inode] : names) {
    auto kept = std::make_shared<Inode>();
    kept->bytes = std::make_shared<Bytes>(*inode->synced);
    kept->synced = kept->bytes;
    left->names_[path] = std::move(kept);
  }
  left->synced_names_ = left->names_;
  return left;
}

}  // namespace ff::formats
