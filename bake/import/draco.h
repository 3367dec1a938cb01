// KHR_draco_mesh_compression, decoded through Draco's own API (tinygltf's path trusts the file too far).
// Private to this folder.
#pragma once
#include <array>
#include <map>
#include <string>
#include <vector>

#include "bake/import/elements.h"

namespace ff::bake::gltf {

struct DracoMesh {
  std::vector<std::array<uint32_t, 3>> triangles;  // vertex numbers < vertex_count
  uint64_t vertex_count = 0;
  std::map<std::string, Elements> attributes;  // those named in the primitive's extension
};

// extension: the validated extension object of a primitive. mode: 4 or 5.
DracoMesh decodeDraco(const Document& document, const tinygltf::Value& extension, int mode, const std::string& place,
                      Budget& budget);

}  // namespace ff::bake::gltf
