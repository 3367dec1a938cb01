#include "tools/scene/analytic.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "formats/portable_math.h"

namespace ff::tools {
namespace {

constexpr double kPi = std::numbers::pi;

SceneMaterial diffuse(const char* name, float albedo, float emission_w_m2) {
  const float radiance = emission_w_m2 / static_cast<float>(kPi);
  return {name, {albedo, albedo, albedo}, {radiance, radiance, radiance}};
}

// The vertex of `part` at `p`, added if there is none yet. Linear search: for parts of a few vertices.
uint32_t vertexAt(ScenePart& part, Vec3 p) {
  const auto it = std::ranges::find(part.positions, p);
  const auto i = static_cast<uint32_t>(it - part.positions.begin());
  if (it == part.positions.end()) part.positions.push_back(p);
  return i;
}

// Counter-clockwise seen from the front: the normal is (b - a) x (d - a).
void quad(ScenePart& part, Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  const std::array<uint32_t, 4> v{vertexAt(part, a), vertexAt(part, b), vertexAt(part, c), vertexAt(part, d)};
  part.indices.insert(part.indices.end(), {v[0], v[1], v[2], v[0], v[2], v[3]});
}

enum Face { kLeft, kRight, kFloor, kCeiling, kBack, kFront };

// One face of a box, facing inwards.
void innerFace(ScenePart& part, Vec3 lo, Vec3 hi, Face face) {
  const auto at = [&](int x, int y, int z) { return Vec3{x ? hi.x : lo.x, y ? hi.y : lo.y, z ? hi.z : lo.z}; };
  if (face == kLeft) quad(part, at(0, 0, 0), at(0, 1, 0), at(0, 1, 1), at(0, 0, 1));
  if (face == kRight) quad(part, at(1, 0, 0), at(1, 0, 1), at(1, 1, 1), at(1, 1, 0));
  if (face == kFloor) quad(part, at(0, 0, 0), at(0, 0, 1), at(1, 0, 1), at(1, 0, 0));
  if (face == kCeiling) quad(part, at(0, 1, 0), at(1, 1, 0), at(1, 1, 1), at(0, 1, 1));
  if (face == kBack) quad(part, at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0));
  if (face == kFront) quad(part, at(0, 0, 1), at(0, 1, 1), at(1, 1, 1), at(1, 0, 1));
}

void innerBox(ScenePart& part, Vec3 lo, Vec3 hi) {
  for (const Face face : {kLeft, kRight, kFloor, kCeiling, kBack, kFront}) innerFace(part, lo, hi, face);
}

SceneModel twoSurfaces(const char* name, float albedo, float emission_w_m2, ScenePart first, ScenePart second) {
  SceneModel m;
  m.name = name;
  m.materials = {diffuse("first", albedo, emission_w_m2), diffuse("second", albedo, 0)};
  first.material = 0;
  second.material = 1;
  m.nodes = {{"first", {std::move(first)}}, {"second", {std::move(second)}}};
  return m;
}

// A disc around the y axis at height y; the front is up or down.
ScenePart disc(float y, int segments, bool up) {
  const double step = 2 * kPi / segments, radius = std::sqrt(step / sineCosine(step).sine);
  ScenePart p;
  p.positions.push_back({0, y, 0});
  for (int i = 0; i < segments; ++i) {
    const auto [sine, cosine] = sineCosine(i * step);
    p.positions.push_back({static_cast<float>(radius * cosine), y, static_cast<float>(radius * sine)});
  }
  for (int i = 0; i < segments; ++i) {
    const auto a = static_cast<uint32_t>(1 + i), b = static_cast<uint32_t>(1 + (i + 1) % segments);
    p.indices.insert(p.indices.end(), {0u, up ? b : a, up ? a : b});
  }
  return p;
}

}  // namespace

SceneModel furnaceBox(float albedo, float emission_w_m2) {
  SceneModel m;
  m.name = "box";
  m.materials = {diffuse("wall", albedo, emission_w_m2)};
  m.nodes.resize(1);
  m.nodes[0].name = "box";
  m.nodes[0].parts.resize(1);
  innerBox(m.nodes[0].parts[0], {0, 0, 0}, {1, 1, 1});
  return m;
}

