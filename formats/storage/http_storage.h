// Worlds behind a web server, read by ranges of bytes over http and https (Fielding, Nottingham, Reschke. RFC 9110: HTTP Semantics. 2022). Read only.
// Opening asks for the first kFirstRange bytes, by which the file's size and version (ETag, Last-Modified) are known; each read is one request for just its
// bytes, on a connection that is kept for the next, as many at a time as threads read. What the server answers must be that range of
// that version, uncompressed; anything else is an error (kIo) with address, offset and remedy. A request that fails in a way that may
// pass (no connection, a connection that breaks or stands still, 408, 429, 5xx) is made once more.
// A server without ranges answers with the whole file: what is wanted is taken from it where it lies within the first kMaxWithoutRanges bytes.
// Certificates are checked, by CURL_CA_BUNDLE or SSL_CERT_FILE where one is set; names and passwords come from ~/.netrc; http_proxy and the like count.
#pragma once
#include <chrono>

#include "formats/storage/storage.h"

namespace ff::formats {

inline constexpr uint64_t kFirstRange = 64 << 10;
inline constexpr uint64_t kMaxWithoutRanges = 8 << 20;

struct HttpSettings {
  std::chrono::seconds connect{10};  // until there is a connection, at most
  std::chrono::seconds stall{20};    // without a byte, before a request counts as failed
};

// Thread-safe. A Formfield that was built without libcurl refuses every address, in one line that says so.
StoragePtr httpStorage(const HttpSettings& settings = {});

}  // namespace ff::formats
