// PNG, JPEG and WebP to RGBA. Private to this folder; the only file that sees stb_image, libjpeg-turbo and libwebp.
#pragma once
#include <string>

#include "bake/import/elements.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

inline constexpr uint64_t kMaxPictureBytes = uint64_t{1} << 30;  // the decoders count in int

// What the bytes are by their first ones: "PNG", "JPEG", "WebP", "KTX2", "DDS", ..., "an unknown format".
const char* pictureFormat(const Bytes& bytes);

// Size as the header says; refuses formats that cannot be read, and a header that promises more than the bytes can
// hold.
struct PictureSize {
  uint32_t width = 0, height = 0;
  uint64_t bytes() const { return uint64_t{width} * height * 4; }  // as RGBA
};
PictureSize pictureSize(const Bytes& bytes, const std::string& place);

// Takes the picture's bytes from the budget, which stay taken; refuses what is broken. 16-bit channels are halved. Colour
// profiles and gamma are ignored, as glTF 2.0 asks (section 3.8.2).
Image decodePicture(const Bytes& bytes, const std::string& place, Budget& budget);

}  // namespace ff::bake::gltf
