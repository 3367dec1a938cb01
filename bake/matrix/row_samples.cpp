#include "bake/matrix/row_samples.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <limits>

#include "bake/light/surface_points.h"
#include "formats/model.h"

namespace ff::bake {
namespace {

constexpr uint32_t kOffsets = 2 * formats::kMaxRowFactor;  // two for the rows with the most samples
constexpr uint32_t kSunPoints = 8;   // of a patch
constexpr float kSunOverSky = 3.5f;  // on a patch that faces it, of an open, level patch's skylight: a clear day
// The suns stand 30 degrees high, so that they shine through windows and between the slats of blinds (from 45 degrees none
// shines into the dining room), and 20 degrees off the axes, which most walls follow.
constexpr float kSunUp = 0.5f, kSunAlong = 0.8137977f, kSunAcross = 0.2961981f;

// Towards each; zero: there is none.
std::array<Vec3, kSuns> sunsOf(const Scene& scene) {
  std::array<Vec3, kSuns> suns{{{kSunAlong, kSunUp, kSunAcross}, {-kSunAcross, kSunUp, kSunAlong}, {-kSunAlong, kSunUp, -kSunAcross}, {kSunAcross, kSunUp, -kSunAlong}}};
  float brightest = 0;
  for (const formats::Light& light : scene.lights) {
    const Vec3 irradiance = light.color_intensity;
    const float sum = irradiance.x + irradiance.y + irradiance.z;
    if (light.kind != formats::Light::kDirectional || !(sum > brightest)) continue;
    brightest = sum;
    suns.back() = light.direction * -1;
  }
  return suns;
}

}  // namespace

PagedVector<SunLight> sunOnPatches(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint64_t seed) {
  PagedVector<SunLight> light(set.patches.size());
  const SobolTable sobol(kSunPoints);
  const std::array<Vec3, kSuns> suns = sunsOf(scene);
  tbb::parallel_for(uint32_t{0}, static_cast<uint32_t>(light.size()), [&](uint32_t p) {
    std::array<SurfacePoint, kSunPoints> points;
    surfacePoints(scene, set, p, sobol, seed, caster, points);
    for (size_t s = 0; s < kSuns; ++s)
      for (const SurfacePoint& point : points) {
        const float cosine = dot(point.normal, suns[s]);
        if (cosine > 0 && !caster.occluded({point.position, suns[s]}, std::numeric_limits<float>::infinity()))
          light[p][s] += kSunOverSky * cosine / kSunPoints;
      }
  });
  return light;
}

LightValues directLight(const ExchangeRow& row, float area_m2, const SunLight& sun) {
  LightValues direct{};
  direct[kSky] = static_cast<float>(row.sky_m2) / area_m2;
  for (size_t s = 0; s < kSuns; ++s) direct[s] = direct[kSky] + sun[s];
  for (const LampIrradiance& lamp : row.lamps)
    for (const double watts : lamp.rgb) direct[kLamps] += static_cast<float>(watts) / area_m2 / 3;
  return direct;
}

LightValues reflectedLight(Vec3 albedo, float area_m2, const LightValues& direct, const ExchangeRow& row, std::span<const LightValues> radiosity) {
  std::array<double, kLights> gathered{};  // W
  if (!radiosity.empty())
    for (size_t k = 0; k < row.column.size(); ++k)
      for (size_t l = 0; l < kLights; ++l) gathered[l] += row.area_m2[k] * static_cast<double>(radiosity[row.column[k]][l]);
  LightValues reflected;
  for (size_t l = 0; l < kLights; ++l)
    reflected[l] = (albedo.x + albedo.y + albedo.z) / 3 * static_cast<float>(static_cast<double>(direct[l]) + gathered[l] / static_cast<double>(area_m2));
  return reflected;
}

uint32_t rowFactor(const LightValues& direct, const ExchangeRow& row, uint32_t quanta, std::span<const LightValues> radiosity) {
  const double sum = row.total_m2();
  if (!(sum > 0)) return 1;
  using Sums = std::array<double, std::bit_ceil(kLights)>;  // whole vectors of any processor
  std::array<Sums, kOffsets> light{};  // of the row's samples at each offset, added up
  const double scale = kOffsets * quanta / sum;
  double at = 0;
  uint64_t taken = 0;
  for (size_t k = 0; k < row.column.size(); ++k) {
    at += row.area_m2[k] * scale;
    const auto reached = static_cast<uint64_t>(at);
    if (reached == taken) continue;
    Sums from{};
    for (size_t l = 0; l < kLights; ++l) from[l] = static_cast<double>(radiosity[row.column[k]][l]);
    const uint64_t rounds = (reached - taken) / kOffsets;
    if (rounds > 0) {
      Sums of_rounds;
      for (size_t l = 0; l < from.size(); ++l) of_rounds[l] = static_cast<double>(rounds) * from[l];
      for (Sums& sums : light)
        for (size_t l = 0; l < from.size(); ++l) sums[l] += of_rounds[l];
    }
    for (taken += rounds * kOffsets; taken < reached; ++taken)
      for (size_t l = 0; l < from.size(); ++l) light[taken % kOffsets][l] += from[l];
  }
  uint32_t factor = 1;
  for (size_t l = 0; l < kLights; ++l) {
    double mean = 0;
    for (const auto& sums : light) mean += sums[l] / kOffsets;
    const double got = static_cast<double>(direct[l]) * quanta + mean;
    const double bound = l == kLamps ? kLampRowError * got : kDayRowError * (got + kDayDark * quanta);
    // A row with twice as many samples is the mean of two rows half a step apart.
    uint32_t offsets = kOffsets;
    for (uint32_t own = 1;; own *= 2, offsets /= 2) {
      double square = 0;
      for (uint32_t p = 0; p < offsets; ++p) square += (light[p][l] - mean) * (light[p][l] - mean) / offsets;
      if (square <= bound * bound || own == formats::kMaxRowFactor) break;
      factor = std::max(factor, 2 * own);
      for (uint32_t p = 0; p < offsets / 2; ++p) light[p][l] = (light[p][l] + light[p + offsets / 2][l]) / 2;
    }
  }
  return factor;
}

}  // namespace ff::bake
