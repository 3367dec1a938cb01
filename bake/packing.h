// Bytes for the baker's own use, in files that no other version reads: small numbers in few bytes, arrays as they lie in memory, zstd frames.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "formats/codec/bytes.h"

namespace ff::bake {

// LEB128: seven bits a byte, the lowest first.
inline void putVarint(formats::ByteWriter& out, uint64_t value) {
  for (; value >= 0x80; value >>= 7) out.u8(static_cast<uint8_t>(value | 0x80));
  out.u8(static_cast<uint8_t>(value));
}

// Many of them. `out` is whole again when it goes out of scope.
class VarintAppender {
 public:
  explicit VarintAppender(formats::ByteWriter& out) : bytes_(out.data()), used_(bytes_.size()) {}
  ~VarintAppender() { bytes_.resize(used_); }
  VarintAppender(const VarintAppender&) = delete;
  VarintAppender& operator=(const VarintAppender&) = delete;

  void put(uint32_t value) {
    if (bytes_.size() - used_ < kMaxBytes) bytes_.resize(2 * used_ + kMaxBytes);
    for (; value >= 0x80; value >>= 7) bytes_[used_++] = static_cast<std::byte>(value | 0x80);
    bytes_[used_++] = static_cast<std::byte>(value);
  }

 private:
  static constexpr size_t kMaxBytes = 5;
  std::vector<std::byte>& bytes_;
  size_t used_;
};

inline uint64_t takeVarint(formats::ByteReader& in) {
  uint64_t value = 0;
  if (const auto rest = in.rest(); rest.size() >= 10) {  // cannot read past the end
    size_t n = 0;
    for (; n < 9 && (rest[n] & std::byte{0x80}) != std::byte{0}; ++n) value |= uint64_t{std::to_integer<uint8_t>(rest[n]) & 0x7fu} << 7 * n;
    value |= uint64_t{std::to_integer<uint8_t>(rest[n]) & 0x7fu} << 7 * n;
    in.unused(n + 1);
    return value;
  }
  for (int shift = 0; shift < 64; shift += 7) {
    uint8_t byte = 0;
    in.u8(byte);
    value |= uint64_t{byte & 0x7fu} << shift;
    if (!(byte & 0x80)) break;
  }
  return value;
}

template <class T>
void putValues(formats::ByteWriter& out, const std::vector<T>& values) {
  const auto bytes = std::as_bytes(std::span(values));
  out.data().insert(out.data().end(), bytes.begin(), bytes.end());
}

// raw: what `in` reads. Where it ends early, `in` says so and values are left as they are.
template <class T>
void takeValues(formats::ByteReader& in, std::span<const std::byte> raw, size_t n, std::vector<T>& values) {
  const size_t at = in.position();
  in.unused(n * sizeof(T));
  if (!in.ok()) return;
  values.resize(n);
  if (n > 0) std::memcpy(values.data(), raw.data() + at, n * sizeof(T));
}

// A zstd frame, at its fastest level; empty where memory ran out.
std::vector<std::byte> packed(std::span<const std::byte> raw);
// bytes: of the raw data. Nothing where that is not what was packed.
std::optional<std::vector<std::byte>> unpacked(std::span<const std::byte> frame, uint64_t bytes);

}  // namespace ff::bake
