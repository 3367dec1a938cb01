// Scenes whose form factors are known in closed form, and the means to measure them.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "bake/light/form_factor.h"
#include "bake/rays/ray_caster.h"
#include "bake/surface/patches.h"

namespace ff::bake::test {

inline void addTriangle(Scene& s, Vec3 a, Vec3 b, Vec3 c, uint32_t material) {
  const auto first = static_cast<uint32_t>(s.positions.size());
  for (const Vec3& p : {a, b, c}) s.positions.push_back(p);
  for (auto* uv : {&s.uv0, &s.uv1})
    if (!uv->empty()) uv->resize(s.positions.size());
  if (!s.colors.empty()) s.colors.resize(s.positions.size());
  s.triangles.push_back({{first, first + 1, first + 2}, material});
}

// Corners counter-clockwise seen from the front.
inline void addQuad(Scene& s, Vec3 a, Vec3 b, Vec3 c, Vec3 d, uint32_t material) {
  addTriangle(s, a, b, c, material);
  addTriangle(s, a, c, d, material);
}

inline uint32_t addMaterial(Scene& s, Vec3 albedo, Vec3 radiance = {}) {
  Material m;
  m.base_color = albedo;
  m.metallic = 0;
  m.emission = radiance;
  s.materials.push_back(m);
  return static_cast<uint32_t>(s.materials.size()) - 1;
}

// Unit squares at distance 1 facing each other; materials 0 (lower, facing up) and 1.
inline Scene parallelSquares() {
  Scene s;
  const uint32_t lower = addMaterial(s, {.5f, .5f, .5f}), upper = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, lower);
  addQuad(s, {0, 1, 0}, {1, 1, 0}, {1, 1, 1}, {0, 1, 1}, upper);
  return s;
}

// Unit squares with a common edge, at a right angle; material 0 lies, 1 stands at x = 0.
inline Scene perpendicularSquares() {
  Scene s;
  const uint32_t floor = addMaterial(s, {.5f, .5f, .5f}), wall = addMaterial(s, {.5f, .5f, .5f});
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, floor);
  addQuad(s, {0, 0, 0}, {0, 1, 0}, {0, 1, 1}, {0, 0, 1}, wall);
  return s;
}

// Regular polygons of `segments` corners with the area of a unit-radius disc, at distance 1, facing each other.
inline Scene coaxialDiscs(int segments) {
  Scene s;
  const uint32_t lower = addMaterial(s, {.5f, .5f, .5f}), upper = addMaterial(s, {.5f, .5f, .5f});
  const double step = 2 * std::numbers::pi / segments;
  const double radius = std::sqrt(std::numbers::pi / (segments * 0.5 * std::sin(step)));
  const auto rim = [&](int i, float y) {
    return Vec3{static_cast<float>(radius * std::cos(i * step)), y, static_cast<float>(radius * std::sin(i * step))};
  };
  for (int i = 0; i < segments; ++i) {
    addTriangle(s, {0, 0, 0}, rim(i + 1, 0), rim(i, 0), lower);
    addTriangle(s, {0, 1, 0}, rim(i, 1), rim(i + 1, 1), upper);
  }
  return s;
}

// A closed cube of edge 1, seen from inside.
inline Scene closedBox(Vec3 albedo, Vec3 radiance) {
  Scene s;
  const uint32_t m = addMaterial(s, albedo, radiance);
  addQuad(s, {0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}, m);
  addQuad(s, {0, 1, 0}, {1, 1, 0}, {1, 1, 1}, {0, 1, 1}, m);
  addQuad(s, {0, 0, 0}, {0, 1, 0}, {0, 1, 1}, {0, 0, 1}, m);
  addQuad(s, {1, 0, 0}, {1, 0, 1}, {1, 1, 1}, {1, 1, 0}, m);
  addQuad(s, {0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, m);
  addQuad(s, {0, 0, 1}, {0, 1, 1}, {1, 1, 1}, {1, 0, 1}, m);
  return s;
}

// A box's six faces, seen from outside; without the one below: a house that stands on the ground.
inline void addBlock(Scene& s, Vec3 lo, Vec3 hi, uint32_t material, bool below = true) {
  const auto p = [&](int x, int y, int z) { return Vec3{x ? hi.x : lo.x, y ? hi.y : lo.y, z ? hi.z : lo.z}; };
  addQuad(s, p(0, 1, 0), p(0, 1, 1), p(1, 1, 1), p(1, 1, 0), material);
  if (below) addQuad(s, p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1), material);
  addQuad(s, p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1), material);
  addQuad(s, p(0, 0, 0), p(0, 0, 1), p(0, 1, 1), p(0, 1, 0), material);
  addQuad(s, p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1), material);
  addQuad(s, p(0, 0, 0), p(0, 1, 0), p(1, 1, 0), p(1, 0, 0), material);
}

