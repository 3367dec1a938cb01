// What a material is like at and over a piece of surface: albedo, emission, holes.
#pragma once
#include "bake/scene.h"

namespace ff::bake {

// Of a triangle's corners, m: what rounding of a point on it is in proportion to.
float largestCoordinate(const Scene& scene, uint32_t t);
// How many sides have patches: 0 (in the light's way only) to 2.
inline int patchedSides(const Material& m) { return m.occlude_only ? 0 : m.double_sided ? 2 : 1; }
float triangleArea(const Scene& scene, uint32_t t);  // m2
// Share of the light that does not pass at a point, 0..1; b, c: barycentric weights of corners 1 and 2.
float solidity(const Scene& scene, uint32_t t, float b, float c);
// Whether a ray passes at a point: chosen by a hash of triangle and point, so that of many rays the right share does.
bool isHole(const Scene& scene, uint32_t t, float b, float c);
// Whether a ray of the surface itself may start at a point: chosen likewise, by solidity over the material's largest.
bool mayStart(const Scene& scene, uint32_t t, float b, float c);
// Whether most light passes everywhere (panes, gauze): such surfaces are not drawn, and cast no shadows in pictures.
bool isSeenThrough(const Material& material);
// Barycentric weights of corners 1 and 2 at point p of triangle t's plane.
std::pair<float, float> barycentric(const Scene& scene, uint32_t t, Vec3 p);

// Area-weighted means over pieces. Vertex colours are linear over a piece and averaged exactly; pictures at about a point a
// texel, well spread, kLeastPoints to kMaxPoints of them, or kLeastLampPoints to kMaxLampPoints where the surface emits what a picture
// says: a small bright spot must not be missed.
inline constexpr double kLeastPoints = 16, kMaxPoints = 256, kLeastLampPoints = 64, kMaxLampPoints = 16384;
class SurfaceMean {
 public:
  explicit SurfaceMean(float metals) : metals_(metals) {}  // see PatchSettings::metals
  // Adds piece (p, q, r) of scene triangle t, area_m2 large; returns the fraction of it that is not hole.
  float add(const Scene& scene, uint32_t t, Vec3 p, Vec3 q, Vec3 r, float area_m2);
  Vec3 albedo() const;
  Vec3 emission() const;  // radiosity, W/m2: pi * radiance

 private:
  float metals_;
  double weight_ = 0;
  double albedo_[3] = {}, emission_[3] = {};
};

}  // namespace ff::bake
