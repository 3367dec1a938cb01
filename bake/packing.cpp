#include "bake/packing.h"

#include <zstd.h>

namespace ff::bake {
namespace {

constexpr int kLevel = 1;
constexpr uint64_t kMostBytes = uint64_t{1} << 32;  // no part of anything comes near it

}  // namespace

std::vector<std::byte> packed(std::span<const std::byte> raw) {
  std::vector<std::byte> frame(ZSTD_compressBound(raw.size()));
  const size_t size = ZSTD_compress(frame.data(), frame.size(), raw.data(), raw.size(), kLevel);
  frame.resize(ZSTD_isError(size) ? 0 : size);
  return frame;
}

std::optional<std::vector<std::byte>> unpacked(std::span<const std::byte> frame, uint64_t bytes) {
  if (bytes > kMostBytes) return {};
  std::vector<std::byte> raw(bytes);
  const size_t got = ZSTD_decompress(raw.data(), raw.size(), frame.data(), frame.size());
  if (ZSTD_isError(got) || got != bytes) return {};
  return raw;
}

}  // namespace ff::bake
