// Bytes to JSON and buffers: the .glb container, the JSON text, URIs (percent- and base64-decoding, confined to the
// file's folder). Khronos Group. glTF 2.0 Specification. 2021, sections 3.6 and 4. Private to this folder.
#pragma once
#include <string>
#include <vector>

#include "bake/import/json.h"

namespace ff::bake::gltf {

struct Container {
  Json json;
  uint64_t json_bytes = 0;   // taken from the budget for `json` and what grows out of it
  std::vector<uint8_t> bin;  // the BIN chunk
  bool has_bin = false, is_glb = false;
  std::string folder;  // of the file, with a trailing '/', or ""
};

// Reads the file and parses its JSON. Budget is taken for the text, the parsed values and the BIN chunk; the text's is
// given back.
Container readContainer(const std::string& path, Budget& budget, std::vector<std::string>& warnings);

bool isDataUri(const std::string& uri);
// The decoded payload, base64 or percent-encoded.
std::vector<uint8_t> decodeDataUri(const std::string& uri, const std::string& place, Budget& budget);
// Path of a relative URI: no scheme, not absolute, never above `folder`; refuses others.
std::string resolveUri(const std::string& uri, const std::string& folder, const std::string& place);
// At most `most` bytes of a regular file; kIo faults.
std::vector<uint8_t> readFile(const std::string& path, uint64_t most, const std::string& place, Budget& budget);

}  // namespace ff::bake::gltf
