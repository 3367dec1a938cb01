// A glTF file validated: checked, and no more of it than a radiosity baker reads. Every index, count, offset and extent in the model
// has been checked with 64-bit arithmetic against the bytes that are really there, so that code behind this door may
// trust them; values inside the buffers (vertex indices, coordinates, Draco bitstreams) have not. Private to
// this folder.
//
// The file's JSON never reaches tinygltf: what is checked is written anew (materials already normalised) and that is
// what tinygltf loads, with buffers served from memory. Its Draco path is not compiled in.
#pragma once
#include <tiny_gltf.h>

#include <string>
#include <vector>

#include "bake/import/container.h"
#include "bake/import/lights.h"
#include "bake/import/objects.h"
#include "bake/import/validate.h"

namespace ff::bake::gltf {

struct ImageSource {
  int view = -1;    // bufferView that holds the file, or
  std::string uri;  // data or relative URI; both absent: nothing that can be read
};

struct Document {
  // Only buffers, bufferViews, accessors, meshes (POSITION, TEXCOORD_n, COLOR_0, indices), materials, textures
  // and samplers. Materials: the diffuse part of spec-gloss is the base colour, emissiveStrength is
  // multiplied into emissiveFactor; the rest is in material_facts. A Draco primitive has no `indices`; its extension holds
  // bufferView, attributes, indexCount and vertexCount.
  tinygltf::Model model;
  std::vector<NodeFacts> nodes;      // they form trees: each has at most one parent
  std::vector<ImageSource> images;
  Objects objects;
  std::vector<std::vector<uint32_t>> texture_images;  // of each texture: its images, the preferred one first
  std::vector<MaterialFacts> material_facts;          // of each material
  Lights lights;
  std::vector<bool> buffer_present;  // buffers without data may be declared; they must not be read
  std::vector<uint32_t> roots;       // of the scene to load
  std::string folder;
};

Document loadDocument(const std::string& path, Budget& budget, std::vector<std::string>& warnings);

}  // namespace ff::bake::gltf
