// Writes one shard under a temporary name: header, then strips or chunks' records as they come. finish() syncs it; rename() gives
// it its name, which comes from its content. Destroyed before rename(), it removes its file.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "formats/codec/records.h"
#include "formats/model.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::formats {

class ShardWriter {
 public:
  // stem: the manifest's path without .ffm. number: in the manifest's table.
  static Result<std::unique_ptr<ShardWriter>> create(StoragePtr storage, const std::string& stem, uint32_t kind, uint32_t number);
  ShardWriter(const ShardWriter&) = delete;
  ~ShardWriter();

  // Writes, and says where. raw_bytes: of what is compressed in them.
  Result<Extent> add(std::span<const std::byte> bytes, uint32_t raw_bytes);
  // Sync, close.
  Result<void> finish();
  Result<void> rename();

  uint64_t bytes() const { return bytes_; }
  // Valid after finish(); `name` is the final file name without folders.
  const ShardRecord& record() const { return record_; }

 private:
  ShardWriter() = default;
  Result<void> write(std::span<const std::byte> data);
  Result<void> flush();

  StoragePtr storage_;
  std::string stem_, part_path_;  // part_path_ is empty once there is nothing to remove
  std::unique_ptr<NewFile> file_;
  ShardRecord record_;
  uint32_t number_ = 0;
  uint64_t bytes_ = 0;
  std::vector<std::byte> pending_;
  ByteWriter checksums_;  // of all that was added
};

// Whether a file of this name is of the world whose manifest is called NAME.ffm, and no other's: a shard, or what a bake that was
// killed left of one or of the manifest. name, file: without folders.
bool isPartOfWorld(const std::string& name, const std::string& file);

}  // namespace ff::formats
