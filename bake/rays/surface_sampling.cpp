#include "bake/rays/surface_sampling.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <span>
#include <numbers>

#include "bake/rays/sobol.h"
#include "formats/portable_math.h"

namespace ff::bake {
namespace {

const std::array<float, 256>& linearOfStored() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> t{};
    for (unsigned i = 0; i < 256; ++i) t[i] = srgbToLinear(i);
    return t;
  }();
  return table;
}

struct Texel {
  Vec3 rgb{1, 1, 1};
  float alpha = 1;
};

Texel texel(const Image& image, Vec2 uv, bool repeat) {
  const auto wrap = [repeat](float u, uint32_t n) {
    u = repeat ? u - std::floor(u) : std::clamp(u, 0.0f, 1.0f);
    return std::min(n - 1, static_cast<uint32_t>(u * static_cast<float>(n)));
  };
  const size_t at = 4 * (size_t{wrap(uv.y, image.height)} * image.width + wrap(uv.x, image.width));
  const auto& linear = linearOfStored();
  return {{linear[image.rgba[at]], linear[image.rgba[at + 1]], linear[image.rgba[at + 2]]},
          static_cast<float>(image.rgba[at + 3]) / 255.0f};
}

Vec2 interpolate(std::span<const Vec2> uv, const Triangle& t, float b, float c) {
  const Vec2 p = uv[t.v[0]], q = uv[t.v[1]], r = uv[t.v[2]];
  const float a = 1 - b - c;
  return {a * p.x + b * q.x + c * r.x, a * p.y + b * q.y + c * r.y};
}

Rgba interpolate(std::span<const Rgba> colors, const Triangle& t, float b, float c) {
  const Rgba p = colors[t.v[0]], q = colors[t.v[1]], r = colors[t.v[2]];
  const float a = 1 - b - c;
  return {a * p.r + b * q.r + c * r.r, a * p.g + b * q.g + c * r.g, a * p.b + b * q.b + c * r.b, a * p.a + b * q.a + c * r.a};
}

// Largest share of the light that a material stops anywhere.
float maxSolid(const Material& m) { return (m.blend ? m.alpha : 1) * (1 - m.transmission); }

// Of where the point lies, and of nothing else in the scene.
float chance(const Scene& scene, uint32_t t, float b, float c) {
  uint64_t corners = 0;
  for (const uint32_t v : scene.triangles[t].v)
    for (int a = 0; a < 3; ++a) corners = mix64(corners + std::bit_cast<uint32_t>(scene.positions[v][a]) + 1);
  const uint64_t point = uint64_t{std::bit_cast<uint32_t>(b)} << 32 | std::bit_cast<uint32_t>(c);
  return static_cast<float>(mix64(point ^ corners) >> 40) * 0x1p-24f;
}

}  // namespace

float largestCoordinate(const Scene& scene, uint32_t t) {
  float largest = 0;
  for (const uint32_t v : scene.triangles[t].v)
    for (int a = 0; a < 3; ++a) largest = std::max(largest, std::abs(scene.positions[v][a]));
  return largest;
}

float triangleArea(const Scene& scene, uint32_t t) {
  const auto& v = scene.triangles[t].v;
  const Vec3 a = scene.positions[v[0]];
  return 0.5f * length(cross(scene.positions[v[1]] - a, scene.positions[v[2]] - a));
}

float solidity(const Scene& scene, uint32_t t, float b, float c) {
  const Material& m = scene.materials[scene.triangles[t].material];
  if (!m.cutout) return 1;
  float alpha = m.alpha;
  if (m.base_image != kNone && !scene.uv0.empty())
    alpha *= texel(scene.images[m.base_image], interpolate(scene.uv0, scene.triangles[t], b, c), m.repeat).alpha;
  if (!scene.colors.empty()) alpha *= interpolate(scene.colors, scene.triangles[t], b, c).a;
  return (m.blend ? std::clamp(alpha, 0.0f, 1.0f) : alpha < m.alpha_cutoff ? 0.0f : 1.0f) * (1 - m.transmission);
}

bool isHole(const Scene& scene, uint32_t t, float b, float c) {
  const float solid = solidity(scene, t, b, c);
  return solid < 1 && chance(scene, t, b, c) >= solid;
}

bool mayStart(const Scene& scene, uint32_t t, float b, float c) {
  const float solid = solidity(scene, t, b, c), most = maxSolid(scene.materials[scene.triangles[t].material]);
  return solid >= most || chance(scene, t, b, c) * most < solid;
}

bool isSeenThrough(const Material& material) { return material.cutout && maxSolid(material) < 0.5f; }

