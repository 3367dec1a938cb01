#include "tools/view/sun.h"

#include <algorithm>
#include <cmath>

#include "count_comp.h"
#include "sun_frag.h"
#include "sun_vert.h"

namespace ff::view {
namespace {

constexpr float kTexelsPerCell = 32;
constexpr double kMaxTexels = double{1 << 27};
constexpr float kBackFaceCells = 0.02f;  // see sun.frag

// m * v + a in column-major form: rows of x, y, z.
shaders::mat4 rows(Vec3 x, float ax, Vec3 y, float ay, Vec3 z, float az) {
  return {{x.x, y.x, z.x, 0, x.y, y.y, z.y, 0, x.z, y.z, z.z, 0, ax, ay, az, 1}};
}

shaders::mat4 mapped(const SunWindow& w, float x0, float x1, float y0, float y1) {
  const float sx = (x1 - x0) / (w.right1 - w.right0), sy = (y1 - y0) / (w.up1 - w.up0), sz = -1 / (w.near - w.far);
  return rows(w.right * sx, x0 - w.right0 * sx, w.up * sy, y0 - w.up0 * sy, w.to_sun * sz, -w.near * sz);
}

}  // namespace

shaders::mat4 SunWindow::projection() const { return mapped(*this, -1, 1, 1, -1); }
shaders::mat4 SunWindow::toTexels(float texels) const { return mapped(*this, 0, texels, texels, 0); }

SunWindow sunWindow(Vec3 to_sun, const Box& box) {
  SunWindow w;
  w.to_sun = to_sun;
  w.right = normalized(cross(std::abs(to_sun.y) < 0.9f ? Vec3{0, 1, 0} : Vec3{1, 0, 0}, to_sun));
  w.up = cross(to_sun, w.right);
  w.right0 = w.up0 = w.far = 1e30f;
  w.right1 = w.up1 = w.near = -1e30f;
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3 p{corner & 1 ? box.hi.x : box.lo.x, corner & 2 ? box.hi.y : box.lo.y, corner & 4 ? box.hi.z : box.lo.z};
    w.right0 = std::min(w.right0, dot(p, w.right));
    w.right1 = std::max(w.right1, dot(p, w.right));
    w.up0 = std::min(w.up0, dot(p, w.up));
    w.up1 = std::max(w.up1, dot(p, w.up));
    w.far = std::min(w.far, dot(p, to_sun));
    w.near = std::max(w.near, dot(p, to_sun));
  }
  // A flat box still needs a depth, and back faces are drawn a little behind themselves.
  const float slack = 0.05f * std::max({w.right1 - w.right0, w.up1 - w.up0, w.near - w.far});
  w.near += slack;
  w.far -= slack;
  return w;
}

Result<SunRaster> SunRaster::create(VkContext& context, uint32_t texels) {
  SunRaster s;
  s.context_ = &context;
  const VkFormat formats[] = {kFormat};
  auto target = Target::create(context, {texels, texels}, formats);
  if (!target) return target.error();
  s.target_ = std::move(*target);
  auto draw = GraphicsPipeline::create(context, s.target_,
                                       {.vertex = sun_vert,
                                        .fragment = sun_frag,
                                        .vertex_stride = sizeof(DrawVertex),
                                        .attributes = {drawAttributes()[0], drawAttributes()[2]},  // position, patch
                                        .cull_back = false,
                                        .push_bytes = sizeof(shaders::SunPush),
                                        .bindings = {}});
  if (!draw) return draw.error();
  s.draw_ = std::move(*draw);
  auto count = runtime::ComputePipeline::create(context, count_comp, 2, sizeof(shaders::CountPush));
  if (!count) return count.error();
  s.count_ = std::move(*count);
  auto receivers = Buffer::create(context, uint64_t{texels} * texels * sizeof(uint32_t), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
  if (!receivers) return receivers.error();
  s.receivers_ = std::move(*receivers);
  return s;
}

void SunRaster::drawShadow(VkCommandBuffer commands, const DrawGeometry& geometry, const SunWindow& window,
                           const Target& target) const {
  VkClearValue clear[2]{};
  clear[1].depthStencil = {1, 0};
  target.begin(commands, clear);
  const shaders::SunPush push{window.projection(), kBackFaceCells * geometry.cell_m / (window.near - window.far)};
  draw_.bind(commands, VK_NULL_HANDLE, &push);
  const VkBuffer vertices = geometry.vertices.handle();
  const VkDeviceSize offset = 0;
  vkCmdBindVertexBuffers(commands, 0, 1, &vertices, &offset);
  vkCmdDraw(commands, geometry.corners, 1, 0, 0);
  vkCmdEndRenderPass(commands);
}

Result<std::vector<float>> SunRaster::exposure(const DrawGeometry& geometry, const ViewScene& scene, Vec3 to_sun) {
  const SunWindow whole = sunWindow(to_sun, geometry.bounds);
  const double width = static_cast<double>(whole.right1 - whole.right0), height = static_cast<double>(whole.up1 - whole.up0);
  const double texel = std::max(static_cast<double>(scene.cell_m / kTexelsPerCell), std::sqrt(width * height / kMaxTexels));
  const double tile = texel * target_.extent().width;

  const std::vector<uint32_t> zero(geometry.patches);
  auto counts = runtime::makeBuffer(*context_, std::span<const uint32_t>(zero));
  if (!counts) return counts.error();
  auto sets = runtime::StorageSets::create(*context_, 1, 2);
  if (!sets) return sets.error();
  const VkDescriptorBufferInfo buffers[] = {{receivers_.handle(), 0, VK_WHOLE_SIZE}, {counts->handle(), 0, VK_WHOLE_SIZE}};
  auto set = sets->make(count_.setLayout(), buffers);
  if (!set) return set.error();

  for (double r = 0; r < width; r += tile)
    for (double u = 0; u < height; u += tile) {
      SunWindow window = whole;
      window.right0 = whole.right0 + static_cast<float>(r);
      window.right1 = whole.right0 + static_cast<float>(r + tile);
      window.up0 = whole.up0 + static_cast<float>(u);
      window.up1 = whole.up0 + static_cast<float>(u + tile);
      auto ran = context_->run([&](VkCommandBuffer commands) {
        drawShadow(commands, geometry, window, target_);
        target_.copyTo(commands, 0, receivers_);
        runtime::barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
                         VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT);
        const shaders::CountPush push{target_.extent().width * target_.extent().height};
        count_.dispatch(commands, *set, &push, std::min(4096u, context_->limits().maxComputeWorkGroupCount[0]));
      });
      if (!ran) return ran.error();
    }
  std::vector<uint32_t> texels(geometry.patches);
  if (auto r = runtime::download(*context_, *counts, 0, std::as_writable_bytes(std::span(texels))); !r) return r.error();
  std::vector<float> exposure(geometry.patches);
  for (size_t p = 0; p < exposure.size(); ++p) {
    const double area = static_cast<double>(scene.patches[p].area_m2);
    if (area > 0) exposure[p] = static_cast<float>(std::min(1.0, texels[p] * texel * texel / area));
  }
  return exposure;
}

}  // namespace ff::view
