// Names of nodes and meshes, and what a file says about single objects in `extras`:
//   "formfield": {"include": false, "occlude_only": true, "density": 2, "lamp": "name"}
// on a node (its children inherit it), a mesh or a material; the node's word counts over the mesh's, that over the material's.
// Private to this folder.
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "bake/import/json.h"

namespace ff::bake::gltf {

struct Traits {
  std::optional<bool> include, occlude_only;
  std::optional<float> density;  // 1/16 to 16
  std::optional<std::string> lamp;
  bool empty() const { return !include && !occlude_only && !density && !lamp; }
};

// What `over` says, and `under` where it says nothing.
Traits merged(const Traits& over, const Traits& under);

struct Objects {
  std::vector<std::string> node_names, mesh_names;
  std::vector<Traits> nodes, meshes, materials;
  std::vector<bool> unlit;  // of each material
};

// nodes' children have been checked: each node has at most one parent.
Objects readObjects(const Item& file);

}  // namespace ff::bake::gltf
