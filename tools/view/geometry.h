// The drawing geometry on the device: one vertex per corner. Shared by the sun's rasteriser and the renderer.
#pragma once
#include "tools/view/graphics.h"
#include "tools/view/scene.h"

namespace ff::view {

struct DrawVertex {
  float position[3];
  float normal[3];
  uint32_t patch;
  uint32_t vertex;  // of the weld
};

struct DrawGeometry {
  Buffer vertices;
  uint32_t corners = 0;
  Box bounds;
  float cell_m = 1;
  uint32_t patches = 0;
};

Result<DrawGeometry> uploadGeometry(VkContext& context, const ViewScene& scene, const Weld& weld);

// position, normal, patch, vertex at locations 0..3.
std::vector<VkVertexInputAttributeDescription> drawAttributes();

}  // namespace ff::view
