// Writes one shard under a temporary name: header, strips as they come, index, footer. finish() syncs it; rename() gives
// it its name. Destroyed before rename(), it removes its file.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "formats/file.h"
#include "formats/layout.h"
#include "formats/records.h"
#include "formats/result.h"

namespace ff::formats {

class ShardWriter {
 public:
  static Result<std::unique_ptr<ShardWriter>> create(const std::string& path, uint32_t kind, uint32_t number);
  ShardWriter(const ShardWriter&) = delete;
  ~ShardWriter();

  // Completes the checksum, which depends on the place, and writes. `bytes` begins with a StripHeader whose checksum field
  // holds hashStripContent().
  Result<void> add(const TileInfo& info, std::vector<std::byte> bytes);
  // Index, footer, fsync, close.
  Result<void> finish();
  Result<void> rename();

  uint64_t bytes() const { return bytes_; }
  // Valid after finish(); `name` is the final file name without folders.
  const ShardRecord& record() const { return record_; }

 private:
  ShardWriter() = default;
  Result<void> write(std::span<const std::byte> data);
  Result<void> flush();

  std::string path_, part_path_;  // part_path_ is empty once there is nothing to remove
  Descriptor descriptor_;
  ShardRecord record_;
  uint32_t number_ = 0;
  uint64_t bytes_ = 0;
  std::vector<std::byte> pending_;
  ByteWriter index_;
};

// Writes a whole file under a temporary name, syncs it, renames it and syncs its folder.
Result<void> writeFileAtomically(const std::string& path, std::span<const std::byte> bytes);
// So that renames in the folder of `path` survive a power cut.
Result<void> syncFolderOf(const std::string& path);

}  // namespace ff::formats
