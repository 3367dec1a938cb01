// Where a world's files lie: all reading and writing of manifests, shards and settings goes through here. POSIX files, files behind a web
// server (http_storage.h), files in memory, and (in tests) a faulty one. Paths are whole paths with '/', or http:// and https:// addresses.
#pragma once
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "formats/result.h"

namespace ff::formats {

// What ends a read before it is done, with an error (kIo). Looked at before every piece of kReadPiece bytes: a piece that has begun is not
// interrupted, except over a network.
struct ReadOptions {
  const std::atomic<bool>* cancelled = nullptr;  // once it is true; outlives the read. Null: nobody cancels it.
  std::chrono::steady_clock::time_point deadline = std::chrono::steady_clock::time_point::max();
};
inline constexpr size_t kReadPiece = 1 << 20;
// Why a read ends now, as a message; null: it goes on. What waits looks every kLookAtOptions.
const char* whyReadEnds(const ReadOptions& options);
inline constexpr std::chrono::milliseconds kLookAtOptions{20};

// Open for reading until it is destroyed, whatever becomes of its name.
class StoredFile {
 public:
  explicit StoredFile(std::string path) : path_(std::move(path)) {}
  virtual ~StoredFile() = default;
  const std::string& path() const { return path_; }
  virtual uint64_t bytes() const = 0;  // when it was opened
  // Fills `out`, which is the caller's, from `offset` on. Thread-safe. Errors name the file and the offset: kIo; kInvalidFile where the file
  // ends early. `out` is unspecified then.
  Result<void> read(uint64_t offset, std::span<std::byte> out, const ReadOptions& options = {}) const;
  // For those who read with means of their own (io_uring); -1: there is none.
  virtual int descriptor() const { return -1; }
  // What was read from there is not what was once written: a storage that keeps copies drops these, so that the next read brings new ones.
  virtual void forget(uint64_t /*offset*/, uint64_t /*bytes*/) const {}
  // What will be read next. A storage that is slow to answer and keeps copies asks for all of it at once, and this waits until it is there, as the
  // options have it; all others do nothing. What fails is told by the reads. Thread-safe.
  struct Range {
    uint64_t offset = 0, bytes = 0;
  };
  virtual void bring(std::span<const Range> /*ranges*/, const ReadOptions& /*options*/ = {}) const {}
  // From now on reads follow each other through the file, by and large: such a storage then brings far more than is read. Thread-safe.
  virtual void expectAll() const {}

 protected:
  Error endsEarly(uint64_t offset) const;  // of a read past the end

 private:
  // The same for at most kReadPiece bytes, whose beginning `options` allow.
  virtual Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const = 0;

  const std::string path_;
};

// Open for writing; grows at its end. Not thread-safe.
class NewFile {
 public:
  virtual ~NewFile() = default;
  virtual Result<void> append(std::span<const std::byte> data) = 0;
  // What was appended survives a power cut from here on; its name needs Storage::syncFolder().
  virtual Result<void> sync() = 0;
};

// The right to write a file, which one has at a time; given up when it is destroyed, or the process ends in whatever way.
class Claim {
 public:
  virtual ~Claim() = default;
};

// Thread-safe. Errors name the path: kIo.
class Storage {
 public:
  virtual ~Storage() = default;
  // Regular files only. options: as those of a read, where opening takes time (over a network).
  virtual Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options = {}) = 0;
  // Empties a file that is there.
  virtual Result<std::unique_ptr<NewFile>> create(const std::string& path) = 0;
  // In one step; takes the place of a file that is there.
  virtual Result<void> rename(const std::string& from, const std::string& to) = 0;
  virtual Result<void> remove(const std::string& path) = 0;
  // Names come, went and changed in the folder survive a power cut from here on. Where a file system has no such thing
  // (some that are on a network or in user space), does nothing and says false.
  virtual Result<bool> syncFolder(const std::string& folder) = 0;
  virtual Result<bool> exists(const std::string& path) = 0;
  // Tells the file that is there from any other that takes its place, by one look at it (over a network: one request, for a byte or, where it is asked for again, for nothing if it is the same). Opaque.
  virtual Result<std::string> version(const std::string& path, const ReadOptions& options = {}) = 0;
  // Names of the files in a folder, ascending.
  virtual Result<std::vector<std::string>> list(const std::string& folder) = 0;
  // Errors: another has claimed it. Where a file system has no locks, none is told.
  virtual Result<std::unique_ptr<Claim>> claim(const std::string& path) = 0;
  // Whether files can be made there.
  virtual Result<void> checkWritable(const std::string& folder) = 0;
  // Whether StoredFile::bring() of its files does anything.
  virtual bool brings() const { return false; }
  // What went wrong without being an error, as one line for the user; empty: nothing.
  virtual std::string warning() const { return {}; }
};

using StoragePtr = std::shared_ptr<Storage>;
StoragePtr posixStorage();
// Which storage a path belongs to: http:// and https:// to web servers, through a cache on the disk (http_storage.h), all else to POSIX. One of
// each kind in a process.
StoragePtr storageFor(const std::string& path);

// "out/" of "out/town.ffm"; "./" where the path has no folder.
std::string folderOf(const std::string& path);
std::string fileNameOf(const std::string& path);

Result<std::vector<std::byte>> readWholeFile(Storage& storage, const std::string& path);
// Under a temporary name, synced, renamed, its folder synced: afterwards there is all of it, and before there is what was there.
Result<void> writeWholeFile(Storage& storage, const std::string& path, std::span<const std::byte> bytes);

}  // namespace ff::formats
