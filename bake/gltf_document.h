// A glTF file checked and reduced to what a radiosity baker reads. Every index, count, offset and extent in the model
// has been checked with 64-bit arithmetic against the bytes that are really there, so that code behind this door may
// trust them; values inside the buffers (vertex indices, coordinates, Draco bitstreams) have not. Private to
// gltf_*.cpp.
//
// The file's JSON never reaches tinygltf: what is checked is written anew (materials already normalised) and that is
// what tinygltf loads, with buffers served from memory. Its Draco path is not compiled in.
#pragma once
#include <tiny_gltf.h>

#include <string>
#include <vector>

#include "bake/gltf_container.h"
#include "bake/gltf_objects.h"

namespace ff::bake::gltf {

struct ImageSource {
  int view = -1;    // bufferView that holds the file, or
  std::string uri;  // data or relative URI; both absent: nothing that can be read
};

struct Document {
  // Only buffers, bufferViews, accessors, meshes (POSITION, TEXCOORD_n, COLOR_0, indices), materials, textures,
  // samplers, nodes and scenes. Materials: spec-gloss is already metallic-roughness, emissiveStrength is multiplied
  // into emissiveFactor, BLEND and transmission are already MASK. Nodes form trees: each has at most one parent. A
  // Draco primitive has no `indices`; its extension holds bufferView, attributes, indexCount and vertexCount.
  tinygltf::Model model;
  std::vector<ImageSource> images;
  Objects objects;
  std::vector<bool> buffer_present;  // buffers without data may be declared; they must not be read
  std::vector<uint32_t> roots;       // of the scene to load
  std::string folder;
};

Document loadDocument(const std::string& path, Budget& budget, std::vector<std::string>& warnings);

}  // namespace ff::bake::gltf
