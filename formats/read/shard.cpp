#include "formats/read/shard.h"

#include <vector>

#include "formats/codec/checksum.h"

namespace ff::formats {

Result<std::unique_ptr<StoredFile>> openShard(Storage& storage, const std::string& path, const ShardRecord& record, const ReadOptions& options) {
  auto opened = storage.open(path, options);
  if (!opened) return opened.error();
  const StoredFile& file = **opened;
  const auto broken = [&](uint64_t offset, const std::string& message) {
    file.forget(0, file.bytes());
    return Error{ErrorCode::kInvalidFile, path, "offset " + std::to_string(offset), message, "restore the world's files from one copy, or bake again"};
  };
  if (file.bytes() != record.bytes || file.bytes() < kShardHeaderBytes)
    return broken(file.bytes(), "the manifest says " + std::to_string(record.bytes) + " bytes, the file has " + std::to_string(file.bytes()));
  std::vector<std::byte> bytes(kShardHeaderBytes);
  if (auto ok = file.read(0, bytes, options); !ok) return ok.error();
  ByteReader r(bytes);
  ShardHeader h;
  ShardHeader::fields(r, h);
  if (h.magic != kShardMagic) return broken(0, "is not a Formfield shard (does not begin with FFSHARD)");
  if (h.reader_version > kFormatVersion)
    return Error{ErrorCode::kInvalidFile, path, "offset 10",
                 "needs a reader of format version " + std::to_string(h.reader_version) + ", this one knows " +
                     std::to_string(kFormatVersion),
                 "use a newer Formfield"};
  if (hashBytes(std::span<const std::byte>(bytes).first(kShardHeaderBytes - 8)) != h.checksum) return broken(0, "header checksum mismatch");
  if (h.version < kFormatVersion || h.reader_version < kFormatVersion) return broken(8, "is of a format version that was never released");
  if (r.reservedUsed()) return broken(0, "uses a reserved byte of the header");
  if (h.kind != record.kind) return broken(12, "is another shard than the manifest names");
  return std::move(*opened);
}

}  // namespace ff::formats
