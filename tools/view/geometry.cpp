#include "tools/view/geometry.h"

#include <cstddef>

namespace ff::view {
namespace {
// A face further than this from its welded vertex's mean normal keeps its own: bevels are shaded round, edges stay sharp.
constexpr float kRound = 0.8f;  // cosine, 37 degrees
}  // namespace

Result<DrawGeometry> uploadGeometry(VkContext& context, const ViewScene& scene, const Weld& weld) {
  if (scene.corners.size() > 0xffffffffu)
    return Error{ErrorCode::kUsage, "", "", "the world has too many triangles to draw", "bake it with larger patches"};
  std::vector<DrawVertex> vertices(scene.corners.size());
  for (size_t t = 0; t < scene.triangles(); ++t) {
    const auto at = [&](size_t corner) { return weld.position[weld.corner_vertex[3 * t + corner]]; };
    Vec3 face = normalized(cross(at(1) - at(0), at(2) - at(0)));
    if (face == Vec3{}) face = scene.patches[scene.triangle_patch[t]].normal;
    for (size_t c = 3 * t; c < 3 * t + 3; ++c) {
      const uint32_t v = weld.corner_vertex[c];
      const Vec3 p = weld.position[v], n = dot(weld.normal[v], face) > kRound ? weld.normal[v] : face;
      vertices[c] = {{p.x, p.y, p.z}, {n.x, n.y, n.z}, scene.triangle_patch[t], v};
    }
  }
  auto buffer = Buffer::create(context, std::max<uint64_t>(vertices.size() * sizeof(DrawVertex), 16),
                               VK_BUFFER_USAGE_VERTEX_BUFFER_BIT);
  if (!buffer) return buffer.error();
  if (auto r = runtime::upload(context, *buffer, 0, std::as_bytes(std::span(vertices))); !r) return r.error();
  DrawGeometry g;
  g.vertices = std::move(*buffer);
  g.corners = static_cast<uint32_t>(vertices.size());
  g.bounds = scene.bounds;
  g.cell_m = scene.cell_m;
  g.patches = static_cast<uint32_t>(scene.patches.size());
  return g;
}

std::vector<VkVertexInputAttributeDescription> drawAttributes() {
  return {{0, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(DrawVertex, position)},
          {1, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(DrawVertex, normal)},
          {2, 0, VK_FORMAT_R32_UINT, offsetof(DrawVertex, patch)},
          {3, 0, VK_FORMAT_R32_UINT, offsetof(DrawVertex, vertex)}};
}

}  // namespace ff::view
