#include "tools/chart/sun_light.h"

#include <cmath>

#include "bake/rays/ray_caster.h"
#include "formats/read/whole_world.h"

namespace ff::chart {
namespace {

constexpr int kRays = 16;
// Drawing geometry is quantised to 16 bits over a tile: rays start this far off the surface.
constexpr float kLift = 0.004f;

// The i-th point of a sequence that fills the unit square evenly. Roberts. The Unreasonable Effectiveness of
// Quasirandom Sequences. 2018.
void evenPoint(int i, float& u, float& v) {
  u = std::fmod(0.5f + 0.7548776662f * static_cast<float>(i), 1.0f);
  v = std::fmod(0.5f + 0.5698402909f * static_cast<float>(i), 1.0f);
}

}  // namespace

Result<std::vector<Vec3>> sunIrradiance(const formats::WholeWorld& world, Vec3 to_sun, Vec3 irradiance) {
  bake::Scene scene;
  scene.materials.emplace_back();
  constexpr uint32_t kSealed = 0xffffffffu;
  std::vector<uint32_t> patch_of;  // per triangle; kSealed: it only stands in the way
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto geometry = world.geometry(info.id.tile);
    if (!geometry) return geometry.error();
    for (size_t t = 0; t < geometry->patch.size(); ++t) {
      const auto first = static_cast<uint32_t>(scene.positions.size());
      for (size_t k = 0; k < 3; ++k) scene.positions.push_back(geometry->positions[3 * t + k]);
      scene.triangles.push_back({{first, first + 1, first + 2}, 0});
      patch_of.push_back(t < geometry->exposed() ? formats::wholeNumber(info.first_node + geometry->patch[t]) : kSealed);
    }
  }
  auto caster = bake::RayCaster::create(scene);
  if (!caster) return caster.error();

  const float far_m = 2 * length(world.info().bounds.hi - world.info().bounds.lo);
  std::vector<double> area(world.levels()[0].nodes), lit(area.size());
  for (size_t t = 0; t < patch_of.size(); ++t) {
    if (patch_of[t] == kSealed) continue;
    const Vec3 a = scene.positions[3 * t], ab = scene.positions[3 * t + 1] - a, ac = scene.positions[3 * t + 2] - a;
    const Vec3 normal = cross(ab, ac);
    const auto double_area = static_cast<double>(length(normal));
    area[patch_of[t]] += double_area;
    const float cosine = dot(normalized(normal), to_sun);
    if (!(cosine > 0)) continue;
    int open = 0;
    for (int i = 0; i < kRays; ++i) {
      float u, v;
      evenPoint(i, u, v);
      if (u + v > 1) u = 1 - u, v = 1 - v;
      const Vec3 p = a + ab * u + ac * v + normalized(normal) * kLift;
      open += caster->occluded({p, to_sun}, far_m) ? 0 : 1;
    }
    lit[patch_of[t]] += double_area * static_cast<double>(cosine) * open / kRays;
  }
  std::vector<Vec3> result(area.size());
  for (size_t i = 0; i < area.size(); ++i)
    if (area[i] > 0) result[i] = irradiance * static_cast<float>(lit[i] / area[i]);
  return result;
}

}  // namespace ff::chart
