#include "formats/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace ff::formats {

Descriptor::~Descriptor() {
  if (fd_ >= 0) ::close(fd_);
}

Error systemError(const std::string& path, const std::string& what) {
  return {ErrorCode::kIo, path, "", what + ": " + std::strerror(errno), ""};
}

Result<OpenFile> openForReading(const std::string& path) {
  Descriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd) return systemError(path, "cannot open");
  struct stat s {};
  if (::fstat(fd.get(), &s) != 0) return systemError(path, "cannot read its size");
  if (!S_ISREG(s.st_mode)) return Error{ErrorCode::kIo, path, "", "is not a regular file", "name a world's .ffm file"};
  OpenFile file;
  file.descriptor = std::move(fd);
  file.bytes = static_cast<uint64_t>(s.st_size);
  return file;
}

Result<void> readAt(int descriptor, uint64_t offset, std::span<std::byte> out, const std::string& path) {
  size_t done = 0;
  while (done < out.size()) {
    const ssize_t n = ::pread(descriptor, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return systemError(path, "cannot read at offset " + std::to_string(offset + done));
    if (n == 0)
      return Error{ErrorCode::kInvalidFile, path, "offset " + std::to_string(offset + done), "the file ends here",
                   "restore this file from a copy, or bake again"};
    done += static_cast<size_t>(n);
  }
  return {};
}

}  // namespace ff::formats
