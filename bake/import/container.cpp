#include "bake/import/container.h"

#include <sys/stat.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>

namespace ff::bake::gltf {
namespace {

constexpr uint32_t kMagic = 0x46546c67;      // "glTF"
constexpr uint32_t kJsonChunk = 0x4e4f534a;  // "JSON"
constexpr uint32_t kBinChunk = 0x004e4942;   // "BIN\0"
constexpr uint64_t kHeaderBytes = 12, kChunkHeaderBytes = 8;
constexpr size_t kDeepest = 512;  // nesting of JSON values; the glTF schema needs about 10
// What a piece of JSON comes to at its peak: parsed, validated and parsed again, and as tinygltf's structures (measured
// with 50,000 objects of each kind; materials, which come to more, are counted where they are read).
constexpr uint64_t kObjectBytes = 900, kArrayBytes = 100, kMemberBytes = 150, kElementBytes = 100, kCharacterBytes = 4;

struct FileCloser {
  void operator()(FILE* f) const { std::fclose(f); }
};
using File = std::unique_ptr<FILE, FileCloser>;

File open(const std::string& path, const std::string& place, uint64_t* bytes) {
  struct stat info {};
  if (stat(path.c_str(), &info) != 0)
    refuseIo(place, "cannot be opened: " + std::string(std::strerror(errno)), "check that it is there");
  if (!S_ISREG(info.st_mode)) refuseIo(place, "is not a regular file", "name a .gltf or .glb file");
  File file(std::fopen(path.c_str(), "rbe"));
  if (!file) refuseIo(place, "cannot be opened: " + std::string(std::strerror(errno)), "check that it is there");
  *bytes = static_cast<uint64_t>(info.st_size);
  return file;
}

void read(FILE* file, void* out, uint64_t bytes, const std::string& place) {
  if (bytes && std::fread(out, 1, bytes, file) != bytes) refuseIo(place, "ends early or cannot be read", "try again");
}

uint32_t littleEndian(const uint8_t* p) {
  return uint32_t{p[0]} | uint32_t{p[1]} << 8 | uint32_t{p[2]} << 16 | uint32_t{p[3]} << 24;
}

// Refuses text whose tree would be too deep or too large, before any of it is built.
uint64_t checkJsonShape(const std::string& text) {
  size_t depth = 0;
  uint64_t bytes = kObjectBytes;
  bool quoted = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      bytes += kCharacterBytes;
      if (c == '\\') ++i;
      if (c == '"') quoted = false;
      continue;
    }
    switch (c) {
      case '"':
        quoted = true;
        break;
      case ',':
        bytes += kElementBytes;
        break;
      case ':':
        bytes += kMemberBytes;
        break;
      case ']':
      case '}':
        depth -= depth > 0;
        break;
      case '[':
      case '{':
        bytes += c == '{' ? kObjectBytes : kArrayBytes;
        if (++depth > kDeepest)
          refuse("offset " + std::to_string(i), "JSON is nested more than " + std::to_string(kDeepest) + " deep");
        break;
      default:
        break;
    }
  }
  return bytes;
}

Json parseJson(std::string text, Container& out, Budget& budget) {
  out.json_bytes = checkJsonShape(text);
  budget.take(out.json_bytes, "JSON");
  if (text.size() >= 3 && text.compare(0, 3, "\xef\xbb\xbf") == 0)
    refuse("offset 0", "JSON starts with a byte order mark");
  while (!text.empty() && text.back() == ' ') text.pop_back();  // chunk padding
  try {
    return Json::parse(text);
  } catch (const Json::parse_error& e) {
    std::string what = e.what();  // "[json.exception...] parse error at line 1, column 5: what follows"
    const size_t at = what.find("column");
    const size_t colon = at == std::string::npos ? at : what.find(": ", at);
    refuse("offset " + std::to_string(e.byte),
           "JSON: " + printable(colon == std::string::npos ? what : what.substr(colon + 2)));
  } catch (const Json::exception& e) {
    const std::string what = e.what();
    const size_t bracket = what.find("] ");
    refuse("JSON", printable(bracket == std::string::npos ? what : what.substr(bracket + 2)));
  }
}

