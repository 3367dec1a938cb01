// Ownership of zstd's contexts: std::unique_ptr<ZSTD_DCtx, FreeZstdContext>. For sources that see zstd themselves.
#pragma once
#include <zstd.h>

namespace ff::formats {

struct FreeZstdContext {
  void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
  void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
};

}  // namespace ff::formats
