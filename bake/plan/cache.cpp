#include "bake/plan/cache.h"

#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <system_error>

namespace ff::bake {
namespace {

// NAME.ffu, "rays-0123456789abcdef0123456789abcdef.ffu"; while it is written NAME.ffu.PID-NUMBER@HOST.tmp. Nothing else in the folder is ours.
constexpr std::string_view kEnding = ".ffu", kHalfEnding = ".tmp";
constexpr auto kSurelyOver = std::chrono::hours(24);  // for what another machine writes

// Before the result: a mark and a version, then the digest of the result and the key.
constexpr std::array<char, 8> kMark = {'F', 'F', 'U', 'N', 'I', 'T', '0', '1'};
struct Head {
  std::array<char, 8> mark;
  Digest key, content;
};
static_assert(sizeof(Head) == 40);

std::string nameOf(std::string_view kind, const Digest& key) {
  char hex[33];
  std::snprintf(hex, sizeof hex, "%016llx%016llx", static_cast<unsigned long long>(key[0]), static_cast<unsigned long long>(key[1]));
  return std::string(kind) + "-" + hex + std::string(kEnding);
}

bool isUnit(std::string_view name) { return name.ends_with(kEnding); }
bool isHalf(std::string_view name) { return name.ends_with(kHalfEnding) && name.find(".ffu.") != std::string_view::npos; }

// "@HOST.tmp" of this machine.
std::string ownEnding() {
  std::array<char, 256> host{};
  (void)gethostname(host.data(), host.size() - 1);
  std::replace(host.begin(), host.end(), '/', '_');
  std::string ending("@");
  ending.append(host.data()).append(kHalfEnding);
  return ending;
}

// Whether nobody writes a half-written file any more.
bool isAbandoned(const std::string& folder, const std::string& name) {
  std::error_code unknown;
  if (name.ends_with(ownEnding()))
    return !std::filesystem::exists("/proc/" + std::to_string(std::atol(name.c_str() + name.find(".ffu.") + 5)), unknown);
  const auto written = std::filesystem::last_write_time(folder + name, unknown);
  return !unknown && written + kSurelyOver < std::filesystem::file_time_type::clock::now();
}

uint64_t sizeOf(const std::string& path) {
  std::error_code error;
  const auto bytes = std::filesystem::file_size(path, error);
  return error ? 0 : bytes;
}

}  // namespace

Digest digestOf(std::span<const std::byte> bytes) {
  const XXH128_hash_t h = XXH3_128bits(bytes.data(), bytes.size());
  return {h.high64, h.low64};
}

BakeCache::BakeCache(std::string folder, uint64_t limit_bytes, formats::StoragePtr storage)
    : folder_(std::move(folder)), limit_bytes_(limit_bytes), storage_(std::move(storage)) {}

Result<std::unique_ptr<BakeCache>> BakeCache::open(const std::string& folder, uint64_t limit_bytes, formats::StoragePtr storage) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Error{ErrorCode::kIo, folder, "", "the cache folder cannot be made: " + error.message(), "give another with --cache, or --no-cache"};
  std::unique_ptr<BakeCache> cache(new BakeCache(folder.ends_with('/') ? folder : folder + "/", limit_bytes, std::move(storage)));
  if (auto looked = cache->look(folder, true); !looked) return looked.error();
  return cache;
}

Result<std::unique_ptr<BakeCache>> BakeCache::peek(const std::string& folder, formats::StoragePtr storage) {
  std::unique_ptr<BakeCache> cache(new BakeCache(folder.ends_with('/') ? folder : folder + "/", 0, std::move(storage)));
  std::error_code unknown;
  if (!std::filesystem::exists(folder, unknown)) return cache;
  if (auto looked = cache->look(folder, false); !looked) return looked.error();
  return cache;
}

Result<void> BakeCache::look(const std::string& folder, bool tidy) {
  const auto names = storage_->list(folder);
  if (!names) return names.error();
  for (const std::string& name : *names) {
    if (isUnit(name)) bytes_ += sizeOf(folder_ + name);
    if (tidy && isHalf(name) && isAbandoned(folder_, name)) (void)storage_->remove(folder_ + name);
  }
  return {};
}

