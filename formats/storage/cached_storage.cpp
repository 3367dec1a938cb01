#include "formats/storage/cached_storage.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <mutex>
#include <set>

#include "formats/codec/checksum.h"
#include "formats/storage/descriptor.h"
#include "formats/storage/in_parallel.h"
#include "formats/storage/piece_memory.h"
#include "formats/storage/read_only_storage.h"

namespace ff::formats {
namespace {

constexpr uint64_t kHeaderBytes = 4096, kSlotBytes = sizeof(uint64_t) + kCachePiece;
constexpr const char* kEnding = ".pieces";
constexpr uint64_t kOpening = ~uint64_t{0};  // claimed like a piece by who opens the file below
constexpr uint64_t kRunPieces = 4;           // that one request brings where many are under way together
constexpr uint64_t kMaxBrought = 128;        // pieces at once: half of the memory, where there is no folder
constexpr uint64_t kAheadPieces = 64;        // of a file that is read from its beginning to its end
constexpr uint64_t kFollowingPieces = 16;    // so near behind what was brought ahead a read follows it

struct Header {
  uint64_t checksum = 0;  // of what follows
  std::array<char, 8> magic{'F', 'F', 'P', 'I', 'E', 'C', 'E', '1'};
  uint64_t bytes = 0;     // of the file
  std::array<char, kHeaderBytes - 24> path{};
  uint64_t sum() const { return hashBytes(std::as_bytes(std::span(this, 1)).subspan(sizeof checksum)); }
};
static_assert(sizeof(Header) == kHeaderBytes);

// "town.0123456789abcdef.ffs"
bool tellsItsContent(const std::string& name) {
  constexpr size_t kDigits = 16, kRest = 4;
  return name.size() > kDigits + kRest && name.ends_with(".ffs") && name[name.size() - kRest - kDigits - 1] == '.' &&
         name.find_first_not_of("0123456789abcdef", name.size() - kRest - kDigits) == name.size() - kRest;
}

// The folder, as all files of the cache see it. Thread-safe.
class CacheFolder {
 public:
  explicit CacheFolder(const CacheSettings& settings) : settings_(settings), off_(settings.folder.empty()), warning_(settings.warning) {}

