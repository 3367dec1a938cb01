#include "tools/view/light.h"

#include <cmath>

#include "formats/whole_world.h"

namespace ff::view {

using runtime::kNoSlot;
using runtime::LocalMatrix;
using runtime::Vec4;

std::vector<uint32_t> patchSlots(const formats::WholeWorld& world, const LocalMatrix& matrix) {
  std::vector<uint32_t> slots(world.levels()[0].nodes);
  for (const formats::TileInfo& info : world.tiles(0)) {
    const formats::TileRef tile = world.ref(info.id);
    for (uint32_t i = 0; i < info.nodes; ++i) {
      uint32_t& slot = slots[info.first_node + i];
      slot = runtime::slotFor(matrix.tiles, tile, i);
      FF_CHECK_LT(slot, matrix.slots());  // the coarsest level is always active
    }
  }
  return slots;
}

std::vector<shaders::vec4> gatherLight(const LocalMatrix& m, std::span<const Vec4> reflected) {
  std::vector<shaders::vec4> light(m.slots());
  for (uint32_t s = 0; s < m.slots(); ++s) {
    Vec3 sum;
    for (const uint32_t entry : m.row(s)) {
      const Vec4& r = reflected[entry >> 16];
      sum += static_cast<float>(entry & 0xffff) * Vec3{r.x, r.y, r.z};
    }
    sum *= m.row_scale[s];
    light[s] = {sum.x, sum.y, sum.z, 0};
  }
  for (const LocalMatrix::Refined& r : m.refined) {
    Vec3 sum;
    float area = 0;
    for (uint32_t c = r.first_child; c < r.first_child + r.children; ++c) {
      sum += m.area_m2[c] * Vec3{light[c].x, light[c].y, light[c].z};
      area += m.area_m2[c];
    }
    if (!(area > 0)) continue;
    sum = sum / area;
    light[r.slot] = {sum.x, sum.y, sum.z, 0};
  }
  return light;
}

std::vector<double> patchSource(const ViewScene& scene, std::span<const float> sun_exposure, const Sun& sun,
                                const runtime::Sky& sky) {
  std::vector<double> source;
  source.reserve(3 * scene.patches.size());
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    const Vec3 m = n.albedo * (sun_exposure[p] * sun.irradiance + scene.lamps[p] + skyIrradiance(sky, n));
    for (int c = 0; c < 3; ++c) source.push_back(static_cast<double>(m[c]));
  }
  return source;
}

Comparison compare(const ViewScene& scene, const LocalMatrix& matrix, std::span<const uint32_t> patch_slot,
                   std::span<const shaders::vec4> light, std::span<const double> full, std::span<const double> source,
                   Vec3 eye, float inner_m) {
  double mean = 0, area = 0;
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    double square = 0;
    for (size_t c = 0; c < 3; ++c) square += full[3 * p + c] * full[3 * p + c];
    mean += static_cast<double>(n.area_m2) * std::sqrt(square);
    area += static_cast<double>(n.area_m2);
  }
  mean = area > 0 ? mean / area : 0;

  Comparison out;
  out.difference.resize(scene.patches.size());
  double error = 0, reflected = 0, bounced = 0;
  for (size_t p = 0; p < scene.patches.size(); ++p) {
    const formats::Node& n = scene.patches[p];
    const shaders::vec4 e = light[patch_slot[p]];
    const float streamed[3] = {n.albedo.x * e.x, n.albedo.y * e.y, n.albedo.z * e.z};
    double square = 0, bounce_square = 0, reflected_square = 0;
    for (int c = 0; c < 3; ++c) {
      const size_t i = 3 * p + static_cast<size_t>(c);
      const double want = full[i] - source[i], all = full[i];
      const double d = static_cast<double>(streamed[c]) - want;
      square += d * d;
      bounce_square += want * want;
      reflected_square += all * all;
    }
    out.difference[p] = mean > 0 ? static_cast<float>(std::sqrt(square) / mean) : 0.0f;
    const uint32_t own = matrix.slotOf(0, static_cast<uint32_t>(p));
    if (own == kNoSlot || !matrix.leaf[own] || length(n.centroid - eye) > inner_m) continue;
    error += square;
    bounced += bounce_square;
    reflected += reflected_square;
    ++out.patches_compared;
  }
  out.reflected_error = reflected > 0 ? std::sqrt(error / reflected) : 0;
  out.bounced_error = bounced > 0 ? std::sqrt(error / bounced) : 0;
  return out;
}

}  // namespace ff::view
