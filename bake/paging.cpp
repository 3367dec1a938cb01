#include "bake/paging.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "bake/memory.h"
#include "bake/spill.h"

namespace ff::bake {
namespace {

using namespace std::chrono_literals;

constexpr uint64_t kInMemory = 16;       // large arrays: a share of the limit, one in
constexpr auto kLook = 2ms;              // how often what is held is looked at
constexpr size_t kSlice = size_t{256} << 20;  // of an array, that is let go together; a small part of it is held

[[noreturn]] void fail(const std::string& folder, int fault) {
  throw SpillFailed{{ErrorCode::kIo, folder, "", std::string("cannot put aside what memory has no room for: ") + std::strerror(fault),
                     "make room on that disk, or give more --memory"}};
}

// An open file that no folder names.
int openUnnamed(const std::string& folder) {
  const int file = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (file >= 0) return file;
  std::string name = folder + (folder.ends_with('/') ? "" : "/") + ".ffbake-XXXXXX";  // file systems without such files
  const int named = ::mkostemp(name.data(), O_CLOEXEC);
  if (named < 0) fail(folder, errno);
  ::unlink(name.c_str());
  return named;
}

// Of this process.
class Pager {
 public:
  static Pager& get() {
    static Pager* pager = new Pager;  // never taken down: arrays may live as long as the process
    return *pager;
  }

  void begin(const Paging* who, std::string folder, uint64_t limit_bytes) {
    const std::lock_guard lock(mutex_);
    if (limits_.empty()) most_aside_ = paged_ + unmapped_;
    limits_.push_back({who, std::move(folder), limit_bytes});
    if (!files_.empty()) watch();
  }

  void end(const Paging* who) {
    std::jthread ended;  // joined last
    const std::lock_guard lock(mutex_);
    std::erase_if(limits_, [&](const Limit& l) { return l.who == who; });
    if (limits_.empty()) ended = std::move(keeper_);
  }

  void* allocate(size_t bytes) {
    std::unique_lock lock(mutex_);
    if (limits_.empty() || in_memory_ + bytes <= limit() / kInMemory) {
      in_memory_ += bytes;
      lock.unlock();
      void* at = ::operator new(bytes, kAlignment, std::nothrow);
      if (at) return at;
      lock.lock();
      in_memory_ -= bytes;
      throw std::bad_alloc();
    }
    const std::string folder = limits_.back().folder;
    watch();
    lock.unlock();
    void* at = map(folder, bytes);
    lock.lock();
    files_.emplace(static_cast<std::byte*>(at), bytes);
    paged_ += bytes;
    most_aside_ = std::max(most_aside_, paged_ + unmapped_);
    return at;
  }

  void free(void* at, size_t bytes) noexcept {
    {
      const std::lock_guard lock(mutex_);
      const auto file = files_.find(static_cast<std::byte*>(at));
      if (file != files_.end()) {
        files_.erase(file);  // before another mapping may stand there
        paged_ -= bytes;
        ::munmap(at, bytes);
        return;
      }
      in_memory_ -= bytes;
    }
    ::operator delete(at, kAlignment);
  }

  // The folder of files; empty: there is no limit.
  std::string folder() {
    const std::lock_guard lock(mutex_);
    return limits_.empty() ? "" : limits_.back().folder;
  }

  // Of files that are not mapped.
  void addUnmapped(int64_t bytes) {
    const std::lock_guard lock(mutex_);
    unmapped_ += static_cast<uint64_t>(bytes);
    most_aside_ = std::max(most_aside_, paged_ + unmapped_);
  }

  PagedBytes aside() {
    const std::lock_guard lock(mutex_);
    return {paged_ + unmapped_, most_aside_};
  }

 private:
  static constexpr std::align_val_t kAlignment{4096};
  struct Limit {
    const Paging* who;
    std::string folder;
    uint64_t bytes;
  };

  uint64_t limit() const {
    return std::ranges::min_element(limits_, {}, &Limit::bytes)->bytes;
  }

  // From the first file on, while there is a limit.
  void watch() {
    if (!keeper_.joinable()) keeper_ = std::jthread([this](std::stop_token stop) { keep(stop); });
  }

  static void* map(const std::string& folder, size_t bytes) {
    const int file = openUnnamed(folder);
    if (const int fault = ::posix_fallocate(file, 0, static_cast<off_t>(bytes))) {  // else a full disk would end the process when a page is touched
      ::close(file);
      fail(folder, fault);
    }
    void* at = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    const int fault = errno;
    ::close(file);
    if (at == MAP_FAILED) fail(folder, fault);
    // A byte that is touched is not to bring 2 MiB with it: nothing is read ahead, else the system's cache has large folios, which newer kernels map whole.
    ::madvise(at, bytes, MADV_NOHUGEPAGE);  // systems without such pages refuse
    ::madvise(at, bytes, MADV_RANDOM);
    return at;
  }

