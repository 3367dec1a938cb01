#include "formats/shard_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>

#include "formats/checksum.h"

namespace ff::formats {
namespace {

constexpr size_t kWriteBytes = size_t{1} << 20;

std::string fileName(const std::string& path) { return path.substr(path.rfind('/') + 1); }

Result<Descriptor> createFile(const std::string& path) {
  Descriptor fd(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!fd) return systemError(path, "cannot create");
  return fd;
}

Result<void> writeAll(int fd, std::span<const std::byte> data, const std::string& path) {
  while (!data.empty()) {
    const ssize_t n = ::write(fd, data.data(), data.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return systemError(path, "cannot write");
    data = data.subspan(static_cast<size_t>(n));
  }
  return {};
}

}  // namespace

Result<std::unique_ptr<ShardWriter>> ShardWriter::create(const std::string& path, uint32_t kind, uint32_t number) {
  std::unique_ptr<ShardWriter> shard(new ShardWriter);
  ShardWriter& s = *shard;
  auto fd = createFile(path + ".part");
  if (!fd) return fd.error();
  s.path_ = path;
  s.part_path_ = path + ".part";
  s.descriptor_ = std::move(*fd);
  s.number_ = number;
  s.record_.name = fileName(path);
  s.record_.kind = kind;
  ShardHeader header;
  header.kind = kind;
  header.shard = number;
  std::vector<std::byte> bytes = recordBytes(header);
  storeLittle(bytes.data() + kShardHeaderBytes - 8, hashBytes(std::span(bytes).first(kShardHeaderBytes - 8)));
  if (auto ok = s.write(bytes); !ok) return ok.error();
  return shard;
}

ShardWriter::~ShardWriter() {
  if (!part_path_.empty()) ::unlink(part_path_.c_str());
}

Result<void> ShardWriter::write(std::span<const std::byte> data) {
  pending_.insert(pending_.end(), data.begin(), data.end());
  bytes_ += data.size();
  return pending_.size() >= kWriteBytes ? flush() : Result<void>{};
}

Result<void> ShardWriter::flush() {
  auto ok = writeAll(descriptor_.get(), pending_, part_path_);
  pending_.clear();
  return ok;
}

Result<void> ShardWriter::add(const TileInfo& info, std::vector<std::byte> bytes) {
  const uint64_t content = loadLittle<uint64_t>(bytes.data() + kStripChecksumOffset);
  const uint64_t checksum =
      mixStripChecksum(content, {record_.kind, info.id.level, info.id.tile, number_, bytes_});
  storeLittle(bytes.data() + kStripChecksumOffset, checksum);
  IndexRecord x;
  x.level = static_cast<uint8_t>(info.id.level);
  x.nodes = static_cast<uint16_t>(info.nodes);
  x.tile = info.id.tile;
  x.offset = bytes_;
  x.stored_bytes = info.stored_bytes;
  x.raw_bytes = info.raw_bytes;
  x.first_node = info.first_node;
  x.entries = info.entries;
  x.bounds = info.bounds;
  x.checksum = checksum;
  IndexRecord::fields(index_, x);
  ++record_.records;
  return write(bytes);
}

Result<void> ShardWriter::finish() {
  ShardFooter footer;
  footer.index_offset = bytes_;
  footer.index_checksum = hashBytes(index_.data());
  footer.records = record_.records;
  footer.file_bytes = bytes_ + index_.data().size() + kFooterBytes;
  std::vector<std::byte> bytes = recordBytes(footer);
  storeLittle(bytes.data() + kFooterBytes - 8, hashBytes(std::span(bytes).first(kFooterBytes - 8)));
  if (auto ok = write(index_.data()); !ok) return ok;
  if (auto ok = write(bytes); !ok) return ok;
  if (auto ok = flush(); !ok) return ok;
  if (::fsync(descriptor_.get()) != 0) return systemError(part_path_, "cannot sync");
  descriptor_ = Descriptor();
  index_ = ByteWriter();
  record_.bytes = bytes_;
  record_.index_checksum = footer.index_checksum;
  return {};
}

Result<void> ShardWriter::rename() {
  if (::rename(part_path_.c_str(), path_.c_str()) != 0) return systemError(path_, "cannot rename");
  part_path_.clear();
  return {};
}

Result<void> writeFileAtomically(const std::string& path, std::span<const std::byte> bytes) {
  const std::string part = path + ".part";
  auto fd = createFile(part);
  if (!fd) return fd.error();
  auto ok = writeAll(fd->get(), bytes, part);
  if (ok && ::fsync(fd->get()) != 0) ok = systemError(part, "cannot sync");
  if (ok && ::rename(part.c_str(), path.c_str()) != 0) ok = systemError(path, "cannot rename");
  if (!ok) {
    ::unlink(part.c_str());
    return ok;
  }
  return syncFolderOf(path);
}

Result<void> syncFolderOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
  const Descriptor fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd || ::fsync(fd.get()) != 0) return systemError(folder, "cannot sync the folder");
  return {};
}

}  // namespace ff::formats
