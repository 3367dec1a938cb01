#include "bake/import/pictures.h"

#include <turbojpeg.h>
#include <webp/decode.h>

#include <cstdlib>
#include <cstring>
#include <memory>

// stb_image takes memory by what the picture says; this allocator holds it to the importer's budget.
namespace {
thread_local uint64_t allowed_bytes = 0;

void* limitedAllocate(size_t bytes) {
  if (bytes > allowed_bytes) return nullptr;
  return std::malloc(bytes);
}
void* limitedReallocate(void* p, size_t bytes) {
  if (bytes > allowed_bytes) return nullptr;
  return std::realloc(p, bytes);
}
}  // namespace

#define STBI_MALLOC(bytes) limitedAllocate(bytes)
#define STBI_REALLOC(p, bytes) limitedReallocate(p, bytes)
#define STBI_FREE(p) std::free(p)
#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#define STBI_NO_STDIO
#include <stb_image.h>

namespace ff::bake::gltf {
namespace {

// What a byte of a file can come to. DEFLATE: RFC 1951, 258 bytes for 2 bits. JPEG: a block of 64 samples takes 2 bits in
// a sequential scan, less in a progressive one, and may stand for four pixels a sample.
constexpr uint64_t kMaxInflated = 1032, kMaxJpegPixels = 4096;

enum class Format { kPng, kJpeg, kWebp, kOther };
struct Signature {
  const char* name;
  Format format;
  size_t at;
  std::string_view bytes;
};
using namespace std::string_view_literals;
constexpr Signature kSignatures[] = {{"PNG", Format::kPng, 0, "\x89PNG\r\n\x1a\n"sv},
                                     {"JPEG", Format::kJpeg, 0, "\xff\xd8\xff"sv},
                                     {"WebP", Format::kWebp, 8, "WEBP"sv},
                                     {"KTX2", Format::kOther, 0, "\xabKTX 20\xbb"sv},
                                     {"KTX", Format::kOther, 0, "\xabKTX 11\xbb"sv},
                                     {"Basis Universal", Format::kOther, 0, "sB"sv},
                                     {"DDS", Format::kOther, 0, "DDS "sv},
                                     {"AVIF", Format::kOther, 4, "ftypavif"sv},
                                     {"GIF", Format::kOther, 0, "GIF8"sv},
                                     {"BMP", Format::kOther, 0, "BM"sv},
                                     {"TIFF", Format::kOther, 0, "II*\0"sv},
                                     {"OpenEXR", Format::kOther, 0, "\x76\x2f\x31\x01"sv},
                                     {"Radiance HDR", Format::kOther, 0, "#?RADIANCE"sv}};

const Signature* signatureOf(const Bytes& bytes) {
  for (const Signature& s : kSignatures)
    if (bytes.size >= s.at + s.bytes.size() && std::memcmp(bytes.data + s.at, s.bytes.data(), s.bytes.size()) == 0)
      return &s;
  return nullptr;
}

uint32_t bigEndian(const uint8_t* p) {
  return uint32_t{p[0]} << 24 | uint32_t{p[1]} << 16 | uint32_t{p[2]} << 8 | uint32_t{p[3]};
}

struct JpegClose {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using Jpeg = std::unique_ptr<void, JpegClose>;

// Portable Network Graphics Specification, second edition. 2003, section 11.2.2.
PictureSize pngSize(const Bytes& bytes, const std::string& place) {
  constexpr uint64_t kSignature = 8, kChunkFrame = 12, kHeaderEnd = 33;
  if (bytes.size < kHeaderEnd || std::memcmp(bytes.data + 12, "IHDR", 4) != 0) refuse(place, "the PNG has no header");
  const PictureSize size{bigEndian(bytes.data + 16), bigEndian(bytes.data + 20)};
  const uint64_t depth = bytes.data[24], colour = bytes.data[25];
  const uint64_t channels = colour == 2 ? 3 : colour == 4 ? 2 : colour == 6 ? 4 : 1;
  if (size.width > (1u << 24) || size.height > (1u << 24)) refuse(place, "more than 2^24 pixels wide or high");
  uint64_t compressed = 0;
  for (uint64_t at = kSignature; bytes.size - at >= kChunkFrame;) {
    const uint64_t length = std::min<uint64_t>(bigEndian(bytes.data + at), bytes.size - at - kChunkFrame);
    if (std::memcmp(bytes.data + at + 4, "IDAT", 4) == 0) compressed += length;
    at += length + kChunkFrame;
  }
  const uint64_t row = (uint64_t{size.width} * channels * depth + 7) / 8 + 1;
  if (row * size.height > compressed * kMaxInflated) refuse(place, "the PNG is cut short");
  return size;
}

PictureSize jpegSize(tjhandle jpeg, const Bytes& bytes, const std::string& place) {
  int width = 0, height = 0, sampling = 0, space = 0;
  if (tjDecompressHeader3(jpeg, bytes.data, static_cast<unsigned long>(bytes.size), &width, &height, &sampling, &space) != 0)
    refuse(place, "broken JPEG: " + printable(tjGetErrorStr2(jpeg)));
  if (space == TJCS_CMYK || space == TJCS_YCCK) refuse(place, "a JPEG of four inks, which glTF does not allow");
  const PictureSize size{static_cast<uint32_t>(width), static_cast<uint32_t>(height)};
  if (uint64_t{size.width} * size.height > bytes.size * kMaxJpegPixels) refuse(place, "the JPEG is cut short");
  return size;
}

PictureSize webpSize(const Bytes& bytes, const std::string& place) {
  int width = 0, height = 0;
  if (!WebPGetInfo(bytes.data, bytes.size, &width, &height)) refuse(place, "the WebP has no header");
  return {static_cast<uint32_t>(width), static_cast<uint32_t>(height)};
}

void decodePng(const Bytes& bytes, const std::string& place, Image& out) {
  int width = 0, height = 0, channels = 0;
  std::unique_ptr<stbi_uc, void (*)(void*)> decoded(
      stbi_load_from_memory(bytes.data, static_cast<int>(bytes.size), &width, &height, &channels, 4), std::free);
  if (!decoded || static_cast<uint32_t>(width) != out.width || static_cast<uint32_t>(height) != out.height)
    refuse(place, "broken PNG: " + printable(decoded ? "two sizes" : stbi_failure_reason()));
  std::memcpy(out.rgba.data(), decoded.get(), out.rgba.size());
}

void decodeJpeg(const Bytes& bytes, const std::string& place, Image& out) {
  const Jpeg jpeg(tjInitDecompress());
  // A warning (bytes missing at the end) leaves a picture all the same.
  if (tjDecompress2(jpeg.get(), bytes.data, static_cast<unsigned long>(bytes.size), out.rgba.data(),
                    static_cast<int>(out.width), 0, static_cast<int>(out.height), TJPF_RGBA, TJFLAG_LIMITSCANS) != 0 &&
      tjGetErrorCode(jpeg.get()) != TJERR_WARNING)
    refuse(place, "broken JPEG: " + printable(tjGetErrorStr2(jpeg.get())));
}

void decodeWebp(const Bytes& bytes, const std::string& place, Image& out) {
  if (!WebPDecodeRGBAInto(bytes.data, bytes.size, out.rgba.data(), out.rgba.size(), static_cast<int>(4 * out.width)))
    refuse(place, "broken WebP");
}

Format readable(const Bytes& bytes, const std::string& place) {
  const Signature* signature = signatureOf(bytes);
  if (!signature || signature->format == Format::kOther)
    refuse(place, std::string("a picture in ") + pictureFormat(bytes) + ", none of PNG, JPEG and WebP");
  if (bytes.size > kMaxPictureBytes) refuse(place, "larger than 1 GiB");
  return signature->format;
}

}  // namespace

const char* pictureFormat(const Bytes& bytes) {
  const Signature* signature = signatureOf(bytes);
  return signature ? signature->name : "an unknown format";
}

PictureSize pictureSize(const Bytes& bytes, const std::string& place) {
  const Format format = readable(bytes, place);
  const PictureSize size = format == Format::kPng    ? pngSize(bytes, place)
                           : format == Format::kJpeg ? jpegSize(Jpeg(tjInitDecompress()).get(), bytes, place)
                                                     : webpSize(bytes, place);
  if (size.bytes() == 0) refuse(place, "a picture without pixels");
  return size;
}

Image decodePicture(const Bytes& bytes, const std::string& place, Budget& budget) {
  const PictureSize size = pictureSize(bytes, place);
  budget.take(size.bytes() * 3, place);  // decoders hold up to two more copies (16-bit channels, coefficients)
  allowed_bytes = size.bytes() * 2 + (1 << 20);
  Image out{size.width, size.height, {}};
  try {
    out.rgba.resize(size.bytes());
    const Format format = signatureOf(bytes)->format;
    (format == Format::kPng ? decodePng : format == Format::kJpeg ? decodeJpeg : decodeWebp)(bytes, place, out);
  } catch (...) {
    budget.give(size.bytes() * 3);
    throw;
  }
  budget.give(size.bytes() * 2);
  return out;
}

}  // namespace ff::bake::gltf
