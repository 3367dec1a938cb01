#include "formats/storage/storage.h"

#include <algorithm>

#include "formats/storage/cached_storage.h"
#include "formats/storage/http_storage.h"

namespace ff::formats {

const char* whyReadEnds(const ReadOptions& options) {
  if (options.cancelled && options.cancelled->load()) return "the read was cancelled";
  const bool timed = options.deadline != std::chrono::steady_clock::time_point::max();
  return timed && std::chrono::steady_clock::now() >= options.deadline ? "the read was not done by its deadline" : nullptr;
}

Result<void> StoredFile::read(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const {
  for (size_t n = 0; !out.empty(); offset += n, out = out.subspan(n)) {
    if (const char* why = whyReadEnds(options)) return Error{ErrorCode::kIo, path_, "offset " + std::to_string(offset), why, ""};
    n = std::min(out.size(), kReadPiece);
    if (auto ok = readPiece(offset, out.first(n), options); !ok) return ok;
  }
  return {};
}

Error StoredFile::endsEarly(uint64_t offset) const {
  return {ErrorCode::kInvalidFile, path_, "offset " + std::to_string(offset), "the file ends here", "restore this file from a copy, or bake again"};
}

StoragePtr storageFor(const std::string& path) {
  if (!path.starts_with("http://") && !path.starts_with("https://")) return posixStorage();
  static const StoragePtr web = cachedStorage(httpStorage(), cacheSettings());
  return web;
}

std::string folderOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  return slash == std::string::npos ? "./" : path.substr(0, slash + 1);
}

std::string fileNameOf(const std::string& path) { return path.substr(path.rfind('/') + 1); }

Result<std::vector<std::byte>> readWholeFile(Storage& storage, const std::string& path) {
  auto file = storage.open(path);
  if (!file) return file.error();
  std::vector<std::byte> bytes((*file)->bytes());
  if (auto ok = (*file)->read(0, bytes); !ok) return ok.error();
  return bytes;
}

Result<void> writeWholeFile(Storage& storage, const std::string& path, std::span<const std::byte> bytes) {
  const std::string part = path + ".part";
  const auto write = [&]() -> Result<void> {
    auto file = storage.create(part);
    if (!file) return file.error();
    if (auto ok = (*file)->append(bytes); !ok) return ok;
    if (auto ok = (*file)->sync(); !ok) return ok;
    return storage.rename(part, path);
  };
  if (auto ok = write(); !ok) {
    (void)storage.remove(part);
    return ok;
  }
  const auto synced = storage.syncFolder(folderOf(path));
  return synced ? Result<void>{} : synced.error();
}

}  // namespace ff::formats
