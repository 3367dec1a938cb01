// The node trees flattened: where each mesh stands. Private to this folder.
#pragma once
#include <vector>

#include "bake/import/document.h"

namespace ff::bake::gltf {

struct Instance {
  Matrix to_world;
  int node = 0;
};

// root: what the scene stands in. Per mesh, in the order of a depth-first walk from the scene's roots. lights: appended, the
// visible nodes that hold one (Document::lights).
std::vector<std::vector<Instance>> listInstances(const Document& document, const Matrix& root, Budget& budget,
                                                 std::vector<Instance>& lights);

}  // namespace ff::bake::gltf