  // Lets pages go in turn once the process holds seven eighths of the limit, until it holds half of what it may of them. They stay in the system's cache while
  // that has room, and come back with a fault: many at a time and quickly, hence the room that is left.
  void keep(std::stop_token stop) {
    std::unique_lock lock(mutex_);
    std::pair<std::byte*, size_t> hand{nullptr, 0};  // an array, and how far it has been let go
    std::optional<uint64_t> code;                    // pages of files that are not arrays: what was left when all of those had been let go
    while (!stop.stop_requested() && !limits_.empty()) {
      const uint64_t most = limit() / 8 * 7;
      auto pause = kLook;
      if (const ResidentMemory now = residentMemory(); !files_.empty() && now.all > most) {
        const uint64_t others = now.all - now.files + std::min(code.value_or(0), now.files), left = others + (most - std::min(most, others)) / 2;
        uint64_t visited = 0;
        for (; visited < paged_ && residentMemory().all > left; visited += letGo(hand)) continue;
        if (visited >= paged_) {  // once more, and at once
          for (const auto& [at, bytes] : files_) ::madvise(at, bytes, MADV_DONTNEED);
          const uint64_t kept = residentMemory().files;
          code = std::min(code.value_or(kept), kept);
        }
        if (others >= most) pause *= 8;  // it is not the arrays
      }
      wake_.wait_for(lock, stop, pause, [] { return false; });
    }
  }

  // The next pages after the hand, in the order of addresses. Returns how many bytes; there is an array.
  size_t letGo(std::pair<std::byte*, size_t>& hand) {
    auto at = files_.lower_bound(hand.first);
    if (at != files_.end() && at->first == hand.first && hand.second >= at->second) ++at;
    if (at == files_.end()) at = files_.begin();
    if (at->first != hand.first || hand.second >= at->second) hand = {at->first, 0};
    const size_t bytes = std::min(kSlice, at->second - hand.second);
    ::madvise(at->first + hand.second, bytes, MADV_DONTNEED);
    hand.second += bytes;
    return bytes;
  }

  std::mutex mutex_;
  std::condition_variable_any wake_;
  std::vector<Limit> limits_;
  std::map<std::byte*, size_t> files_;  // mapped, by address
  uint64_t in_memory_ = 0, paged_ = 0;  // of large arrays, B
  uint64_t unmapped_ = 0, most_aside_ = 0;  // of files that are not mapped; of both, B
  std::jthread keeper_;
};

}  // namespace

Paging::Paging(std::string folder, uint64_t limit_bytes) {
  Pager::get().begin(this, folder.empty() ? "." : std::move(folder), limit_bytes > 0 ? limit_bytes : residentMemory().all + freeMemory());
}
Paging::~Paging() { Pager::get().end(this); }

PagedBytes pagedBytes() { return Pager::get().aside(); }
bool isPaging() { return !Pager::get().folder().empty(); }
void* allocateLarge(size_t bytes) { return Pager::get().allocate(bytes); }
void freeLarge(void* at, size_t bytes) noexcept { Pager::get().free(at, bytes); }

UnnamedFile::UnnamedFile() : folder_(Pager::get().folder()), file_(openUnnamed(folder_)) {}

UnnamedFile::~UnnamedFile() {
  ::close(file_);
  Pager::get().addUnmapped(-static_cast<int64_t>(bytes_));
}

void UnnamedFile::append(std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::pwrite(file_, bytes.data(), bytes.size(), static_cast<off_t>(bytes_));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) fail(folder_, written < 0 ? errno : ENOSPC);
    bytes_ += static_cast<uint64_t>(written);
    Pager::get().addUnmapped(written);
    bytes = bytes.subspan(static_cast<size_t>(written));
  }
}

void UnnamedFile::read(uint64_t at, std::span<std::byte> out) const {
  while (!out.empty()) {
    const ssize_t read = ::pread(file_, out.data(), out.size(), static_cast<off_t>(at));
    if (read < 0 && errno == EINTR) continue;
    if (read <= 0) fail(folder_, read < 0 ? errno : EIO);
    at += static_cast<uint64_t>(read);
    out = out.subspan(static_cast<size_t>(read));
  }
}

}  // namespace ff::bake
