#include "formats/shard.h"

#include <cmath>

#include "formats/checksum.h"

namespace ff::formats {
namespace {

Error broken(const std::string& path, uint64_t offset, const std::string& message) {
  return {ErrorCode::kInvalidFile, path, "offset " + std::to_string(offset), message,
          "restore the world's files from one copy, or bake again"};
}

Result<void> checkHeader(const std::string& path, const StoredFile& file, const ShardRecord& record, uint32_t number) {
  std::vector<std::byte> bytes(kShardHeaderBytes);
  if (auto ok = file.read(0, bytes); !ok) return ok;
  ByteReader r(bytes);
  ShardHeader h;
  ShardHeader::fields(r, h);
  if (h.magic != kShardMagic) return broken(path, 0, "is not a Formfield shard (does not begin with FFSHARD)");
  if (h.reader_version > kFormatVersion)
    return Error{ErrorCode::kInvalidFile, path, "offset 10",
                 "needs a reader of format version " + std::to_string(h.reader_version) + ", this one knows " +
                     std::to_string(kFormatVersion),
                 "use a newer Formfield"};
  if (hashBytes(std::span<const std::byte>(bytes).first(kShardHeaderBytes - 8)) != h.checksum)
    return broken(path, 0, "header checksum mismatch");
  if (h.version < kFormatVersion || h.reader_version < kFormatVersion)
    return broken(path, 8, "is of a format version that was never released");
  if (r.reservedUsed()) return broken(path, 0, "uses a reserved byte of the header");
  if (h.kind != record.kind || h.shard != number) return broken(path, 12, "is another shard than the manifest names");
  return {};
}

Result<ShardFooter> readFooter(const std::string& path, const StoredFile& file, const ShardRecord& record) {
  const uint64_t file_bytes = file.bytes(), at = file_bytes - kFooterBytes;
  std::vector<std::byte> bytes(kFooterBytes);
  if (auto ok = file.read(at, bytes); !ok) return ok.error();
  ByteReader r(bytes);
  ShardFooter f;
  ShardFooter::fields(r, f);
  if (f.magic != kFooterMagic || hashBytes(std::span<const std::byte>(bytes).first(kFooterBytes - 8)) != f.checksum)
    return broken(path, at, "footer is damaged");
  if (r.reservedUsed()) return broken(path, at, "uses a reserved byte of the footer");
  if (f.file_bytes != file_bytes || f.index_offset < kShardHeaderBytes || f.index_offset > at ||
      at - f.index_offset != uint64_t{f.records} * kIndexRecordBytes)
    return broken(path, at, "index lies outside the file");
  if (f.records != record.records || f.index_checksum != record.index_checksum)
    return broken(path, at, "belongs to another bake than the manifest");
  return f;
}

}  // namespace

Result<OpenShard> openShard(Storage& storage, const std::string& path, const ShardRecord& record, uint32_t number) {
  auto opened = storage.open(path);
  if (!opened) return opened.error();
  const StoredFile& file = **opened;
  if (file.bytes() != record.bytes || file.bytes() < kShardHeaderBytes + kFooterBytes)
    return broken(path, file.bytes(),
                  "the manifest says " + std::to_string(record.bytes) + " bytes, the file has " +
                      std::to_string(file.bytes()));
  if (auto ok = checkHeader(path, file, record, number); !ok) return ok.error();
  auto footer = readFooter(path, file, record);
  if (!footer) return footer.error();

  std::vector<std::byte> index(uint64_t{footer->records} * kIndexRecordBytes);
  if (auto ok = file.read(footer->index_offset, index); !ok) return ok.error();
  if (hashBytes(index) != footer->index_checksum) return broken(path, footer->index_offset, "index checksum mismatch");
  OpenShard shard;
  shard.entries.reserve(footer->records);
  ByteReader r(index);
  uint64_t next = kShardHeaderBytes;
  for (uint32_t i = 0; i < footer->records; ++i) {
    const uint64_t at = footer->index_offset + r.position();
    IndexRecord x;
    IndexRecord::fields(r, x);
    if (x.offset != next || x.stored_bytes < kStripHeaderBytes || x.stored_bytes > footer->index_offset - x.offset)
      return broken(path, at, "index record names bytes outside the strips");
    if (x.raw_bytes > kMaxStripRawBytes) return broken(path, at, "index record names an impossible size");
    if (x.level >= kMaxLevels) return broken(path, at, "index record names an impossible level");
    if (x.bounds.empty() || !std::isfinite(length(x.bounds.hi - x.bounds.lo)) || !std::isfinite(length(x.bounds.lo)))
      return broken(path, at, "index record has bounds that cannot be");
    next += x.stored_bytes;
    ShardEntry& e = shard.entries.emplace_back();
    e.info.id = {x.level, x.tile};
    e.info.shard = number;
    e.info.offset = x.offset;
    e.info.stored_bytes = x.stored_bytes;
    e.info.raw_bytes = x.raw_bytes;
    e.info.first_node = x.first_node;
    e.info.nodes = x.nodes;
    e.info.entries = x.entries;
    e.info.bounds = x.bounds;
    e.checksum = x.checksum;
  }
  if (r.reservedUsed()) return broken(path, footer->index_offset, "uses a reserved byte of the index");
  if (next != footer->index_offset) return broken(path, next, "bytes between the strips and the index");
  shard.file = std::move(*opened);
  return shard;
}

std::string geometryPlace(const ShardEntry& entry) {
  return "geometry 0:" + std::to_string(entry.info.id.tile) + " at offset " + std::to_string(entry.info.offset);
}

Result<StripHeader> readGeometryHeader(const ShardEntry& entry, std::span<const std::byte> stored) {
  const TileInfo& info = entry.info;
  const auto bad = [&](const char* what) {
    return Error{ErrorCode::kInvalidFile, "", geometryPlace(entry), what,
                 "restore this file from a copy, or bake again"};
  };
  if (stored.size() != info.stored_bytes || stored.size() < kStripHeaderBytes) return bad("is cut off");
  ByteReader r(stored.first(kStripHeaderBytes));
  StripHeader h;
  StripHeader::fields(r, h);
  if (h.magic != kGeometryMagic) return bad("does not begin with FFGM");
  const uint64_t expected = mixStripChecksum(hashStripContent(stored),
                                             {kKindGeometry, info.id.level, info.id.tile, info.shard, info.offset});
  if (h.checksum != expected || h.checksum != entry.checksum)
    return bad("checksum mismatch: bytes were changed, swapped or left over from another bake");
  if (r.reservedUsed()) return bad("uses a reserved byte of the header");
  if (h.level != 0 || h.tile != info.id.tile || h.entries != info.entries || h.blocks > h.entries || h.raw_bytes != 0 ||
      h.payload_bytes != stored.size() - kStripHeaderBytes)
    return bad("header and index disagree");
  return h;
}

}  // namespace ff::formats
