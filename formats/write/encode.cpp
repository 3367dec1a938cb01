#include "formats/write/encode.h"

#include <zstd.h>

#include "formats/codec/checksum.h"
#include "formats/codec/records.h"

namespace ff::formats {
namespace {


}  // namespace

std::vector<std::byte> encodeManifest(std::span<const SectionBytes> sections) {
  ByteWriter table;
  uint64_t offset = kManifestHeaderBytes + sections.size() * kSectionRecordBytes;
  for (const SectionBytes& s : sections) {
    const SectionRecord record{s.kind, offset, s.bytes.size(), s.bytes.size(), hashBytes(s.bytes)};
    SectionRecord::fields(table, record);
    offset += s.bytes.size();
  }
  ManifestHeader header;
  header.sections = static_cast<uint32_t>(sections.size());
  header.file_bytes = offset;
  header.table_checksum = hashBytes(table.data());
  std::vector<std::byte> out = recordBytes(header);
  storeLittle(out.data() + kManifestHeaderBytes - 8, hashBytes(std::span(out).first(kManifestHeaderBytes - 8)));
  out.insert(out.end(), table.data().begin(), table.data().end());
  for (const SectionBytes& s : sections) out.insert(out.end(), s.bytes.begin(), s.bytes.end());
  return out;
}

Result<std::vector<std::byte>> compressChunk(std::span<const std::byte> raw) {
  std::vector<std::byte> out(ZSTD_compressBound(raw.size()));
  const size_t n = ZSTD_compress(out.data(), out.size(), raw.data(), raw.size(), kZstdLevel);
  if (ZSTD_isError(n)) return Error{ErrorCode::kIo, "", "", "out of memory for compression", "close other programs"};
  out.resize(n);
  return out;
}

}  // namespace ff::formats
