#include "bake/gltf_images.h"

#include <cstdlib>
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
#define STBI_ONLY_JPEG
#define STBI_NO_STDIO
#include <stb_image.h>

namespace ff::bake::gltf {
namespace {

constexpr uint64_t kLargestFile = uint64_t{1} << 30;  // stb_image counts in int

Image decode(const Bytes& bytes, const std::string& place, Budget& budget) {
  if (bytes.size > kLargestFile) refuse(place, "larger than 1 GiB");
  int width = 0, height = 0, channels = 0;
  const int size = static_cast<int>(bytes.size);
  allowed_bytes = uint64_t{1} << 20;  // enough for the headers
  if (!stbi_info_from_memory(bytes.data, size, &width, &height, &channels) || width < 1 || height < 1)
    refuse(place, "neither a PNG nor a JPEG that can be read");
  const uint64_t pixels = static_cast<uint64_t>(width) * static_cast<uint64_t>(height) * 4;
  budget.take(pixels * 3, place);  // the decoder holds up to two more copies (16-bit channels, filtered rows)
  allowed_bytes = pixels * 2 + (1 << 20);
  std::unique_ptr<stbi_uc, void (*)(void*)> decoded(
      stbi_load_from_memory(bytes.data, size, &width, &height, &channels, 4), std::free);
  budget.give(pixels * 2);
  if (!decoded) {
    budget.give(pixels);
    refuse(place, "broken picture: " + printable(stbi_failure_reason()));
  }
  Image out;
  out.width = static_cast<uint32_t>(width);
  out.height = static_cast<uint32_t>(height);
  out.rgba.assign(decoded.get(), decoded.get() + pixels);
  return out;
}

}  // namespace

std::optional<Image> readImage(const Document& document, uint32_t image, const std::string& instead, Budget& budget,
                               std::vector<std::string>& warnings) {
  const ImageSource& source = document.images[image];
  const std::string place = "image " + std::to_string(image);
  try {
    if (source.view >= 0) return decode(viewBytes(document, source.view, place), place, budget);
    if (source.uri.empty()) refuse(place, "has no PNG or JPEG source");
    const std::vector<uint8_t> file =
        isDataUri(source.uri) ? decodeDataUri(source.uri, place, budget)
                              : readFile(resolveUri(source.uri, document.folder, place), kLargestFile, place, budget);
    budget.give(file.size());
    return decode({file.data(), file.size()}, place, budget);
  } catch (const Fault& fault) {
    Error error = fault.error;
    error.remedy = instead;
    warnings.push_back(error.line());
    return {};
  }
}

}  // namespace ff::bake::gltf
