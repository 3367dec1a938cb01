// Pictures of a document: PNG and JPEG to RGBA. Private to gltf_*.cpp.
#pragma once
#include <optional>
#include <string>

#include "bake/gltf_elements.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

// A picture that is missing, broken, too large or of another format is a warning, which ends in `instead` (what happens
// without it), and nothing is returned.
std::optional<Image> readImage(const Document& document, uint32_t image, const std::string& instead, Budget& budget,
                               std::vector<std::string>& warnings);

}  // namespace ff::bake::gltf
