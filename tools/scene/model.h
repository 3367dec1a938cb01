// A generated scene before it becomes a file: flat materials and triangle meshes, one material a part.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "formats/vec3.h"

namespace ff::tools {

struct SceneMaterial {
  std::string name;
  Vec3 base_color{0.5f, 0.5f, 0.5f};  // linear diffuse albedo
  Vec3 radiance;                      // W/(m2 sr), zero for what does not shine
};

// Triangles are counter-clockwise seen from the front; a position occurs once.
struct ScenePart {
  uint32_t material = 0;
  std::vector<Vec3> positions;
  std::vector<uint32_t> indices;  // three a triangle
};

struct SceneNode {
  std::string name;
  std::vector<ScenePart> parts;
};

struct SceneModel {
  std::string name;
  std::vector<SceneMaterial> materials;
  std::vector<SceneNode> nodes;
  float scale = 1;            // metres per unit of the positions; the root node's scale
  bool integer_grid = false;  // every coordinate is an integer below 2^24: Draco keeps it exactly
};

}  // namespace ff::tools
