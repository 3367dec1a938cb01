// glTF 2.0 (.gltf, .glb) to Scene. The only file that sees tinygltf and Draco's decoder.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <string>

#include "bake/scene.h"

namespace ff::bake {

struct ImportLimits {
  uint64_t max_memory_bytes = uint64_t{1536} << 20;  // of decoded buffers, images and triangles together
  uint64_t max_triangles = 200'000'000;
  double scale = 1;   // of a unit of the file's coordinates, m
  std::function<void(uint64_t done, uint64_t total)> progress{};  // instances of primitives; may be called often
  bool z_up = false;  // the file's third axis points up, its second one to the back
  std::array<double, 16> placed = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};  // where the file stands in the world, m: column-major, last row 0 0 0 1
};

// Loads the default scene (scene 0 where none is named; all root nodes where there are no scenes). Things a radiosity
// baker does not use (cameras, animation, skins, normals, morph targets) are not read. Missing images are warnings.
// A scene without triangles loads, with a warning. Coordinates are within 1e9 m, texture coordinates within 65536.
// Errors name file, place ("accessor 3") and fault; kIo, kInvalidFile. Never throws.
Result<Scene> importGltf(const std::string& path, const ImportLimits& limits = {});

}  // namespace ff::bake
