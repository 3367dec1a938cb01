// Bounded little-endian cursors. Both have the same member names, so that one list of fields (records.h) serves for
// reading and for writing. A ByteReader never reads past its end: it yields zeros and remembers that it failed.
#pragma once
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "formats/vec3.h"

namespace ff::formats {

// Loads and stores that do not depend on the machine's byte order.
template <class T>
T loadLittle(const std::byte* p) {
  T value = 0;
  for (size_t i = 0; i < sizeof(T); ++i)
    value = static_cast<T>(value | static_cast<T>(static_cast<T>(std::to_integer<uint8_t>(p[i])) << (8 * i)));
  return value;
}

template <class T>
void storeLittle(std::byte* p, T value) {
  for (size_t i = 0; i < sizeof(T); ++i) p[i] = static_cast<std::byte>((value >> (8 * i)) & 0xff);
}

class ByteReader {
 public:
  explicit ByteReader(std::span<const std::byte> bytes) : bytes_(bytes) {}

  void u8(uint8_t& v) { v = take<uint8_t>(); }
  void u16(uint16_t& v) { v = take<uint16_t>(); }
  void u32(uint32_t& v) { v = take<uint32_t>(); }
  void u64(uint64_t& v) { v = take<uint64_t>(); }
  void f32(float& v) { v = std::bit_cast<float>(take<uint32_t>()); }
  void f64(double& v) { v = std::bit_cast<double>(take<uint64_t>()); }
  void vec3(Vec3& v) { f32(v.x), f32(v.y), f32(v.z); }
  void box(Box& b) { vec3(b.lo), vec3(b.hi); }
  void bytes(std::span<uint8_t> out) {
    for (uint8_t& b : out) b = take<uint8_t>();
  }
  // u16 length, then that many bytes.
  void text(std::string& s) {
    const size_t n = take<uint16_t>();
    if (!has(n)) return;
    s.assign(reinterpret_cast<const char*>(bytes_.data() + position_), n);
    position_ += n;
  }
  // Bytes that must be zero.
  void reserved(size_t n) {
    for (size_t i = 0; i < n; ++i)
      if (take<uint8_t>() != 0) reserved_used_ = true;
  }
  // Bytes that a reader of this version ignores.
  void unused(size_t n) {
    if (has(n)) position_ += n;
  }

  bool ok() const { return !failed_; }                 // nothing was read past the end
  bool reservedUsed() const { return reserved_used_; }  // some reserved byte was not zero
  size_t position() const { return position_; }
  size_t remaining() const { return bytes_.size() - position_; }
  std::span<const std::byte> rest() const { return bytes_.subspan(position_); }

 private:
  bool has(size_t n) {
    if (failed_ || n > bytes_.size() - position_) failed_ = true;
    return !failed_;
  }
  template <class T>
  T take() {
    if (!has(sizeof(T))) return 0;
    const T v = loadLittle<T>(bytes_.data() + position_);
    position_ += sizeof(T);
    return v;
  }

  std::span<const std::byte> bytes_;
  size_t position_ = 0;
  bool failed_ = false;
  bool reserved_used_ = false;
};

class ByteWriter {
 public:
  void u8(uint8_t v) { put(v); }
  void u16(uint16_t v) { put(v); }
  void u32(uint32_t v) { put(v); }
  void u64(uint64_t v) { put(v); }
  void f32(float v) { put(std::bit_cast<uint32_t>(v)); }
  void f64(double v) { put(std::bit_cast<uint64_t>(v)); }
  void vec3(Vec3 v) { f32(v.x), f32(v.y), f32(v.z); }
  void box(const Box& b) { vec3(b.lo), vec3(b.hi); }
  void bytes(std::span<const uint8_t> in) {
    for (uint8_t b : in) put(b);
  }
  // At most 65535 bytes; a longer text is cut.
  void text(const std::string& s) {
    const size_t n = s.size() < 65535 ? s.size() : 65535;
    u16(static_cast<uint16_t>(n));
    for (size_t i = 0; i < n; ++i) put(static_cast<uint8_t>(s[i]));
  }
  void reserved(size_t n) {
    for (size_t i = 0; i < n; ++i) bytes_.push_back(std::byte{0});
  }
  void unused(size_t n) { reserved(n); }

  std::vector<std::byte>& data() { return bytes_; }

 private:
  template <class T>
  void put(T v) {
    bytes_.resize(bytes_.size() + sizeof(T));
    storeLittle(bytes_.data() + bytes_.size() - sizeof(T), v);
  }
  std::vector<std::byte> bytes_;
};

}  // namespace ff::formats