void readGlb(FILE* file, uint64_t file_bytes, Container& out, std::string& text, Budget& budget,
             std::vector<std::string>& warnings) {
  std::array<uint8_t, kHeaderBytes> header;
  if (file_bytes < kHeaderBytes) refuse("offset 0", "the GLB header is cut short", "fetch the file again");
  read(file, header.data(), header.size(), "offset 0");
  if (const uint32_t version = littleEndian(&header[4]); version != 2)
    refuse("offset 4", "GLB container version " + std::to_string(version) + ", only 2 can be read");
  const uint64_t length = littleEndian(&header[8]);
  if (length > file_bytes)
    refuse("offset 8",
           "the header promises " + std::to_string(length) + " bytes, the file has " + std::to_string(file_bytes),
           "fetch the file again");
  if (length < file_bytes) warnings.push_back("bytes after the end of the GLB container are ignored");
  uint64_t offset = kHeaderBytes;
  bool has_json = false;
  for (uint32_t chunk = 0; offset < length; ++chunk) {
    const std::string place = "offset " + std::to_string(offset);
    if (length - offset < kChunkHeaderBytes) refuse(place, "a chunk header is cut short");
    std::array<uint8_t, kChunkHeaderBytes> head;
    read(file, head.data(), head.size(), place);
    const uint64_t bytes = littleEndian(&head[0]);
    const uint32_t type = littleEndian(&head[4]);
    offset += kChunkHeaderBytes;
    if (bytes > length - offset)
      refuse(place,
             "a chunk of " + std::to_string(bytes) + " bytes, only " + std::to_string(length - offset) + " are left");
    if (bytes % 4) refuse(place, "chunk length " + std::to_string(bytes) + " is no multiple of 4");
    if (chunk == 0 && type != kJsonChunk) refuse(place, "the first chunk must be JSON");
    if (type == kJsonChunk) {
      if (has_json) refuse(place, "a second JSON chunk");
      has_json = true;
      budget.take(bytes, place);
      text.resize(bytes);
      read(file, text.data(), bytes, place);
    } else if (type == kBinChunk) {
      if (chunk != 1) refuse(place, "the BIN chunk must come once, right after JSON");
      out.has_bin = true;
      budget.take(bytes, place);
      out.bin.resize(bytes);
      read(file, out.bin.data(), bytes, place);
    } else if (std::fseek(file, static_cast<long>(bytes), SEEK_CUR) != 0) {  // chunks of other types are to be ignored
      refuseIo(place, "cannot seek");
    }
    offset += bytes;
  }
  if (!has_json) refuse("offset 12", "the JSON chunk is missing");
}

int base64Digit(char c) {
  if (c >= 'A' && c <= 'Z') return c - 'A';
  if (c >= 'a' && c <= 'z') return c - 'a' + 26;
  if (c >= '0' && c <= '9') return c - '0' + 52;
  if (c == '+') return 62;
  if (c == '/') return 63;
  return -1;
}

int hexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

std::string decodePercent(const std::string& text) {
  std::string decoded;
  for (size_t i = 0; i < text.size(); ++i) {
    const int high = text[i] == '%' && i + 2 < text.size() ? hexDigit(text[i + 1]) : -1;
    const int low = high < 0 ? -1 : hexDigit(text[i + 2]);
    if (low < 0) {  // a bare '%' comes from exporters that do not encode names
      decoded += text[i];
      continue;
    }
    decoded += static_cast<char>(high * 16 + low);
    i += 2;
  }
  return decoded;
}

}  // namespace

