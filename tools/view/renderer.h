// Pictures of the world's patches with the light of the moment.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/updater.h"
#include "shaders/shared.h"
#include "tools/view/sun.h"

namespace ff::view {

struct Sun {
  Vec3 to_sun{0, 1, 0};  // unit length
  Vec3 irradiance;       // on a surface that faces the sun, W/m2; zero: no sun
  bool shines() const { return irradiance.x > 0 || irradiance.y > 0 || irradiance.z > 0; }
};

struct View {
  Vec3 eye, target;
  float field_of_view = 1.05f;  // vertical, rad
};

// Radiosity per pixel, W/m2, top row first; alpha 1: a surface, 0: sky.
struct Rendered {
  uint32_t width = 0, height = 0;
  std::vector<runtime::Vec4> direct, bounced;
  std::vector<float> difference;  // -1: sky
};

// What changes from frame to frame.
struct FrameLight {
  std::span<const shaders::vec4> reflected;  // per patch: irradiance from what surfaces reflect, patchLight()
  std::span<const float> difference;         // per patch, drawn into Rendered::difference
  std::span<const float> sun_exposure;       // per patch, SunRaster::exposure(); zeros without a sun
};

class Renderer {
 public:
  // The sky's and the lamps' light is part of the look of patches, so it is fixed, as the sun is. Errors (kIo): out of memory, a world too large
  // for one binding.
  static Result<Renderer> create(VkContext& context, const ViewScene& scene, const Weld& weld,
                                 const DrawGeometry& geometry, const runtime::Sky& sky, VkExtent2D extent);
  Result<Rendered> render(const SunRaster& raster, const DrawGeometry& geometry, const View& view, const Sun& sun,
                          const FrameLight& light);

 private:
  Result<void> upload(const FrameLight& light, const shaders::Frame& frame);

  VkContext* context_ = nullptr;
  runtime::Sky sky_;
  Target target_;
  Target shadows_[shaders::kShadowMaps];
  GraphicsPipeline surface_, background_;
  DrawingSet surface_set_, background_set_;
  runtime::ComputePipeline interpolate_;
  bool shadows_drawn_ = false;
  Vec3 drawn_sun_;
  uint32_t vertices_ = 0, vertices_per_chunk_ = 0;
  Buffer tables_, looks_, reflected_, light_, figures_, frame_, pixels_;
};

}  // namespace ff::view
