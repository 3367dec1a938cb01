// The sun on the world's surfaces: seen from the sun (orthographic, depth-tested), what is visible is lit.
// Catmull. A Subdivision Algorithm for Computer Display of Curved Surfaces. 1974 (the depth buffer); counting item-buffer
// texels as in Weghorst, Hooper, Greenberg. Improved Computational Methods for Ray Tracing. 1984.
#pragma once
#include "runtime/vulkan/pipeline.h"
#include "shaders/shared.h"
#include "tools/view/geometry.h"

namespace ff::view {

// A rectangle across the sun's rays, and the depth range along them.
struct SunWindow {
  Vec3 to_sun, right, up;  // right x up = to_sun
  float right0 = 0, right1 = 0, up0 = 0, up1 = 0;  // m, along right and up
  float near = 0, far = 0;                         // m, along to_sun; near > far

  shaders::mat4 projection() const;                // to clip space, depth 0 nearest to the sun
  shaders::mat4 toTexels(float texels) const;      // to x, y in texels and depth 0..1
};

// The window that the box fills. to_sun must be of unit length.
SunWindow sunWindow(Vec3 to_sun, const Box& box);

class SunRaster {
 public:
  static Result<SunRaster> create(VkContext& context, uint32_t texels = 2048);

  // Per patch: the mean over its surface of max(0, cosine) where the sun is seen, 0..1; times the sun's irradiance that
  // is the patch's mean direct irradiance. Only front faces receive, all faces block. Texels are at most cell / 32 wide
  // unless that took more than 2^27 of them.
  Result<std::vector<float>> exposure(const DrawGeometry& geometry, const ViewScene& scene, Vec3 to_sun);

  // Draws the depth of what the window holds into `target` (made with shadowFormat(), square).
  void drawShadow(VkCommandBuffer commands, const DrawGeometry& geometry, const SunWindow& window,
                  const Target& target) const;
  static constexpr VkFormat kFormat = VK_FORMAT_R32_UINT;

 private:
  VkContext* context_ = nullptr;
  Target target_;
  GraphicsPipeline draw_;
  runtime::ComputePipeline count_;
  Buffer receivers_;
};

}  // namespace ff::view