Container readContainer(const std::string& path, Budget& budget, std::vector<std::string>& warnings) {
  Container out;
  const size_t slash = path.rfind('/');
  out.folder = slash == std::string::npos ? "" : path.substr(0, slash + 1);
  uint64_t file_bytes = 0;
  const File file = open(path, "", &file_bytes);
  if (file_bytes == 0) refuse("offset 0", "the file is empty", "fetch the file again");
  std::array<uint8_t, 4> magic{};
  if (file_bytes >= magic.size()) read(file.get(), magic.data(), magic.size(), "offset 0");
  std::rewind(file.get());
  std::string text;
  out.is_glb = littleEndian(magic.data()) == kMagic;
  if (out.is_glb) {
    readGlb(file.get(), file_bytes, out, text, budget, warnings);
  } else {
    budget.take(file_bytes, "file");
    text.resize(file_bytes);
    read(file.get(), text.data(), file_bytes, "offset 0");
    const size_t start = text.find_first_not_of(" \t\r\n");
    if (start == std::string::npos || (text[start] != '{' && text.compare(0, 3, "\xef\xbb\xbf") != 0))
      refuse("offset 0", "neither GLB (no \"glTF\" magic) nor a JSON object in UTF-8", "export as glTF 2.0");
  }
  const uint64_t text_bytes = text.size();
  out.json = parseJson(std::move(text), out, budget);
  budget.give(text_bytes);
  return out;
}

bool isDataUri(const std::string& uri) { return uri.compare(0, 5, "data:") == 0; }

std::vector<uint8_t> decodeDataUri(const std::string& uri, const std::string& place, Budget& budget) {
  const size_t comma = uri.find(',');
  if (comma == std::string::npos) refuse(place, "the data URI has no comma");
  if (comma < 7 || uri.compare(comma - 7, 7, ";base64") != 0) {
    budget.take(uri.size(), place);
    const std::string text = decodePercent(uri.substr(comma + 1));
    return {text.begin(), text.end()};
  }
  size_t end = uri.size();
  while (end > comma + 1 && uri.size() - end < 2 && uri[end - 1] == '=') --end;
  const size_t digits = end - comma - 1;
  if (digits % 4 == 1) refuse(place, "the data URI's base64 is cut short");
  budget.take(digits / 4 * 3 + 3, place);
  std::vector<uint8_t> out;
  out.reserve(digits / 4 * 3 + 3);
  uint32_t bits = 0;
  int held = 0;
  for (size_t i = comma + 1; i < end; ++i) {
    const int digit = base64Digit(uri[i]);
    if (digit < 0) refuse(place, "the data URI's character " + std::to_string(i) + " is not base64");
    bits = bits << 6 | static_cast<uint32_t>(digit);
    held += 6;
    if (held >= 8) {
      held -= 8;
      out.push_back(static_cast<uint8_t>(bits >> held));
    }
  }
  return out;
}

std::string resolveUri(const std::string& uri, const std::string& folder, const std::string& place) {
  const std::string decoded = decodePercent(uri);
  const std::string remedy = "keep the file beside the scene and name it relatively";
  if (decoded.empty()) refuse(place, "the URI is empty", remedy);
  if (decoded.find('\0') != std::string::npos) refuse(place, "the URI holds a NUL byte", remedy);
  if (decoded[0] == '/' || decoded[0] == '\\') refuse(place, "absolute path \"" + printable(decoded) + "\"", remedy);
  const size_t colon = decoded.find(':');
  if (colon != std::string::npos && colon < decoded.find('/'))
    refuse(place, "URI with a scheme, \"" + printable(decoded) + "\"", remedy);
  // Step by step, so that "a/../b" passes and "../b" or "a/../../b" does not.
  int depth = 0;
  for (size_t start = 0; start <= decoded.size();) {
    const size_t end = std::min(decoded.find_first_of("/\\", start), decoded.size());
    const std::string part = decoded.substr(start, end - start);
    if (part == "..")
      --depth;
    else if (!part.empty() && part != ".")
      ++depth;
    if (depth < 0) refuse(place, "\"" + printable(decoded) + "\" leaves the scene's folder", remedy);
    start = end + 1;
  }
  return folder + decoded;
}

std::vector<uint8_t> readFile(const std::string& path, uint64_t most, const std::string& place, Budget& budget) {
  uint64_t bytes = 0;
  const size_t slash = path.rfind('/');
  const std::string where =
      place + ": \"" + printable(slash == std::string::npos ? path : path.substr(slash + 1)) + "\"";
  const File file = open(path, where, &bytes);
  bytes = std::min(bytes, most);
  budget.take(bytes, place);
  std::vector<uint8_t> out(bytes);
  read(file.get(), out.data(), bytes, where);
  return out;
}

}  // namespace ff::bake::gltf