// A room, seen from inside. Its first faces are the floor and the walls at the least and at the largest x, its last the ceiling.
inline void addRoom(Scene& s, Vec3 lo, Vec3 hi, uint32_t walls, uint32_t ceiling) {
  const auto p = [&](int x, int y, int z) { return Vec3{x ? hi.x : lo.x, y ? hi.y : lo.y, z ? hi.z : lo.z}; };
  addQuad(s, p(0, 0, 0), p(0, 0, 1), p(1, 0, 1), p(1, 0, 0), walls);
  addQuad(s, p(0, 0, 0), p(0, 1, 0), p(0, 1, 1), p(0, 0, 1), walls);
  addQuad(s, p(1, 0, 0), p(1, 0, 1), p(1, 1, 1), p(1, 1, 0), walls);
  addQuad(s, p(0, 0, 0), p(1, 0, 0), p(1, 1, 0), p(0, 1, 0), walls);
  addQuad(s, p(0, 0, 1), p(0, 1, 1), p(1, 1, 1), p(1, 0, 1), walls);
  addQuad(s, p(0, 1, 0), p(1, 1, 0), p(1, 1, 1), p(0, 1, 1), ceiling);
}

// The cap of a unit sphere around +y of half-angle beta, seen from the centre; rings x segments quads.
inline Scene sphericalCap(double beta, int rings, int segments) {
  Scene s;
  const uint32_t m = addMaterial(s, {.5f, .5f, .5f});
  const auto at = [&](int r, int k) {
    const double t = beta * r / rings, p = 2 * std::numbers::pi * (k % segments) / segments;
    return Vec3{static_cast<float>(std::sin(t) * std::cos(p)), static_cast<float>(std::cos(t)),
                static_cast<float>(std::sin(t) * std::sin(p))};
  };
  for (int r = 0; r < rings; ++r)
    for (int k = 0; k < segments; ++k) {
      if (r > 0) addTriangle(s, at(r, k), at(r + 1, k + 1), at(r, k + 1), m);
      addTriangle(s, at(r, k), at(r + 1, k), at(r + 1, k + 1), m);
    }
  return s;
}

struct CastScene {
  Scene scene;
  PatchSet set;
  HitRows rows;
};

inline CastScene cast(Scene scene, float cell_m, uint32_t rays, uint64_t seed = 1) {
  CastScene c{std::move(scene), {}, {}};
  const auto caster = RayCaster::create(c.scene);
  c.set = *makePatches(c.scene, {.cell_m = cell_m}, &*caster);
  WorkCount done;
  c.rows = castRows(c.scene, c.set, *caster, rays, seed, done);
  return c;
}

// The same as if geometry told nothing of what hits stand for.
inline HitRows counts(HitRows rows) {
  std::fill(rows.estimate.begin(), rows.estimate.end(), 0u);
  std::fill(rows.whole.begin(), rows.whole.end(), uint8_t{0});
  return rows;
}

inline uint32_t materialOf(const CastScene& c, uint32_t patch) {
  return c.scene.triangles[c.set.triangles[c.set.patches[patch].first_triangle].source].material;
}

// Area-weighted form factor from all patches of material `from` to all of material `to`.
inline double formFactor(const CastScene& c, uint32_t from, uint32_t to) {
  double area = 0, exchange = 0;
  for (uint32_t i = 0; i < c.set.patches.size(); ++i) {
    if (materialOf(c, i) != from) continue;
    const double a = static_cast<double>(c.set.patches[i].area_m2);
    area += a;
    for (uint64_t k = c.rows.start[i]; k < c.rows.start[i + 1]; ++k)
      if (materialOf(c, c.rows.column[k]) == to) exchange += a * c.rows.count[k] / c.rows.rays[i];
  }
  return exchange / area;
}

}  // namespace ff::bake::test
