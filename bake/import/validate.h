// The checking half of document.cpp: JSON in, validated JSON (of nodes, a list) out: what the baker reads, and no more. Private to this folder.
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "bake/import/container.h"
#include "bake/import/matrix.h"

namespace ff::bake::gltf {

struct Extents {
  uint64_t offset = 0, length = 0, stride = 0;
  uint32_t buffer = 0;
};

// What the later checks need to know of an accessor that has passed its own.
struct AccessorFacts {
  uint64_t count = 0;
  int component_type = 0;  // 5120...
  std::string type;        // "VEC3"
  bool normalized = false, has_data = false, strided = false;
  int view = -1;
};

// Buffers as loaded and the views into them; decoded meshopt views have become buffers of their own.
struct Storage {
  std::vector<std::vector<uint8_t>> buffers;
  std::vector<bool> present;
  std::vector<Extents> views;
};

// What a material asks for beside tinygltf's own members.
struct MaterialFacts {
  bool blend = false;  // alphaMode BLEND
  // Factors, and textures that scale them (-1: none).
  double transmission = 0;
  int transmission_texture = -1;  // red
  double diffuse_transmission = 0;
  int diffuse_transmission_texture = -1;  // alpha
  std::vector<double> diffuse_transmission_color{1, 1, 1};
  int diffuse_transmission_color_texture = -1;  // sRGB
  std::vector<double> specular;                 // of KHR_materials_pbrSpecularGlossiness; empty: not said
  int specular_texture = -1;                    // sRGB
  std::vector<std::string> left_alone;          // see Material::left_alone
};

// EXT_mesh_gpu_instancing: accessors, which have equal counts; -1: none. One is there at least.
struct GpuInstancing {
  int translation = -1, rotation = -1, scale = -1;
};

// A file may have millions of nodes.
struct NodeFacts {
  Matrix local{};  // into its parent
  int mesh = -1;
  std::vector<uint32_t> children;
  std::optional<GpuInstancing> instancing;
  bool visible = true;
};

Json validateAccessors(const Item& file, const Storage& storage, std::vector<AccessorFacts>& facts);
// texture_count and material warnings: see document.h for what materials look like afterwards.
Json validateMaterials(const Item& file, size_t texture_count, Budget& budget, std::vector<MaterialFacts>& facts,
                       std::vector<std::string>& warnings);
Json validateMeshes(const Item& file, const std::vector<AccessorFacts>& accessors, size_t material_count,
                    size_t view_count, std::vector<std::string>& warnings);
// Of a node's matrix, or its translation, rotation and scale.
Matrix validateTransform(const Item& item);
std::vector<NodeFacts> validateNodes(const Item& file, const std::vector<AccessorFacts>& accessors, size_t mesh_count,
                   std::vector<uint32_t>& roots);

}  // namespace ff::bake::gltf
