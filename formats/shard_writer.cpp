#include "formats/shard_writer.h"

#include "formats/checksum.h"

namespace ff::formats {
namespace {

constexpr size_t kWriteBytes = size_t{1} << 20;

std::string digits(uint64_t number, unsigned base, size_t width) {
  std::string text;
  for (; text.size() < width || number > 0; number /= base) text.insert(text.begin(), "0123456789abcdef"[number % base]);
  return text;
}

const char* infix(uint32_t kind) { return kind == kKindGeometry ? ".geometry." : "."; }

}  // namespace

Result<std::unique_ptr<ShardWriter>> ShardWriter::create(StoragePtr storage, const std::string& stem, uint32_t kind, uint32_t number) {
  std::unique_ptr<ShardWriter> shard(new ShardWriter);
  ShardWriter& s = *shard;
  const std::string part = stem + infix(kind) + digits(number, 10, 4) + ".part";
  auto file = storage->create(part);
  if (!file) return file.error();
  s.storage_ = std::move(storage);
  s.stem_ = stem;
  s.part_path_ = part;
  s.file_ = std::move(*file);
  s.number_ = number;
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
  if (!part_path_.empty()) (void)storage_->remove(part_path_);
}

Result<void> ShardWriter::write(std::span<const std::byte> data) {
  pending_.insert(pending_.end(), data.begin(), data.end());
  bytes_ += data.size();
  return pending_.size() >= kWriteBytes ? flush() : Result<void>{};
}

Result<void> ShardWriter::flush() {
  auto ok = file_->append(pending_);
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
  if (auto ok = file_->sync(); !ok) return ok;
  file_.reset();
  index_ = ByteWriter();
  record_.bytes = bytes_;
  record_.index_checksum = footer.index_checksum;
  // The footer's checksum is one of all the shard holds, by way of the index and the strips' own.
  record_.name = fileNameOf(stem_) + infix(record_.kind) + digits(loadLittle<uint64_t>(bytes.data() + kFooterBytes - 8), 16, 16) + ".ffs";
  return {};
}

Result<void> ShardWriter::rename() {
  if (auto ok = storage_->rename(part_path_, folderOf(stem_) + record_.name); !ok) return ok;
  part_path_.clear();
  return {};
}

bool isPartOfWorld(const std::string& name, const std::string& file) {
  std::string_view rest = file;
  if (!rest.starts_with(name + ".")) return false;
  rest.remove_prefix(name.size() + 1);
  if (rest == "ffm.part") return true;
  if (rest.starts_with("geometry.")) rest.remove_prefix(9);
  const size_t dot = rest.find('.');
  if (dot == std::string_view::npos) return false;
  const std::string_view number = rest.substr(0, dot), end = rest.substr(dot);
  const auto all = [&](std::string_view allowed) { return number.find_first_not_of(allowed) == std::string_view::npos; };
  return (end == ".ffs" && number.size() == 16 && all("0123456789abcdef")) || (end == ".part" && number.size() >= 4 && all("0123456789"));
}

}  // namespace ff::formats
