#include "tools/chart/truth/area_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "formats/read/whole_world.h"

namespace ff::chart {
namespace {

constexpr float kFineness = 12;  // pieces of a triangle's size over its distance from an emitter
constexpr float kFewestPieces = 2, kMaxPieces = 16;

// A small lamp far away spans angles whose cosines a float takes for 1.
using Exact = std::array<double, 3>;
Exact exact(Vec3 v) { return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)}; }
Exact crossOf(const Exact& a, const Exact& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double dotOf(const Exact& a, const Exact& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Of a triangle seen from the origin, what lies above the horizon of `normal`: four corners at most.
struct Cut {
  std::array<Exact, 4> corner;
  size_t corners = 0;
};
Cut aboveHorizon(const std::array<Exact, 3>& triangle, const Exact& normal) {
  Cut cut;
  for (size_t i = 0; i < 3; ++i) {
    const Exact &a = triangle[i], &b = triangle[(i + 1) % 3];
    const double ha = dotOf(a, normal), hb = dotOf(b, normal);
    if (ha >= 0) cut.corner[cut.corners++] = a;
    if ((ha >= 0) == (hb >= 0)) continue;
    Exact& p = cut.corner[cut.corners++];
    for (size_t c = 0; c < 3; ++c) p[c] = a[c] + (b[c] - a[c]) * (ha / (ha - hb));
  }
  return cut;
}

}  // namespace

AreaLight::AreaLight(const bake::Scene& scene) {
  for (const bake::Triangle& t : scene.triangles) {
    const Vec3 radiance = scene.materials[t.material].emission;
    if (radiance == Vec3{}) continue;
    const Vec3 a = scene.positions[t.v[0]], b = scene.positions[t.v[1]], c = scene.positions[t.v[2]];
    emitters_.push_back({{a, b, c}, normalized(cross(b - a, c - a)), radiance});
  }
}

Vec3 AreaLight::irradianceAt(Vec3 point, Vec3 normal) const {
  const Exact n = exact(normal), p = exact(point);
  std::array<double, 3> sum{};
  for (const Emitter& e : emitters_) {
    if (!(dot(e.normal, point - e.corner[0]) > 0)) continue;  // its back
    std::array<Exact, 3> triangle;
    for (size_t i = 0; i < 3; ++i) {
      triangle[i] = exact(e.corner[i]);
      for (size_t c = 0; c < 3; ++c) triangle[i][c] -= p[c];
    }
    const Cut cut = aboveHorizon(triangle, n);
    double projected = 0;  // half of it, times pi, is the form factor
    for (size_t i = 0; i < cut.corners; ++i) {
      const Exact &a = cut.corner[i], &b = cut.corner[(i + 1) % cut.corners], across = crossOf(a, b);
      const double sine = std::sqrt(dotOf(across, across));
      if (sine > 0) projected += std::atan2(sine, dotOf(a, b)) / sine * dotOf(across, n);
    }
    for (int c = 0; c < 3; ++c) sum[static_cast<size_t>(c)] += std::abs(projected) / 2 * static_cast<double>(e.radiance[c]);
  }
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

Result<std::vector<Vec3>> AreaLight::irradianceOfPatches(const formats::WholeWorld& world) const {
  std::vector<std::array<double, 4>> sums(world.levels()[0].nodes);  // by channel; area
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto geometry = world.geometry(info.id.tile);
    if (!geometry) return geometry.error();
    for (size_t t = 0; t < geometry->exposed(); ++t) {
      const Vec3 a = geometry->positions[3 * t], ab = geometry->positions[3 * t + 1] - a, ac = geometry->positions[3 * t + 2] - a;
      const Vec3 across = cross(ab, ac), middle = a + (ab + ac) / 3;
      if (!(length(across) > 0)) continue;
      float nearest = std::numeric_limits<float>::max();
      for (const Emitter& e : emitters_) nearest = std::min(nearest, length((e.corner[0] + e.corner[1] + e.corner[2]) / 3 - middle));
      const float size = std::max(length(ab), length(ac));
      const int pieces = static_cast<int>(std::clamp(std::ceil(kFineness * size / nearest), kFewestPieces, kMaxPieces));
      const double area = static_cast<double>(length(across)) / 2 / (pieces * pieces);
      auto& sum = sums[info.first_node + geometry->patch[t]];
      for (int i = 0; i < pieces; ++i)
        for (int j = 0; j < pieces - i; ++j)
          for (const bool upper : {false, true}) {  // a piece and, in all but the last of a row, the one that completes it
            if (upper && i + j + 1 >= pieces) continue;
            const float third = upper ? 2.0f / 3 : 1.0f / 3, n = static_cast<float>(pieces);
            const Vec3 e = irradianceAt(a + ab * ((static_cast<float>(i) + third) / n) + ac * ((static_cast<float>(j) + third) / n),
                                        normalized(across));
            for (int c = 0; c < 3; ++c) sum[static_cast<size_t>(c)] += area * static_cast<double>(e[c]);
            sum[3] += area;
          }
    }
  }
  std::vector<Vec3> mean(sums.size());
  for (size_t p = 0; p < sums.size(); ++p)
    for (int c = 0; c < 3 && sums[p][3] > 0; ++c) mean[p][c] = static_cast<float>(sums[p][static_cast<size_t>(c)] / sums[p][3]);
  return mean;
}

}  // namespace ff::chart
