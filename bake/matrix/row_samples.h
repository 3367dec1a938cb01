// How many samples a row needs. Where most of what a patch gets comes from few bright surfaces (a ceiling lit by the sill of a
// window that the sun shines on), the row's Q samples meet each of them once or not at all, and its neighbours' rows do
// otherwise: clouds. So a row's error is measured before the row is sampled: the samples of sampleRow() for all offsets that are
// multiples of 1/16 are those of one row with 16 times as many, and how far their light spreads is the error. It is measured under
// some lights of which a world is likely to see one: the sky alone, the sky with a low sun from each of four sides and with the scene's
// own, and the scene's lamps.
// A row that errs by more than the bounds below, under any of them, is given twice, four or eight times as many samples.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "bake/matrix/pool.h"
#include "bake/rays/ray_caster.h"
#include "bake/surface/patches.h"

namespace ff::bake {

// Standard deviation of a row's light, of all the light that the node gets; by day of 1/64 of an open, level patch's skylight as well.
inline constexpr double kDayRowError = 1.0 / 16, kDayDark = 1.0 / 64, kLampRowError = 1.0 / 4;

inline constexpr size_t kSuns = 5;          // the last is the scene's brightest directional light; dark where it has none
using SunLight = std::array<float, kSuns>;  // on a patch from each, of an open, level patch's skylight

// By patch, from a few points of each, on all of TBB's threads. Positions as the caster has them.
PagedVector<SunLight> sunOnPatches(const Scene& scene, const PatchSet& set, const RayCaster& caster, uint64_t seed);

// Each of the suns with the sky, the sky, the lamps; W/m2.
inline constexpr size_t kSky = kSuns, kLamps = kSuns + 1, kLights = kSuns + 2;
using LightValues = std::array<float, kLights>;

// Irradiance of a patch from the lights themselves.
LightValues directLight(const ExchangeRow& row, float area_m2, const SunLight& sun);
// What a surface reflects of `direct`, and of what its row brings of others' radiosity, by column; that is empty: nothing.
LightValues reflectedLight(Vec3 albedo, float area_m2, const LightValues& direct, const ExchangeRow& row, std::span<const LightValues> radiosity);

// How many times as many samples as `quanta` a row needs: 1 to formats::kMaxRowFactor. radiosity: of what the row's columns reflect, once light has bounced
// twice.
uint32_t rowFactor(const LightValues& direct, const ExchangeRow& row, uint32_t quanta, std::span<const LightValues> radiosity);

}  // namespace ff::bake