void BakeCache::warn(const Error& error) {
  const std::lock_guard lock(mutex_);
  warnings_.push_back("the bake goes on without its cache, and does all from here on again if it is stopped: " + error.line());
}

std::vector<std::string> BakeCache::warnings() const {
  const std::lock_guard lock(mutex_);
  return warnings_;
}

std::optional<std::vector<std::byte>> BakeCache::load(std::string_view kind, const Digest& key) {
  const std::string name = nameOf(kind, key);
  auto file = storage_->open(folder_ + name);
  if (!file || (*file)->bytes() < sizeof(Head)) return {};
  std::vector<std::byte> bytes((*file)->bytes());
  if (!(*file)->read(0, bytes)) return {};
  Head head;
  std::memcpy(&head, bytes.data(), sizeof head);
  bytes.erase(bytes.begin(), bytes.begin() + sizeof head);
  if (head.mark != kMark || head.key != key || head.content != digestOf(bytes)) return {};
  const std::lock_guard lock(mutex_);
  used_.insert(name);
  return bytes;
}

void BakeCache::store(std::string_view kind, const Digest& key, std::span<const std::byte> bytes) {
  if (broken_) return;
  const std::string name = nameOf(kind, key);
  const std::string half = folder_ + name + "." + std::to_string(getpid()) + "-" + std::to_string(temporaries_++) + ownEnding();
  const Head head{kMark, key, digestOf(bytes)};
  const auto write = [&]() -> Result<void> {
    auto file = storage_->create(half);
    if (!file) return file.error();
    if (auto ok = (*file)->append(std::as_bytes(std::span(&head, 1))); !ok) return ok;
    if (auto ok = (*file)->append(bytes); !ok) return ok;
    return {};
  };
  const uint64_t before = sizeOf(folder_ + name), size = sizeof head + bytes.size();
  const auto isFull = [&] {
    const uint64_t with = bytes_ + size;
    return with > limit_bytes_ && with - limit_bytes_ > before;
  };
  if (isFull()) trim(size);
  if (isFull()) {
    const std::string limit = std::to_string(limit_bytes_ >> 20) + "M";
    if (!broken_.exchange(true)) warn({ErrorCode::kIo, folder_, "", "the cache is full", "give --cache-limit more than " + limit + ", or --clean"});
    return;
  }
  auto ok = write();
  if (ok) ok = storage_->rename(half, folder_ + name);
  if (!ok) {
    (void)storage_->remove(half);
    if (!broken_.exchange(true)) warn(ok.error());
    return;
  }
  bytes_ += size - before;
  const std::lock_guard lock(mutex_);
  used_.insert(name);
}

void BakeCache::trim(uint64_t room_bytes) {
  const std::lock_guard lock(mutex_);
  const auto names = storage_->list(folder_);
  if (!names) return;
  uint64_t bytes = 0;  // other processes store as well
  for (const std::string& name : *names)
    if (isUnit(name)) bytes += sizeOf(folder_ + name);
  for (const std::string& name : *names) {
    if (bytes + room_bytes <= limit_bytes_) break;
    if (!isUnit(name) || used_.contains(name)) continue;
    const uint64_t size = sizeOf(folder_ + name);
    if (storage_->remove(folder_ + name)) bytes -= size;
  }
  bytes_ = bytes;
}

Result<uint64_t> BakeCache::clean(const std::string& folder, formats::StoragePtr storage) {
  const auto names = storage->list(folder);
  if (!names) return names.error();
  uint64_t bytes = 0;
  for (const std::string& name : *names) {
    if (!isUnit(name) && !isHalf(name)) continue;
    const std::string path = folder + "/" + name;
    const uint64_t size = sizeOf(path);
    if (auto ok = storage->remove(path); !ok) return ok.error();
    bytes += size;
  }
  std::error_code left;
  std::filesystem::remove(folder, left);  // where nothing else is in it
  return bytes;
}

}  // namespace ff::bake
