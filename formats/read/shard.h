// A shard open for reading: its header is checked, what lies in it is vouched for by checksums elsewhere (chunk.h).
#pragma once
#include <memory>
#include <string>

#include "formats/codec/records.h"
#include "formats/result.h"
#include "formats/storage/storage.h"

namespace ff::formats {

Result<std::unique_ptr<StoredFile>> openShard(Storage& storage, const std::string& path, const ShardRecord& record, const ReadOptions& options = {});

}  // namespace ff::formats
