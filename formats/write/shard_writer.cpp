#include "formats/write/shard_writer.h"

#include "formats/codec/checksum.h"

namespace ff::formats {
namespace {

constexpr size_t kWriteBytes = size_t{1} << 20;

std::string digits(uint64_t number, unsigned base, size_t width) {
  std::string text;
  for (; text.size() < width || number > 0; number /= base) text.insert(text.begin(), "0123456789abcdef"[number % base]);
  return text;
}

const char* infix(uint32_t kind) { return kind == kKindGeometry ? ".geometry." : kind == kKindIndex ? ".index." : "."; }

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

Result<Extent> ShardWriter::add(std::span<const std::byte> bytes, uint32_t raw_bytes) {
  const Extent extent{number_, bytes_, static_cast<uint32_t>(bytes.size()), raw_bytes, hashBytes(bytes)};
  checksums_.u64(extent.checksum);
  if (auto ok = write(bytes); !ok) return ok.error();
  return extent;
}

Result<void> ShardWriter::finish() {
  if (auto ok = flush(); !ok) return ok;
  if (auto ok = file_->sync(); !ok) return ok;
  file_.reset();
  record_.bytes = bytes_;
  record_.name = fileNameOf(stem_) + infix(record_.kind) + digits(hashBytes(checksums_.data()), 16, 16) + ".ffs";
  checksums_ = ByteWriter();
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
  for (const std::string_view kind : {"geometry.", "index."})
    if (rest.starts_with(kind)) rest.remove_prefix(kind.size());
  const size_t dot = rest.find('.');
  if (dot == std::string_view::npos) return false;
  const std::string_view number = rest.substr(0, dot), end = rest.substr(dot);
  const auto all = [&](std::string_view allowed) { return number.find_first_not_of(allowed) == std::string_view::npos; };
  return (end == ".ffs" && number.size() == 16 && all("0123456789abcdef")) || (end == ".part" && number.size() >= 4 && all("0123456789"));
}

}  // namespace ff::formats