  bool off() const { return off_; }
  std::string warning() const {
    const std::lock_guard lock(mutex_);
    return warning_;
  }
  // With errno. The first reason counts.
  void turnOff() {
    const std::string why = std::strerror(errno);
    const std::lock_guard lock(mutex_);
    if (!off_.exchange(true))
      warning_ = settings_.folder + ": what is read of worlds behind web servers is no longer kept here: " + why + "; name another folder in FORMFIELD_CACHE, or \"off\"";
  }
  // For the pieces of the file of that path. No descriptor: the cache is off.
  Descriptor open(const std::string& path) {
    if (off_ || path.size() >= Header().path.size()) return Descriptor(-1);
    std::error_code failed;
    std::filesystem::create_directories(settings_.folder, failed);
    constexpr const char* kHex = "0123456789abcdef";
    std::string name = settings_.folder + "/";
    const uint64_t hash = hashBytes(std::as_bytes(std::span(path)));
    for (int shift = 60; shift >= 0; shift -= 4) name += kHex[hash >> shift & 15];
    Descriptor fd(::open((name + kEnding).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    if (!fd) turnOff();
    if (fd) ::futimens(fd.get(), nullptr);
    return fd;
  }
  // Another piece was written.
  void grown() {
    if (written_.fetch_add(kSlotBytes) >= settings_.limit_bytes / 16) written_ = 0, trim();
  }
  // What is used least goes. Files are emptied where they lie, since other processes may have them open, and removed when they have been empty for a day.
  void trim() {
    struct Kept {
      std::string path;
      struct timespec opened;
      uint64_t bytes;
    };
    std::vector<Kept> kept;
    uint64_t bytes = 0;
    const std::unique_ptr<DIR, int (*)(DIR*)> folder(::opendir(settings_.folder.c_str()), ::closedir);
    while (const dirent* entry = folder ? ::readdir(folder.get()) : nullptr) {
      struct stat s {};
      const std::string path = settings_.folder + "/" + entry->d_name;
      if (!path.ends_with(kEnding) || ::stat(path.c_str(), &s) != 0) continue;
      kept.push_back({path, s.st_mtim, static_cast<uint64_t>(s.st_blocks) * 512});
      bytes += kept.back().bytes;
      if (s.st_size == 0 && s.st_mtim.tv_sec + 86400 < ::time(nullptr)) ::unlink(path.c_str());
    }
    std::ranges::sort(kept, {}, [](const Kept& k) { return std::pair(k.opened.tv_sec, k.opened.tv_nsec); });
    for (const Kept& k : kept) {
      if (bytes <= settings_.limit_bytes) return;
      if (::truncate(k.path.c_str(), 0) == 0) bytes -= k.bytes;
    }
  }

 private:
  const CacheSettings settings_;
  std::atomic<bool> off_;
  std::atomic<uint64_t> written_{~uint64_t{0} / 2};  // since the last trim(): the first piece trims
  mutable std::mutex mutex_;
  std::string warning_;
};

class CachedFile final : public StoredFile {
 public:
  // fd: of the folder's file; none: pieces are kept in memory. file: null: opened when it is needed, of storage.
  CachedFile(std::string path, std::shared_ptr<CacheFolder> folder, std::shared_ptr<PieceMemory> memory, Descriptor fd, uint64_t bytes, StoragePtr storage,
             std::unique_ptr<StoredFile> file)
      : StoredFile(std::move(path)), folder_(std::move(folder)), memory_(std::move(memory)), fd_(std::move(fd)), bytes_(bytes), storage_(std::move(storage)),
        file_(std::move(file)), known_by_(hashBytes(std::as_bytes(std::span(this->path())))) {}
  uint64_t bytes() const override { return bytes_; }

  void forget(uint64_t offset, uint64_t bytes) const override {
    const uint64_t first = offset / kCachePiece, end = (offset + bytes + kCachePiece - 1) / kCachePiece, none = 0;
    memory_->forget({known_by_, first}, {known_by_, end});
    if (!onDisk()) return;
    if (bytes >= bytes_ && ::ftruncate(fd_.get(), 0) != 0) folder_->turnOff();
    for (uint64_t piece = first; piece < end && bytes < bytes_; ++piece)
      if (::pwrite(fd_.get(), &none, sizeof none, slot(piece)) != sizeof none) folder_->turnOff();
  }

  void bring(std::span<const Range> ranges, const ReadOptions& options) const override try {
    std::vector<uint64_t> pieces;
    for (const Range& range : ranges)
      for (uint64_t piece = range.offset / kCachePiece; piece * kCachePiece < std::min(range.offset + range.bytes, bytes_) && pieces.size() < kMaxBrought; ++piece)
        if (pieces.empty() || pieces.back() != piece) pieces.push_back(piece);
    std::ranges::sort(pieces);
    pieces.erase(std::unique(pieces.begin(), pieces.end()), pieces.end());
    bringPieces(pieces, options);
  } catch (const std::bad_alloc&) {  // the reads bring it
  }

  void expectAll() const override { all_ = true; }

 private:
  // What its owner reads from below, and nobody else. Thread-safe.
  class Claims {
   public:
    explicit Claims(const CachedFile& file) : file_(file) {}
    ~Claims() { release(0, ~uint64_t{0}); }
    // False: another has it.
    bool add(uint64_t piece) {
      const std::lock_guard lock(file_.mutex_);
      return take(piece);
    }
    // Waits while another has it; false: no longer, as the options say. For owners who have none: else two could wait for each other.
    bool await(uint64_t piece, const ReadOptions& options) {
      for (std::unique_lock lock(file_.mutex_); !take(piece); file_.released_.wait_for(lock, kLookAtOptions))
        if (whyReadEnds(options)) return false;
      return true;
    }
    void release(uint64_t first, uint64_t last) {
      const std::lock_guard lock(file_.mutex_);
      std::erase_if(pieces_, [&](uint64_t piece) { return piece >= first && piece <= last && file_.claimed_.erase(piece); });
      file_.released_.notify_all();
    }

   private:
    bool take(uint64_t piece) {
      pieces_.reserve(pieces_.size() + 1);
      if (!file_.claimed_.insert(piece).second) return false;
      pieces_.push_back(piece);
      return true;
    }
    const CachedFile& file_;
    std::vector<uint64_t> pieces_;
  };

  static off_t slot(uint64_t piece) { return static_cast<off_t>(kHeaderBytes + piece * kSlotBytes); }
  bool onDisk() const { return fd_ && !folder_->off(); }

  Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const override {
    if (offset > bytes_ || out.size() > bytes_ - offset) return endsEarly(bytes_);
    const uint64_t end = offset + out.size();
    std::vector<std::byte> run, other;  // whole pieces
    for (uint64_t piece = offset / kCachePiece, next = 0; piece * kCachePiece < end; piece = next) {
      if (all_) bringAhead(piece, options);
      Claims claims(*this);
      if (!claims.await(piece, options)) return ended(offset, options);
      const uint64_t first = piece * kCachePiece;
      next = piece + 1;
      if (!load(piece, run)) {
        while (next * kCachePiece < end && claims.add(next) && !load(next, other)) ++next;
        if (auto ok = fetch(piece, next, run, options); !ok) return ok;
      }
      const uint64_t from = std::max(offset, first), to = std::min(end, first + run.size());
      std::copy_n(run.begin() + static_cast<std::ptrdiff_t>(from - first), to - from, out.begin() + static_cast<std::ptrdiff_t>(from - offset));
    }
    return {};
  }

  // Reads pieces from below, which their reader has claimed, and keeps them.
  Result<void> fetch(uint64_t piece, uint64_t end, std::vector<std::byte>& run, const ReadOptions& options) const {
    run.resize(std::min(end * kCachePiece, bytes_) - piece * kCachePiece);
    if (auto ok = readBelow(piece * kCachePiece, run, options); !ok) return ok;
    for (uint64_t p = piece; p < end; ++p) keep(p, std::span(run).subspan((p - piece) * kCachePiece, bytesOf(p)));
    return {};
  }

  // Those that are neither here nor on their way, all requests at once.
  void bringPieces(std::span<const uint64_t> pieces, const ReadOptions& options) const {
    struct Run {
      uint64_t piece, end;
    };
    std::vector<Run> runs;
    Claims claims(*this);
    for (const uint64_t piece : pieces) {
      if (!claims.add(piece)) continue;
      if (has(piece))
        claims.release(piece, piece);
      else if (!runs.empty() && runs.back().end == piece && piece - runs.back().piece < kRunPieces)
        ++runs.back().end;
      else
        runs.push_back({piece, piece + 1});
    }
    inParallel(runs.size(), [&](size_t k) {
      try {
        std::vector<std::byte> bytes;
        (void)fetch(runs[k].piece, runs[k].end, bytes, options);
      } catch (const std::bad_alloc&) {
      }
      claims.release(runs[k].piece, runs[k].end - 1);
    });
  }

  // Before this piece is read, of a file that is read as a whole.
  void bringAhead(uint64_t piece, const ReadOptions& options) const try {
    if (has(piece)) return;
    const uint64_t ahead = ahead_;
    const bool follows = piece >= ahead && piece < ahead + kFollowingPieces;
    ahead_ = piece + (follows ? kAheadPieces : 1);
    if (!follows) return;
    std::vector<uint64_t> pieces;
    for (uint64_t p = piece; p < piece + kAheadPieces && p * kCachePiece < bytes_; ++p) pieces.push_back(p);
    bringPieces(pieces, options);
  } catch (const std::bad_alloc&) {
  }

  Result<void> readBelow(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const {
    if (!opened_) {
      Claims claims(*this);
      if (!claims.await(kOpening, options)) return ended(offset, options);
      if (!file_) {
        auto opened = storage_->open(path(), options);
        if (!opened) return opened.error();
        if ((*opened)->bytes() != bytes_) {
          forget(0, bytes_);
          return Error{ErrorCode::kIo, path(), "", "has changed on the server since it was kept in the cache", "open the world again"};
        }
        file_ = std::move(*opened);
      }
      opened_ = true;
    }
    return file_->read(offset, out, options);
  }

  Error ended(uint64_t offset, const ReadOptions& options) const { return {ErrorCode::kIo, path(), "offset " + std::to_string(offset), whyReadEnds(options), ""}; }
  size_t bytesOf(uint64_t piece) const { return static_cast<size_t>(std::min(kCachePiece, bytes_ - piece * kCachePiece)); }
  // False: it is not there, or damaged.
  bool load(uint64_t piece, std::vector<std::byte>& bytes) const {
    if (!onDisk()) {
      const PieceMemory::Bytes kept = memory_->find({known_by_, piece});
      if (kept) bytes = *kept;
      return kept != nullptr;
    }
    uint64_t checksum = 0;
    bytes.resize(bytesOf(piece));
    const iovec parts[] = {{&checksum, sizeof checksum}, {bytes.data(), bytes.size()}};
    return ::preadv(fd_.get(), parts, 2, slot(piece)) == static_cast<ssize_t>(sizeof checksum + bytes.size()) && checksum == hashBytes(bytes);
  }
  // Without a look at its bytes, which may be damaged.
  bool has(uint64_t piece) const {
    if (!onDisk()) return memory_->find({known_by_, piece}) != nullptr;
    uint64_t checksum = 0;
    return ::pread(fd_.get(), &checksum, sizeof checksum, slot(piece)) == sizeof checksum && checksum != 0;
  }
  void keep(uint64_t piece, std::span<std::byte> bytes) const {
    if (onDisk()) {
      uint64_t checksum = hashBytes(bytes);
      const iovec parts[] = {{&checksum, sizeof checksum}, {bytes.data(), bytes.size()}};
      errno = ENOSPC;  // where only a part is written
      if (::pwritev(fd_.get(), parts, 2, slot(piece)) == static_cast<ssize_t>(sizeof checksum + bytes.size())) return folder_->grown();
      folder_->turnOff();
    }
    memory_->keep({known_by_, piece}, bytes);
  }

  const std::shared_ptr<CacheFolder> folder_;
  const std::shared_ptr<PieceMemory> memory_;
  const Descriptor fd_;
  const uint64_t bytes_;
  const StoragePtr storage_;
  mutable std::mutex mutex_;  // guards claimed_
  mutable std::condition_variable released_;
  mutable std::set<uint64_t> claimed_;
  mutable std::unique_ptr<StoredFile> file_;  // of who has claimed kOpening, until opened_
  mutable std::atomic<bool> opened_{false};
  const uint64_t known_by_;  // in memory
  mutable std::atomic<bool> all_{false};
  mutable std::atomic<uint64_t> ahead_{1};  // the piece behind what was brought ahead
};

class CachedStorage final : public ReadOnlyStorage {
 public:
  CachedStorage(StoragePtr below, const CacheSettings& settings)
      : below_(std::move(below)), folder_(std::make_shared<CacheFolder>(settings)), memory_(std::make_shared<PieceMemory>(settings.memory_bytes)) {}

  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options) override {
    if (!tellsItsContent(fileNameOf(path))) return below_->open(path, options);
    Descriptor fd = folder_->open(path);
    auto header = std::make_unique<Header>();
    std::unique_ptr<StoredFile> file;
    if (!fd) {
      auto opened = below_->open(path, options);
      if (!opened) return opened.error();
      file = std::move(*opened);
      header->bytes = file->bytes();
    } else if (::pread(fd.get(), header.get(), sizeof(Header), 0) != sizeof(Header) || header->checksum != header->sum() || header->magic != Header().magic ||
        path != header->path.data()) {
      auto opened = below_->open(path, options);
      if (!opened) return opened.error();
      file = std::move(*opened);
      *header = {.bytes = file->bytes()};
      std::copy(path.begin(), path.end(), header->path.begin());
      header->checksum = header->sum();
      errno = ENOSPC;
      if (::ftruncate(fd.get(), 0) != 0 || ::pwrite(fd.get(), header.get(), sizeof(Header), 0) != sizeof(Header)) folder_->turnOff();
    }
    return std::unique_ptr<StoredFile>(std::make_unique<CachedFile>(path, folder_, memory_, std::move(fd), header->bytes, below_, std::move(file)));
  }
  Result<bool> exists(const std::string& path) override { return below_->exists(path); }
  Result<std::string> version(const std::string& path, const ReadOptions& options) override { return below_->version(path, options); }
  bool brings() const override { return true; }
  std::string warning() const override { return folder_->warning(); }

 private:
  const StoragePtr below_;
  const std::shared_ptr<CacheFolder> folder_;
  const std::shared_ptr<PieceMemory> memory_;
};

}  // namespace

CacheSettings cacheSettings() {
  CacheSettings settings;
  const auto variable = [](const char* name) {
    const char* value = std::getenv(name);
    return std::string(value ? value : "");
  };
  if (const std::string folder = variable("FORMFIELD_CACHE"); !folder.empty())
    settings.folder = folder == "off" ? "" : folder;
  else if (const std::string caches = variable("XDG_CACHE_HOME"); !caches.empty())
    settings.folder = caches + "/formfield";
  else if (const std::string home = variable("HOME"); !home.empty())
    settings.folder = home + "/.cache/formfield";
  if (const std::string limit = variable("FORMFIELD_CACHE_LIMIT"); !limit.empty()) {
    uint64_t mib = 0;
    const auto [end, fault] = std::from_chars(limit.data(), limit.data() + limit.size(), mib);
    if (fault == std::errc() && *end == '\0' && mib <= ~uint64_t{0} >> 20)
      settings.limit_bytes = mib << 20;
    else
      settings.warning = "FORMFIELD_CACHE_LIMIT: \"" + limit + "\" is not a number of MiB; " + std::to_string(settings.limit_bytes >> 20) + " are taken";
  }
  return settings;
}

StoragePtr cachedStorage(StoragePtr below, const CacheSettings& settings) { return std::make_shared<CachedStorage>(std::move(below), settings); }

}  // namespace ff::formats
