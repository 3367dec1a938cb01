#include "tools/view/renderer.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "interpolate_comp.h"
#include "sky_frag.h"
#include "sky_vert.h"
#include "surface_frag.h"
#include "surface_vert.h"

namespace ff::view {
namespace {

constexpr uint32_t kShadowTexels = 4096;
constexpr float kNearShadowCells = 40;  // half the width of the window around the eye
constexpr VkDescriptorType kStorage = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
constexpr VkDescriptorType kSampled = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
constexpr VkFormat kRadiosityFormat = VK_FORMAT_R32G32B32A32_SFLOAT, kDifferenceFormat = VK_FORMAT_R32_SFLOAT;

shaders::vec4 vec(Vec3 v, float w = 0) { return {v.x, v.y, v.z, w}; }

struct Basis {
  Vec3 right, up, forward;
};

Basis basisOf(const View& view) {
  Basis b;
  b.forward = normalized(view.target - view.eye);
  if (b.forward == Vec3{}) b.forward = {0, 0, -1};
  b.right = normalized(cross(b.forward, std::abs(b.forward.y) < 0.999f ? Vec3{0, 1, 0} : Vec3{0, 0, 1}));
  b.up = cross(b.right, b.forward);
  return b;
}

// Depth 1 at `near`, 0 at infinity; y points down in clip space.
shaders::mat4 viewProjection(const View& view, const Basis& b, float aspect, float near) {
  const float f = 1 / std::tan(view.field_of_view / 2);
  const Vec3 x = b.right * (f / aspect), y = b.up * -f, w = b.forward;
  const auto at = [&](Vec3 row) { return -dot(row, view.eye); };
  return {{x.x, y.x, 0, w.x, x.y, y.y, 0, w.y, x.z, y.z, 0, w.z, at(x), at(y), near, at(w)}};
}

Error tooLarge() {
  return {ErrorCode::kIo, "", "vulkan", "the world is too large to be drawn on this device",
          "bake it with larger patches, or draw a part of it"};
}

}  // namespace

Result<Renderer> Renderer::create(VkContext& context, const ViewScene& scene, const Weld& weld,
                                  const DrawGeometry& geometry, const runtime::Sky& sky, VkExtent2D extent) {
  Renderer r;
  r.context_ = &context;
  r.sky_ = sky;
  const VkFormat formats[] = {kRadiosityFormat, kRadiosityFormat, kDifferenceFormat};
  auto target = Target::create(context, extent, formats);
  if (!target) return target.error();
  r.target_ = std::move(*target);
  for (Target& shadow : r.shadows_) {
    const VkFormat format[] = {SunRaster::kFormat};
    auto s = Target::create(context, {kShadowTexels, kShadowTexels}, format);
    if (!s) return s.error();
    shadow = std::move(*s);
  }

  // surface.vert/.frag and sky.frag share one layout: looks, vertex light, figures of patches, frame, two shadow maps.
  const std::vector<VkDescriptorType> bindings{kStorage, kStorage, kStorage, kStorage, kSampled, kSampled};
  auto surface = GraphicsPipeline::create(context, r.target_,
                                          {.vertex = surface_vert,
                                           .fragment = surface_frag,
                                           .vertex_stride = sizeof(DrawVertex),
                                           .attributes = drawAttributes(),
                                           .cull_back = true,
                                           .far_is_zero = true,
                                           .push_bytes = 0,
                                           .bindings = bindings});
  if (!surface) return surface.error();
  r.surface_ = std::move(*surface);
  auto background = GraphicsPipeline::create(context, r.target_,
                                             {.vertex = sky_vert,
                                              .fragment = sky_frag,
                                              .vertex_stride = 0,
                                              .attributes = {},
                                              .cull_back = false,
                                              .far_is_zero = true,
                                              .push_bytes = 0,
                                              .bindings = bindings});
  if (!background) return background.error();
  r.background_ = std::move(*background);
  auto interpolate = runtime::ComputePipeline::create(context, interpolate_comp, 4, sizeof(shaders::InterpolatePush));
  if (!interpolate) return interpolate.error();
  r.interpolate_ = std::move(*interpolate);

  const uint64_t range = context.limits().maxStorageBufferRange;
  r.vertices_ = static_cast<uint32_t>(weld.position.size());
  r.vertices_per_chunk_ = static_cast<uint32_t>(
      std::min<uint64_t>({range / sizeof(shaders::Interpolation) / 64 * 64,
                          uint64_t{context.limits().maxComputeWorkGroupCount[0]} * shaders::kInterpolateGroup, 1u << 30}));
  if (weld.position.size() * sizeof(shaders::Light) > range || scene.patches.size() * sizeof(shaders::PatchLook) > range)
    return tooLarge();

  std::vector<shaders::PatchLook> looks;
  looks.reserve(scene.patches.size());
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    looks.push_back({vec(n.albedo), vec(n.emission), vec(skyIrradiance(sky, n) + scene.lamps[p])});
  }
  static_assert(sizeof(VertexPatches) == sizeof(shaders::Interpolation));
  const auto make = [&](Buffer& buffer, uint64_t bytes) -> Result<void> {
    auto b = Buffer::create(context, std::max<uint64_t>(bytes, 64), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
    if (!b) return b.error();
    buffer = std::move(*b);
    return {};
  };
  const uint64_t patches = scene.patches.size();
  for (auto [buffer, bytes] : {std::pair<Buffer&, uint64_t>(r.tables_, weld.light_from.size() * sizeof(VertexPatches)),
                               std::pair<Buffer&, uint64_t>(r.looks_, patches * sizeof(shaders::PatchLook)),
                               std::pair<Buffer&, uint64_t>(r.reflected_, patches * sizeof(shaders::vec4)),
                               std::pair<Buffer&, uint64_t>(r.figures_, patches * sizeof(shaders::PatchFigures)),
                               std::pair<Buffer&, uint64_t>(r.light_, uint64_t{r.vertices_} * sizeof(shaders::Light)),
                               std::pair<Buffer&, uint64_t>(r.frame_, sizeof(shaders::Frame))})
    if (auto made = make(buffer, bytes); !made) return made.error();
  if (auto u = runtime::upload(context, r.tables_, 0, std::as_bytes(std::span(weld.light_from))); !u) return u.error();
  if (auto u = runtime::upload(context, r.looks_, 0, std::as_bytes(std::span(looks))); !u) return u.error();
  auto pixels = Buffer::create(context, uint64_t{extent.width} * extent.height * sizeof(runtime::Vec4), 0,
                               runtime::MemoryUse::kHost);
  if (!pixels) return pixels.error();
  r.pixels_ = std::move(*pixels);

  for (auto [set, pipeline] : {std::pair<DrawingSet&, GraphicsPipeline&>(r.surface_set_, r.surface_),
                               std::pair<DrawingSet&, GraphicsPipeline&>(r.background_set_, r.background_)}) {
    auto s = DrawingSet::create(context, pipeline.setLayout(), bindings);
    if (!s) return s.error();
    set = std::move(*s);
    set.setBuffer(0, r.looks_);
    set.setBuffer(1, r.light_);
    set.setBuffer(2, r.figures_);
    set.setBuffer(3, r.frame_);
    set.setImage(4, r.shadows_[0].depth());
    set.setImage(5, r.shadows_[1].depth());
  }
  FF_CHECK_EQ(geometry.patches, scene.patches.size());
  return r;
}

Result<void> Renderer::upload(const FrameLight& light, const shaders::Frame& frame) {
  if (auto r = runtime::upload(*context_, reflected_, 0, std::as_bytes(light.reflected)); !r) return r;
  std::vector<shaders::PatchFigures> figures(light.difference.size());
  for (size_t p = 0; p < figures.size(); ++p) figures[p] = {light.difference[p], light.sun_exposure[p]};
  if (auto r = runtime::upload(*context_, figures_, 0, std::as_bytes(std::span(figures))); !r) return r;
  return runtime::upload(*context_, frame_, 0, std::as_bytes(std::span(&frame, 1)));
}

Result<Rendered> Renderer::render(const SunRaster& raster, const DrawGeometry& geometry, const View& view,
                                  const Sun& sun, const FrameLight& light) {
  const VkExtent2D extent = target_.extent();
  const float aspect = static_cast<float>(extent.width) / static_cast<float>(extent.height);
  const Basis basis = basisOf(view);
  const float half = std::tan(view.field_of_view / 2);
  shaders::Frame frame;
  frame.view_projection = viewProjection(view, basis, aspect, 0.02f * geometry.cell_m);
  frame.sun_direction = vec(sun.to_sun);
  frame.sun_irradiance = vec(sun.irradiance);
  frame.sky_l0 = vec(sky_.l0);
  for (int c = 0; c < 3; ++c) frame.sky_l1[c] = vec(sky_.l1[c]);
  for (size_t k = 0; k < 5; ++k) frame.sky_l2[k] = {sky_.l2[0][k], sky_.l2[1][k], sky_.l2[2][k], 0};
  frame.eye = vec(view.eye);
  frame.look_x = vec(basis.right * (half * aspect));
  frame.look_y = vec(basis.up * -half);
  frame.look_z = vec(basis.forward);
  frame.size = {static_cast<float>(extent.width), static_cast<float>(extent.height), static_cast<float>(kShadowTexels), 0};

  // Two shadow maps over the same depth range: a sharp one around the eye and one of the whole world.
  const SunWindow whole = sunWindow(sun.to_sun, geometry.bounds);
  SunWindow windows[shaders::kShadowMaps] = {whole, whole};
  const float reach = kNearShadowCells * geometry.cell_m;
  const float right = dot(view.eye, whole.right), up = dot(view.eye, whole.up);
  windows[0].right0 = right - reach;
  windows[0].right1 = right + reach;
  windows[0].up0 = up - reach;
  windows[0].up1 = up + reach;
  float texel_m[4] = {}, bias[4] = {};
  for (uint32_t m = 0; m < shaders::kShadowMaps; ++m) {
    frame.shadow[m] = windows[m].toTexels(static_cast<float>(kShadowTexels));
    texel_m[m] = std::max(windows[m].right1 - windows[m].right0, windows[m].up1 - windows[m].up0) /
                 static_cast<float>(kShadowTexels);
    bias[m] = 0.5f * texel_m[m] / (windows[m].near - windows[m].far);
  }
  frame.shadow_texel_m = {texel_m[0], texel_m[1], 0, 0};
  frame.shadow_bias = {bias[0], bias[1], 0, 0};
  if (auto r = upload(light, frame); !r) return r.error();

  const uint32_t chunks = std::max(1u, (vertices_ + vertices_per_chunk_ - 1) / vertices_per_chunk_);
  auto sets = runtime::StorageSets::create(*context_, chunks, 4 * chunks);
  if (!sets) return sets.error();
  std::vector<VkDescriptorSet> chunk_sets;
  for (uint32_t i = 0; i < chunks; ++i) {
    const uint64_t first = uint64_t{i} * vertices_per_chunk_;
    const uint64_t count = std::max<uint64_t>(std::min<uint64_t>(vertices_ - first, vertices_per_chunk_), 1);
    const VkDescriptorBufferInfo buffers[] = {
        {tables_.handle(), first * sizeof(shaders::Interpolation), count * sizeof(shaders::Interpolation)},
        {reflected_.handle(), 0, VK_WHOLE_SIZE},
        {looks_.handle(), 0, VK_WHOLE_SIZE},
        {light_.handle(), 0, VK_WHOLE_SIZE}};
    auto set = sets->make(interpolate_.setLayout(), buffers);
    if (!set) return set.error();
    chunk_sets.push_back(*set);
  }

  auto drawn = context_->run([&](VkCommandBuffer commands) {
    for (uint32_t i = 0; i < chunks; ++i) {
      const uint32_t first = i * vertices_per_chunk_;
      const shaders::InterpolatePush push{first, std::min(vertices_ - first, vertices_per_chunk_)};
      interpolate_.dispatch(commands, chunk_sets[i], &push,
                            (push.count + shaders::kInterpolateGroup - 1) / shaders::kInterpolateGroup);
    }
    runtime::barrier(commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT,
                     VK_PIPELINE_STAGE_VERTEX_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT);
    // Without a sun the maps are not read, but what is bound must have its layout: they are drawn once in any case. The
    // world's map changes only with the sun.
    const bool first = !shadows_drawn_, same_sun = shadows_drawn_ && drawn_sun_ == sun.to_sun;
    if (first || sun.shines()) raster.drawShadow(commands, geometry, windows[0], shadows_[0]);
    if (first || (sun.shines() && !same_sun)) raster.drawShadow(commands, geometry, windows[1], shadows_[1]);
    shadows_drawn_ = true;
    drawn_sun_ = sun.to_sun;
    VkClearValue clear[4]{};
    clear[3].depthStencil = {0, 0};
    target_.begin(commands, clear);
    surface_.bind(commands, surface_set_.handle(), nullptr);
    const VkBuffer vertices = geometry.vertices.handle();
    const VkDeviceSize offset = 0;
    vkCmdBindVertexBuffers(commands, 0, 1, &vertices, &offset);
    vkCmdDraw(commands, geometry.corners, 1, 0, 0);
    background_.bind(commands, background_set_.handle(), nullptr);
    vkCmdDraw(commands, 3, 1, 0, 0);
    vkCmdEndRenderPass(commands);
  });
  if (!drawn) return drawn.error();

  Rendered out;
  out.width = extent.width;
  out.height = extent.height;
  const size_t pixels = size_t{extent.width} * extent.height;
  out.direct.resize(pixels);
  out.bounced.resize(pixels);
  out.difference.resize(pixels);
  void* const into[] = {out.direct.data(), out.bounced.data(), out.difference.data()};
  const size_t bytes[] = {pixels * sizeof(runtime::Vec4), pixels * sizeof(runtime::Vec4), pixels * sizeof(float)};
  for (size_t i = 0; i < 3; ++i) {
    auto copied = context_->run([&](VkCommandBuffer commands) { target_.copyTo(commands, i, pixels_); });
    if (!copied) return copied.error();
    std::memcpy(into[i], pixels_.mapped(), bytes[i]);
  }
  return out;
}

}  // namespace ff::view
