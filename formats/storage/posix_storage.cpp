#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "formats/storage/descriptor.h"
#include "formats/storage/storage.h"

namespace ff::formats {
namespace {

Error systemError(const std::string& path, const std::string& what) {
  return {ErrorCode::kIo, path, "", what + ": " + std::strerror(errno), ""};
}

class PosixFile final : public StoredFile {
 public:
  PosixFile(Descriptor fd, std::string path, uint64_t bytes) : StoredFile(std::move(path)), fd_(std::move(fd)), bytes_(bytes) {}
  uint64_t bytes() const override { return bytes_; }
  int descriptor() const override { return fd_.get(); }

 private:
  Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions&) const override {
    size_t done = 0;
    while (done < out.size()) {
      const ssize_t n = ::pread(fd_.get(), out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return systemError(path(), "cannot read at offset " + std::to_string(offset + done));
      if (n == 0) return endsEarly(offset + done);
      done += static_cast<size_t>(n);
    }
    return {};
  }

  Descriptor fd_;
  uint64_t bytes_;
};

class PosixNewFile final : public NewFile {
 public:
  PosixNewFile(Descriptor fd, std::string path) : fd_(std::move(fd)), path_(std::move(path)) {}
  Result<void> append(std::span<const std::byte> data) override {
    while (!data.empty()) {
      const ssize_t n = ::write(fd_.get(), data.data(), data.size());
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return systemError(path_, "cannot write");
      data = data.subspan(static_cast<size_t>(n));
    }
    return {};
  }
  Result<void> sync() override {
    while (::fsync(fd_.get()) != 0)
      if (errno != EINTR) return systemError(path_, "cannot sync");
    return {};
  }

 private:
  Descriptor fd_;
  std::string path_;
};

// A lock on a file beside the one that is claimed, which goes with the claim.
class PosixClaim final : public Claim {
 public:
  PosixClaim(Descriptor fd, std::string path) : fd_(std::move(fd)), path_(std::move(path)) {}
  ~PosixClaim() override { ::unlink(path_.c_str()); }

 private:
  Descriptor fd_;
  std::string path_;
};

class PosixStorage final : public Storage {
 public:
  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions&) override {
    Descriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (!fd) return systemError(path, "cannot open");
    struct stat s {};
    if (::fstat(fd.get(), &s) != 0) return systemError(path, "cannot read its size");
    if (!S_ISREG(s.st_mode)) return Error{ErrorCode::kIo, path, "", "is not a regular file", "name a world's .ffm file"};
    return std::unique_ptr<StoredFile>(std::make_unique<PosixFile>(std::move(fd), path, static_cast<uint64_t>(s.st_size)));
  }
  Result<std::unique_ptr<NewFile>> create(const std::string& path) override {
    Descriptor fd(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (!fd) return systemError(path, "cannot create");
    return std::unique_ptr<NewFile>(std::make_unique<PosixNewFile>(std::move(fd), path));
  }
  Result<void> rename(const std::string& from, const std::string& to) override {
    if (::rename(from.c_str(), to.c_str()) != 0) return systemError(to, "cannot rename");
    return {};
  }
  Result<void> remove(const std::string& path) override {
    if (::unlink(path.c_str()) != 0) return systemError(path, "cannot remove");
    return {};
  }
  Result<bool> exists(const std::string& path) override {
    if (::access(path.c_str(), F_OK) == 0) return true;
    if (errno == ENOENT || errno == ENOTDIR) return false;
    return systemError(path, "cannot be looked for");
  }
  Result<std::string> version(const std::string& path, const ReadOptions&) override {
    struct stat s {};
    if (::stat(path.c_str(), &s) != 0) return systemError(path, "cannot be looked at");
    std::string version;
    for (const auto part : {static_cast<int64_t>(s.st_dev), static_cast<int64_t>(s.st_ino), static_cast<int64_t>(s.st_size), static_cast<int64_t>(s.st_mtim.tv_sec),
                            static_cast<int64_t>(s.st_mtim.tv_nsec)})
      version += std::to_string(part) + ' ';
    return version;
  }
  Result<bool> syncFolder(const std::string& folder) override {
    const Descriptor fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!fd) return systemError(folder, "cannot open the folder");
    while (::fsync(fd.get()) != 0) {
      if (errno == EINTR) continue;
      if (errno == EINVAL || errno == ENOTSUP || errno == ENOSYS) return false;
      return systemError(folder, "cannot sync the folder");
    }
    return true;
  }
  Result<std::vector<std::string>> list(const std::string& folder) override {
    const std::unique_ptr<DIR, int (*)(DIR*)> dir(::opendir(folder.c_str()), ::closedir);
    if (!dir) return systemError(folder, "cannot list the folder");
    std::vector<std::string> names;
    while (const dirent* entry = ::readdir(dir.get())) names.emplace_back(entry->d_name);
    std::erase(names, ".");
    std::erase(names, "..");
    std::sort(names.begin(), names.end());
    return names;
  }
  Result<std::unique_ptr<Claim>> claim(const std::string& path) override {
    const std::string name = path + ".lock";
    for (;;) {
      Descriptor fd(::open(name.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
      if (!fd) return systemError(name, "cannot create");
      if (::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
        if (errno == EINTR) continue;
        if (errno != EWOULDBLOCK) return std::unique_ptr<Claim>(std::make_unique<PosixClaim>(std::move(fd), name));  // no locks here
        return Error{ErrorCode::kIo, path, "", "another program is writing it", "wait for its end, or name another output"};
      }
      struct stat locked {}, named {};  // another claim may just have gone, and its file with it
      if (::fstat(fd.get(), &locked) != 0) return systemError(name, "cannot be looked at");
      if (::stat(name.c_str(), &named) == 0 && named.st_ino == locked.st_ino)
        return std::unique_ptr<Claim>(std::make_unique<PosixClaim>(std::move(fd), name));
    }
  }
  Result<void> checkWritable(const std::string& folder) override {
    if (::access(folder.c_str(), W_OK | X_OK) != 0) return systemError(folder, "cannot write to this folder");
    return {};
  }
};

}  // namespace

StoragePtr posixStorage() {
  static const StoragePtr storage = std::make_shared<PosixStorage>();
  return storage;
}

}  // namespace ff::formats
