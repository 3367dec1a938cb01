#include "bake/import/meshopt_vertices.h"

#include <algorithm>
#include <array>
#include <bit>

namespace ff::bake::gltf {
namespace {

constexpr uint64_t kGroup = 16;          // elements
constexpr uint64_t kLargestBlock = 256;  // elements
constexpr uint64_t kBlockBytes = 8192;

// Takes bytes from the front of what is left of the stream, or says that there are too few.
class Cursor {
 public:
  explicit Cursor(std::span<const uint8_t> bytes) : left_(bytes) {}
  bool take(uint64_t n, std::span<const uint8_t>* out) {
    if (n > left_.size()) return false;
    *out = left_.first(n);
    left_ = left_.subspan(n);
    return true;
  }
  std::span<const uint8_t> left() const { return left_; }

 private:
  std::span<const uint8_t> left_;
};

// One group: 16 codes of `bits` bits; a code of all ones stands for a byte that follows the codes.
bool readGroup(Cursor& cursor, uint32_t bits, std::span<uint8_t> out) {
  if (bits == 0) {
    std::fill(out.begin(), out.end(), uint8_t{0});
    return true;
  }
  std::span<const uint8_t> codes;
  if (!cursor.take(kGroup * bits / 8, &codes)) return false;
  const uint32_t sentinel = (1u << bits) - 1;
  for (uint32_t i = 0; i < kGroup; ++i) {
    const uint32_t at = i * bits % 8;
    const uint32_t shift =
        bits == 1 ? at : 8 - bits - at;  // single bits run from the lowest, wider codes from the highest
    const uint32_t code = (uint32_t{codes[i * bits / 8]} >> shift) & sentinel;
    out[i] = static_cast<uint8_t>(code);
    if (bits < 8 && code == sentinel) {
      std::span<const uint8_t> whole;
      if (!cursor.take(1, &whole)) return false;
      out[i] = whole[0];
    }
  }
  return true;
}

// The deltas of one byte position over a block.
bool readDeltas(Cursor& cursor, uint32_t version, uint32_t control, uint64_t count, std::span<uint8_t> out) {
  if (version == 1 && control == 2) {
    std::fill_n(out.begin(), count, uint8_t{0});
    return true;
  }
  if (version == 1 && control == 3) {
    std::span<const uint8_t> literal;
    if (!cursor.take(count, &literal)) return false;
    std::copy(literal.begin(), literal.end(), out.begin());
    return true;
  }
  constexpr std::array<std::array<uint32_t, 4>, 3> kBits = {{{0, 1, 2, 4}, {1, 2, 4, 8}, {0, 2, 4, 8}}};
  const auto& bits = kBits[version == 0 ? 2 : control];
  const uint64_t groups = (count + kGroup - 1) / kGroup;
  std::span<const uint8_t> header;
  if (!cursor.take((groups + 3) / 4, &header)) return false;
  for (uint64_t g = 0; g < groups; ++g)
    if (!readGroup(cursor, bits[(header[g / 4] >> (g % 4 * 2)) & 3], out.subspan(g * kGroup, kGroup))) return false;
  return true;
}

// Undoes the deltas of `width`-byte values; previous holds the last element's bytes of this channel.
uint32_t undo(uint32_t delta, uint32_t previous, uint32_t mode, uint32_t rotation) {
  if (mode == 2) return std::rotl(delta, static_cast<int>((32 - rotation) & 31)) ^ previous;
  return ((delta & 1) ? ~(delta >> 1) : delta >> 1) + previous;
}

}  // namespace

bool decodeMeshoptVertices(std::span<const uint8_t> stream, uint64_t stride, std::span<uint8_t> out) {
  if (stream.empty() || (stream[0] & 0xf0) != 0xa0) return false;
  const uint32_t version = stream[0] & 0x0f;
  if (version > 1) return false;
  const uint64_t channels = stride / 4;
  const uint64_t tail = stride + (version == 1 ? channels : 0),
                 padded_tail = std::max<uint64_t>(tail, version == 1 ? 24 : 32);
  if (stream.size() < 1 + padded_tail) return false;
  std::array<uint8_t, 256> previous{};
  std::copy_n(stream.end() - static_cast<std::ptrdiff_t>(tail), stride, previous.begin());
  const std::span<const uint8_t> modes = stream.last(version == 1 ? channels : 0);
  Cursor cursor(stream.subspan(1, stream.size() - 1 - padded_tail));

  const uint64_t largest = std::min(kBlockBytes / stride & ~(kGroup - 1), kLargestBlock);
  std::array<std::array<uint8_t, kLargestBlock>, 4> deltas;
  for (uint64_t first = 0, total = out.size() / stride; first < total;) {
    const uint64_t count = std::min(largest, total - first);
    std::span<const uint8_t> controls;
    if (version == 1 && !cursor.take(channels, &controls)) return false;
    for (uint64_t channel = 0; channel < channels; ++channel) {
      for (uint32_t b = 0; b < 4; ++b) {
        const uint32_t control = version == 1 ? (controls[channel] >> (2 * b)) & 3u : 0;
        if (!readDeltas(cursor, version, control, count, deltas[b])) return false;
      }
      const uint32_t mode = version == 1 ? modes[channel] & 15u : 0, rotation = version == 1 ? modes[channel] >> 4 : 0;
      if (mode > 2 || (mode < 2 && rotation)) return false;
      const uint32_t width = 1u << mode;  // bytes: 1, 2, 4
      for (uint32_t at = 0; at < 4; at += width) {
        uint8_t* last = &previous[channel * 4 + at];
        for (uint64_t i = 0; i < count; ++i) {
          uint32_t delta = 0, before = 0;
          for (uint32_t b = 0; b < width; ++b) {
            delta |= uint32_t{deltas[at + b][i]} << (8 * b);
            before |= uint32_t{last[b]} << (8 * b);
          }
          const uint32_t value = undo(delta, before, mode, rotation);
          for (uint32_t b = 0; b < width; ++b)
            last[b] = out[(first + i) * stride + channel * 4 + at + b] = static_cast<uint8_t>(value >> (8 * b));
        }
      }
    }
    first += count;
  }
  return cursor.left().empty();
}

}  // namespace ff::bake::gltf
