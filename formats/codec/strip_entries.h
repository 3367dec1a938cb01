// The entries of a strip, from its raw payload (FORMAT.md, 5.2 to 5.5) into the words that solvers read.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/codec/strip_codec.h"
#include "formats/model.h"
#include "formats/result.h"

namespace ff::formats {

inline constexpr size_t kEntryReadAhead = 16;  // bytes behind the payload that decoding reads and does not use

// raw: the payload, and kEntryReadAhead bytes more. layout: all but runs and words, which it finds and checks. strip: has its nodes; sets
// its blocks' entries, and the columns of their partners. After an error `words` is unspecified.
Result<void> decodeEntries(const TileInfo& info, std::span<const std::byte> raw, StripLayout layout, uint32_t max_quanta, Strip& strip,
                           std::span<PartnerName> partners, RowWords& words);

// The same entries as the arrays of `out`, whose blocks are set.
void toArrays(const RowWords& words, Strip& out);

Error brokenStrip(const TileInfo& info, const std::string& message);

}  // namespace ff::formats
