#include "bake/import/images.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "bake/import/pictures.h"
#include "formats/portable_math.h"

namespace ff::bake::gltf {
namespace {

const char* const kStandInRemedy = "a stand-in takes its place";

Pictures::Means meansOf(const Image& image) {
  std::array<std::array<uint64_t, 256>, 4> histogram{};
  for (size_t i = 0; i < image.rgba.size(); ++i) ++histogram[i % 4][image.rgba[i]];
  Pictures::Means out;
  const double pixels = static_cast<double>(image.rgba.size() / 4);
  for (size_t c = 0; c < 4; ++c) {
    double stored = 0, linear = 0;
    for (uint32_t v = 0; v < 256; ++v) {
      stored += static_cast<double>(histogram[c][v]) * (v / 255.0);
      linear += static_cast<double>(histogram[c][v]) * static_cast<double>(srgbToLinear(v));
    }
    out.stored[c] = static_cast<float>(stored / pixels);
    out.linear[c] = c == 3 ? out.stored[c] : static_cast<float>(linear / pixels);
  }
  return out;
}

}  // namespace

Pictures::Source Pictures::open(uint32_t image) {
  const ImageSource& from = document_.images[image];
  Source out;
  out.place = "image " + std::to_string(image);
  if (from.view >= 0) {
    out.bytes = viewBytes(document_, from.view, out.place);
  } else {
    if (from.uri.empty()) refuse(out.place, "names no picture");
    out.owned = isDataUri(from.uri)
                    ? decodeDataUri(from.uri, out.place, budget_)
                    : readFile(resolveUri(from.uri, document_.folder, out.place), kMaxPictureBytes, out.place, budget_);
    budget_.give(out.owned.size());
    out.bytes = {out.owned.data(), out.owned.size()};
  }
  const XXH128_hash_t hash = XXH3_128bits(out.bytes.data, out.bytes.size);
  out.key = {hash.high64, hash.low64};
  return out;
}

Image Pictures::decode(const Source& source) {
  const uint64_t bytes = pictureSize(source.bytes, source.place).bytes();
  if (bytes > decodable_) refuse(source.place, "the file's pictures come to too many pixels");
  decodable_ -= bytes;
  return decodePicture(source.bytes, source.place, budget_);
}

template <class Value, class Make>
std::optional<Value> Pictures::firstOf(int texture, std::map<Key, Value>& known, const Make& make) {
  const std::vector<uint32_t>& images = document_.texture_images[static_cast<size_t>(texture)];
  std::string line = "texture " + std::to_string(texture) + ": names no image; " + kStandInRemedy;
  for (const uint32_t image : images) {
    std::optional<Error> error;
    if (const auto key = keys_.find(image); key != keys_.end()) {
      if (const auto value = known.find(key->second); value != known.end()) return value->second;
      if (const auto fault = faults_.find(key->second); fault != faults_.end()) error = fault->second;
    }
    if (!error) {
      std::optional<Key> key;
      try {
        const Source source = open(image);
        key = keys_[image] = source.key;
        if (const auto value = known.find(*key); value != known.end()) return value->second;
        const auto fault = faults_.find(*key);
        if (fault == faults_.end()) return known.emplace(*key, make(source)).first->second;
        error = fault->second;
      } catch (const ImportError& fault) {
        error = fault.error;
        if (key) faults_.emplace(*key, *error);
      }
    }
    if (image != images.front()) continue;
    error->place = "image " + std::to_string(image);
    error->remedy = kStandInRemedy;
    line = error->line();
  }
  // Once a texture without images, an image that is not there, or a picture, whatever images name it.
  Key said{~uint64_t{0}, images.empty() ? static_cast<uint64_t>(texture) : uint64_t{1} << 32 | images.front()};
  if (!images.empty() && keys_.count(images.front())) said = keys_.at(images.front());
  if (said_.insert(said).second) scene_.warnings.push_back(line);
  return {};
}

uint32_t Pictures::number(int texture) {
  return firstOf(texture, numbers_, [&](const Source& source) {
           scene_.images.push_back(decode(source));
           return static_cast<uint32_t>(scene_.images.size() - 1);
         })
      .value_or(kNone);
}

std::optional<Pictures::Means> Pictures::means(int texture) {
  return firstOf(texture, means_, [&](const Source& source) {
    if (const auto kept = numbers_.find(source.key); kept != numbers_.end()) return meansOf(scene_.images[kept->second]);
    const Image picture = decode(source);
    budget_.give(picture.rgba.size());
    return meansOf(picture);
  });
}

}  // namespace ff::bake::gltf
