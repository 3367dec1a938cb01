#include "tools/view/lights.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <thread>

#include "runtime/probes/facet_scene.h"

namespace ff::view {
namespace {

using formats::Light;

constexpr uint32_t kPoints = 32;        // of a patch
constexpr float kLiftCells = 2e-3f;     // where rays start over a surface: past what corners are rounded by
constexpr float kClearOfLight = 1e-3f;  // of the distance: what a light is mounted on does not block it
constexpr uint32_t kLeafTriangles = 4;
constexpr uint32_t kChunk = 256;  // patches a thread takes at once

class Occluders {
 public:
  explicit Occluders(const ViewScene& scene) {
    std::vector<Box> boxes(scene.triangles());
    for (size_t c = 0; c < scene.corners.size(); ++c) boxes[c / 3].add(scene.corners[c]);
    tree_ = runtime::BoxTree(boxes, kLeafTriangles);
    for (const uint32_t t : tree_.order()) {
      const Vec3* corner = &scene.corners[size_t{3} * t];
      facets_.push_back({corner[0], corner[1] - corner[0], corner[2] - corner[0], 0});
    }
  }
  bool blocks(Vec3 from, Vec3 direction, float distance_m) const {
    const runtime::RayLine ray(from, direction);
    bool blocked = false;
    float limit = distance_m;
    tree_.walk(ray, 0, limit, [&](uint32_t first, uint32_t last) {
      for (uint32_t f = first; f < last && !blocked; ++f) {
        bool front = true;
        const float distance = runtime::distanceTo(facets_[f], ray, front);
        blocked = distance > 0 && distance < distance_m;
      }
      if (blocked) limit = -1;
    });
    return blocked;
  }

 private:
  runtime::BoxTree tree_;
  std::vector<runtime::Facet> facets_;  // in the tree's order
};

// The triangles of each patch: those of patch p are order[start[p]] .. order[start[p + 1] - 1].
struct ByPatch {
  std::vector<uint32_t> start, order;
  explicit ByPatch(const ViewScene& scene) : start(scene.patches.size() + 1), order(scene.triangles() - scene.sealed.size()) {
    const std::vector<bool> sealed = scene.whichAreSealed();
    for (uint32_t t = 0; t < sealed.size(); ++t)
      if (!sealed[t]) ++start[scene.triangle_patch[t] + 1];
    for (size_t p = 1; p < start.size(); ++p) start[p] += start[p - 1];
    std::vector<uint32_t> at(start.begin(), start.end() - 1);
    for (uint32_t t = 0; t < sealed.size(); ++t)
      if (!sealed[t]) order[at[scene.triangle_patch[t]]++] = t;
  }
};

Vec3 onPatch(std::span<const Light> lights, const ViewScene& scene, std::span<const uint32_t> triangles,
             const Occluders& occluders) {
  std::vector<float> until;  // area of the triangles up to each
  float area = 0;
  for (const uint32_t t : triangles) {
    const Vec3* c = &scene.corners[size_t{3} * t];
    until.push_back(area += length(cross(c[1] - c[0], c[2] - c[0])) / 2);
  }
  if (!(area > 0)) return {};
  Vec3 sum;
  for (uint32_t i = 0; i < kPoints; ++i) {
    // Along the area evenly, across by the golden ratio.
    const float x = (static_cast<float>(i) + 0.5f) / kPoints * area;
    const auto k = std::min(static_cast<size_t>(std::upper_bound(until.begin(), until.end(), x) - until.begin()), until.size() - 1);
    const float before = k > 0 ? until[k - 1] : 0, own = until[k] - before;
    const float u = std::sqrt(own > 0 ? std::clamp((x - before) / own, 0.0f, 1.0f) : 0.5f);
    const float v = std::fmod(0.5f + static_cast<float>(i) * 0.6180339887f, 1.0f);
    const Vec3* c = &scene.corners[size_t{3} * triangles[k]];
    const Vec3 point = c[0] * (1 - u) + c[1] * (u * (1 - v)) + c[2] * (u * v);
    const Vec3 normal = normalized(cross(c[1] - c[0], c[2] - c[0]));
    const Vec3 from = point + normal * (kLiftCells * scene.cell_m);
    for (const Light& light : lights) {
      const Vec3 e = unshadowedIrradiance(light, point, normal);
      if (e == Vec3{}) continue;
      const bool sun = light.kind == Light::kDirectional;
      const Vec3 to = sun ? light.direction * -1.0f : light.position - from;
      if (!occluders.blocks(from, normalized(to), sun ? 3e38f : length(to) * (1 - kClearOfLight))) sum += e;
    }
  }
  return sum / static_cast<float>(kPoints);
}

}  // namespace

Vec3 unshadowedIrradiance(const Light& light, Vec3 point, Vec3 normal) {
  if (light.kind == Light::kDirectional) return light.color_intensity * std::max(0.0f, -dot(light.direction, normal));
  const Vec3 to = light.position - point;
  const float d = length(to);
  if (!(d > 0)) return {};
  float factor = std::max(0.0f, dot(to, normal) / d) / (d * d);
  if (light.range_m > 0) {
    const float r = d / light.range_m;
    factor *= std::clamp(1 - r * r * r * r, 0.0f, 1.0f);
  }
  if (light.kind == Light::kSpot) {
    const float outer = std::cos(light.outer_angle), inner = std::cos(light.inner_angle);
    const float share = std::clamp((-dot(light.direction, to) / d - outer) / std::max(0.001f, inner - outer), 0.0f, 1.0f);
    factor *= share * share;
  }
  return light.color_intensity * factor;
}

std::vector<Vec3> irradianceFrom(std::span<const Light> lights, const ViewScene& scene) {
  std::vector<Vec3> out(scene.patches.size());
  if (lights.empty()) return out;
  const Occluders occluders(scene);
  const ByPatch by_patch(scene);
  std::atomic<uint32_t> next{0};
  const auto work = [&] {
    for (uint32_t first = next.fetch_add(kChunk); first < out.size(); first = next.fetch_add(kChunk))
      for (uint32_t p = first; p < std::min<size_t>(first + kChunk, out.size()); ++p)
        out[p] = onPatch(lights, scene,
                         std::span(by_patch.order).subspan(by_patch.start[p], by_patch.start[p + 1] - by_patch.start[p]), occluders);
  };
  std::vector<std::thread> threads;
  for (unsigned t = 1; t < std::max(1u, std::thread::hardware_concurrency()); ++t) threads.emplace_back(work);
  work();
  for (std::thread& t : threads) t.join();
  return out;
}

}  // namespace ff::view
