// The node trees flattened: where each mesh stands. Private to this folder.
#pragma once
#include <array>
#include <vector>

#include "bake/import/document.h"

namespace ff::bake::gltf {

using Matrix = std::array<double, 16>;  // column-major, last row 0 0 0 1

struct Instance {
  Matrix to_world;
  int node = 0;
};

Matrix multiply(const Matrix& a, const Matrix& b);
double determinant(const Matrix& m);
inline bool isMirror(const Matrix& m) { return determinant(m) < 0; }
// Of a node's JSON as validateTransform() leaves it: matrix, or translation, rotation and scale.
Matrix transformOf(const Json& validated);
// root: what the scene stands in. Per mesh, in the order of a depth-first walk from the scene's roots. lights: appended, the
// visible nodes that hold one (Document::lights).
std::vector<std::vector<Instance>> listInstances(const Document& document, const Matrix& root, Budget& budget,
                                                 std::vector<Instance>& lights);

}  // namespace ff::bake::gltf
