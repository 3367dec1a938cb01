// One primitive in its mesh's own coordinates: triangles over the vertices that they use. Private to this folder.
#pragma once
#include <array>
#include <map>
#include <string>
#include <vector>

#include "bake/import/elements.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

// Where a material's texture coordinates come from: a TEXCOORD set and the 2x3 matrix applied to it.
struct UvSource {
  bool used = false;
  int set = 0;
  double xx = 1, xy = 0, x = 0, yx = 0, yy = 1, y = 0;
};

struct Surface {
  PagedVector<Vec3> positions;
  PagedVector<Vec2> uv0, uv1;                      // empty where the source is not used
  PagedVector<std::array<uint32_t, 3>> triangles;  // vertex numbers < positions.size()
  PagedVector<Rgba> colors;                        // COLOR_0, 0..1; empty without, and where all is white
};

// Refuses vertex numbers out of range, values that are not finite, and texture coordinates that are missing.
Surface readSurface(const Document& document, const tinygltf::Primitive& primitive, const UvSource& base,
                    const UvSource& emission, const std::string& place, Budget& budget,
                    std::vector<std::string>& warnings);
// Memory that a surface of so many vertices and triangles takes at most.
uint64_t surfaceBytes(uint64_t vertices, uint64_t triangles);

}  // namespace ff::bake::gltf
