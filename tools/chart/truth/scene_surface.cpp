#include "tools/chart/truth/scene_surface.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <span>

namespace ff::chart {
namespace {

float decoded(uint8_t srgb) {  // IEC 61966-2-1:1999
  const float v = static_cast<float>(srgb) / 255;
  return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

// Index of the first byte of the nearest texel.
size_t texelAt(const bake::Scene& scene, std::span<const bake::Vec2> coordinates, uint32_t triangle, float u, float v,
               const bake::Image& image, bool repeat) {
  const auto& corner = scene.triangles[triangle].v;
  const bake::Vec2 a = coordinates[corner[0]], b = coordinates[corner[1]], c = coordinates[corner[2]];
  float x = a.x + u * (b.x - a.x) + v * (c.x - a.x), y = a.y + u * (b.y - a.y) + v * (c.y - a.y);
  if (repeat) x -= std::floor(x), y -= std::floor(y);
  const auto texel = [](float s, uint32_t size) {
    return static_cast<size_t>(std::clamp(s * static_cast<float>(size), 0.0f, static_cast<float>(size - 1)));
  };
  return 4 * (texel(y, image.height) * image.width + texel(x, image.width));
}

bake::Rgba vertexColour(const bake::Scene& scene, uint32_t triangle, float u, float v) {
  if (scene.colors.empty()) return {};
  const auto& corner = scene.triangles[triangle].v;
  const bake::Rgba &a = scene.colors[corner[0]], &b = scene.colors[corner[1]], &c = scene.colors[corner[2]];
  const auto mix = [&](float x, float y, float z) { return x + u * (y - x) + v * (z - x); };
  return {mix(a.r, b.r, c.r), mix(a.g, b.g, c.g), mix(a.b, b.b, c.b), mix(a.a, b.a, c.a)};
}

// 0..1, white noise over the points of a surface. Wang. Integer Hash Function. 1997 (the 32-bit mix).
float noiseAt(uint32_t triangle, float u, float v) {
  uint32_t h = triangle;
  for (const float x : {u, v}) {
    h ^= std::bit_cast<uint32_t>(x);
    h = (h ^ 61) ^ (h >> 16);
    h *= 9;
    h ^= h >> 4;
    h *= 0x27d4eb2d;
    h ^= h >> 15;
  }
  return static_cast<float>(h >> 8) * 0x1p-24f;
}

Vec3 colourAt(const bake::Image& image, size_t texel) {
  return {decoded(image.rgba[texel]), decoded(image.rgba[texel + 1]), decoded(image.rgba[texel + 2])};
}

}  // namespace

SurfacePoint surfaceAt(const bake::Scene& scene, uint32_t triangle, float u, float v) {
  const bake::Material& m = scene.materials[scene.triangles[triangle].material];
  SurfacePoint p{m.base_color, m.emission};
  if (m.base_image != bake::kNone && !scene.uv0.empty()) {
    const bake::Image& image = scene.images[m.base_image];
    p.albedo = p.albedo * colourAt(image, texelAt(scene, scene.uv0, triangle, u, v, image, m.repeat));
  }
  if (m.emission_image != bake::kNone && !scene.uv1.empty()) {
    const bake::Image& image = scene.images[m.emission_image];
    p.radiance = p.radiance * colourAt(image, texelAt(scene, scene.uv1, triangle, u, v, image, m.repeat));
  }
  p.albedo = min(p.albedo * vertexColour(scene, triangle, u, v).rgb() + m.specular, {1, 1, 1});
  return p;
}

bool holeAt(const bake::Scene& scene, uint32_t triangle, float u, float v) {
  const bake::Material& m = scene.materials[scene.triangles[triangle].material];
  if (!m.cutout) return false;
  float alpha = m.alpha;
  if (m.base_image != bake::kNone && !scene.uv0.empty()) {
    const bake::Image& image = scene.images[m.base_image];
    alpha *= static_cast<float>(image.rgba[texelAt(scene, scene.uv0, triangle, u, v, image, m.repeat) + 3]) / 255;
  }
  alpha *= vertexColour(scene, triangle, u, v).a;
  const float stopped = (m.blend ? std::clamp(alpha, 0.0f, 1.0f) : alpha >= m.alpha_cutoff ? 1.0f : 0.0f) * (1 - m.transmission);
  return stopped <= 0 || (stopped < 1 && noiseAt(triangle, u, v) >= stopped);
}

}  // namespace ff::chart