SceneModel parallelPlates(float gap, float albedo, float emission_w_m2) {
  ScenePart below, above;
  innerFace(below, {0, 0, 0}, {1, gap, 1}, kFloor);
  innerFace(above, {0, 0, 0}, {1, gap, 1}, kCeiling);
  return twoSurfaces("parallel plates", albedo, emission_w_m2, below, above);
}

SceneModel perpendicularPlates(float albedo, float emission_w_m2) {
  ScenePart below, beside;
  innerFace(below, {0, 0, 0}, {1, 1, 1}, kFloor);
  innerFace(beside, {0, 0, 0}, {1, 1, 1}, kLeft);
  return twoSurfaces("perpendicular plates", albedo, emission_w_m2, below, beside);
}

SceneModel coaxialDiscs(float gap, int segments, float albedo, float emission_w_m2) {
  return twoSurfaces("discs", albedo, emission_w_m2, disc(0, segments, true), disc(gap, segments, false));
}

SceneModel sphericalCap(float half_angle_degrees, int segments, float albedo, float emission_w_m2) {
  const double half_angle = half_angle_degrees * kPi / 180;
  const int rings = std::max(2, static_cast<int>(std::lround(segments * half_angle / (2 * kPi))));
  ScenePart p;
  p.positions.push_back({0, 1, 0});
  for (int r = 1; r <= rings; ++r)
    for (int s = 0; s < segments; ++s) {
      const SineCosine polar = sineCosine(half_angle * r / rings), around = sineCosine(2 * kPi * s / segments);
      p.positions.push_back({static_cast<float>(polar.sine * around.cosine), static_cast<float>(polar.cosine),
                             static_cast<float>(polar.sine * around.sine)});
    }
  const auto at = [&](int r, int s) { return static_cast<uint32_t>(r == 0 ? 0 : 1 + (r - 1) * segments + s % segments); };
  for (int r = 0; r < rings; ++r)
    for (int s = 0; s < segments; ++s) {
      if (r > 0) p.indices.insert(p.indices.end(), {at(r, s), at(r + 1, s), at(r, s + 1)});
      p.indices.insert(p.indices.end(), {at(r, s + 1), at(r + 1, s), at(r + 1, s + 1)});
    }
  SceneModel m;
  m.name = "cap";
  m.materials = {diffuse("cap", albedo, emission_w_m2)};
  m.nodes = {{"cap", {std::move(p)}}};
  return m;
}

SceneModel twoRooms(float wall_m, float albedo, float emission_w_m2) {
  SceneModel m;
  m.name = "two rooms";
  m.materials = {diffuse("lit room", albedo, 0), diffuse("dark room", albedo, 0), diffuse("lamp", albedo, emission_w_m2)};
  ScenePart lit, dark, lamp;
  for (const Face face : {kLeft, kRight, kFloor, kBack, kFront}) innerFace(lit, {0, 0, 0}, {4, 3, 4}, face);
  // The ceiling in nine parts, the middle one is the lamp.
  constexpr std::array<float, 4> cut{0, 1.5f, 2.5f, 4};
  for (size_t i = 0; i < 3; ++i)
    for (size_t j = 0; j < 3; ++j)
      innerFace(i == 1 && j == 1 ? lamp : lit, {cut[i], 0, cut[j]}, {cut[i + 1], 3, cut[j + 1]}, kCeiling);
  innerBox(dark, {4 + wall_m, 0, 0}, {8 + wall_m, 3, 4});
  dark.material = 1;
  lamp.material = 2;
  m.nodes = {{"lit room", {std::move(lit), std::move(lamp)}}, {"dark room", {std::move(dark)}}};
  return m;
}

SceneModel corridor(float albedo, float emission_w_m2) {
  SceneModel m;
  m.name = "corridor";
  m.materials = {diffuse("wall", albedo, 0), diffuse("lamp", albedo, emission_w_m2)};
  ScenePart wall, lamp;
  const Vec3 lo{0, 0, 0}, hi{20, 2, 2};
  for (const Face face : {kRight, kFloor, kCeiling, kBack, kFront}) innerFace(wall, lo, hi, face);
  innerFace(lamp, lo, hi, kLeft);
  lamp.material = 1;
  m.nodes = {{"corridor", {std::move(wall), std::move(lamp)}}};
  return m;
}

}  // namespace ff::tools