std::pair<float, float> barycentric(const Scene& scene, uint32_t t, Vec3 p) {
  const auto& v = scene.triangles[t].v;
  const Vec3 a = scene.positions[v[0]], e1 = scene.positions[v[1]] - a, e2 = scene.positions[v[2]] - a, d = p - a;
  const float d11 = dot(e1, e1), d12 = dot(e1, e2), d22 = dot(e2, e2), dp1 = dot(d, e1), dp2 = dot(d, e2);
  const float det = d11 * d22 - d12 * d12;
  if (!(std::abs(det) > 0)) return {0.0f, 0.0f};
  return {(d22 * dp1 - d12 * dp2) / det, (d11 * dp2 - d12 * dp1) / det};
}

float SurfaceMean::add(const Scene& scene, uint32_t t, Vec3 p, Vec3 q, Vec3 r, float area_m2) {
  const Triangle& tri = scene.triangles[t];
  const Material& m = scene.materials[tri.material];
  const bool base = m.base_image != kNone && !scene.uv0.empty();
  const bool glow = m.emission_image != kNone && !scene.uv1.empty();
  const bool tinted = !scene.colors.empty();
  // A point a texel, or one in all: the mean of what is linear is its value in the middle.
  const double share = static_cast<double>(area_m2) / std::max(1e-20, static_cast<double>(triangleArea(scene, t)));
  const auto texels = [&](std::span<const Vec2> uv, uint32_t image) {
    const Vec2 a = uv[tri.v[0]], b = uv[tri.v[1]], c = uv[tri.v[2]];
    const double uv_area = 0.5 * std::abs(static_cast<double>((b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y)));
    return uv_area * static_cast<double>(scene.images[image].width) * static_cast<double>(scene.images[image].height) * share;
  };
  double wanted = 1;
  if (base) wanted = kLeastPoints;
  if (glow) wanted = kLeastLampPoints;
  if (tinted && m.cutout) wanted = kMaxPoints;
  if (base) wanted = std::max(wanted, std::min(texels(scene.uv0, m.base_image), kMaxPoints));
  if (glow) wanted = std::max(wanted, std::min(texels(scene.uv1, m.emission_image), kMaxLampPoints));
  const auto points = static_cast<uint32_t>(wanted);
  float solid = 0;
  Vec3 colour, light;
  for (uint32_t i = 1; i <= points; ++i) {
    // R2 sequence: Martin Roberts. The unreasonable effectiveness of quasirandom sequences. 2018. In units of 2^-32. Its first point
    // would lie on a side of the piece, which may be the border of two texels or of the picture.
    float u = static_cast<float>(0x80000000u + i * 3242174889u) * 0x1p-32f;
    float w = static_cast<float>(0x80000000u + i * 2447445414u) * 0x1p-32f;
    if (u + w > 1) {
      u = 1 - u;
      w = 1 - w;
    }
    if (points == 1) u = w = 1.0f / 3;
    Vec3 rgb{1, 1, 1}, emitted{1, 1, 1};
    float stops = 1;
    if (base || glow || tinted || m.cutout) {
      const auto [b, c] = barycentric(scene, t, p + (q - p) * u + (r - p) * w);
      stops = solidity(scene, t, b, c);
      if (base) rgb = texel(scene.images[m.base_image], interpolate(scene.uv0, tri, b, c), m.repeat).rgb;
      if (tinted) rgb = rgb * interpolate(scene.colors, tri, b, c).rgb();
      if (glow) emitted = texel(scene.images[m.emission_image], interpolate(scene.uv1, tri, b, c), m.repeat).rgb;
    }
    solid += stops;
    colour += rgb * stops;
    light += emitted * stops;
  }
  const double w = static_cast<double>(area_m2) / points;
  const double mirror = static_cast<double>(metals_);
  weight_ += w * static_cast<double>(solid);
  for (int a = 0; a < 3; ++a) {
    albedo_[a] += w * (static_cast<double>(colour[a] * m.base_color[a] * (1 - m.metallic * (1 - metals_))) +
                       mirror * static_cast<double>(m.specular[a] * solid));
    emission_[a] += w * static_cast<double>(light[a] * m.emission[a]);
  }
  return solid / static_cast<float>(points);
}

Vec3 SurfaceMean::albedo() const {
  Vec3 v;
  for (int a = 0; a < 3; ++a)
    v[a] = weight_ > 0 ? std::clamp(static_cast<float>(albedo_[a] / weight_), 0.0f, 1.0f) : 0.0f;
  return v;
}

Vec3 SurfaceMean::emission() const {
  Vec3 v;
  for (int a = 0; a < 3; ++a)
    v[a] = weight_ > 0 ? static_cast<float>(emission_[a] / weight_ * std::numbers::pi) : 0.0f;
  return v;
}

}  // namespace ff::bake
