#include "bake/packing.h"

#include <zstd.h>

#include <memory>

#include "formats/codec/zstd_context.h"

namespace ff::bake {
namespace {

constexpr int kLevel = 1;
constexpr uint64_t kMostBytes = uint64_t{1} << 32;  // no part of anything comes near it

}  // namespace

// Contexts are as large as what they pack: each thread keeps one of each.
std::vector<std::byte> packed(std::span<const std::byte> raw) {
  thread_local const std::unique_ptr<ZSTD_CCtx, formats::FreeZstdContext> context(ZSTD_createCCtx());
  const size_t room = ZSTD_compressBound(raw.size());
  const auto frame = std::make_unique_for_overwrite<std::byte[]>(room);
  const size_t size = context ? ZSTD_compressCCtx(context.get(), frame.get(), room, raw.data(), raw.size(), kLevel) : 0;
  if (ZSTD_isError(size)) return {};
  return {frame.get(), frame.get() + size};
}

std::optional<std::vector<std::byte>> unpacked(std::span<const std::byte> frame, uint64_t bytes) {
  if (bytes > kMostBytes) return {};
  std::vector<std::byte> raw(bytes);
  thread_local const std::unique_ptr<ZSTD_DCtx, formats::FreeZstdContext> context(ZSTD_createDCtx());
  if (!context) return {};
  const size_t got = ZSTD_decompressDCtx(context.get(), raw.data(), raw.size(), frame.data(), frame.size());
  if (ZSTD_isError(got) || got != bytes) return {};
  return raw;
}

}  // namespace ff::bake
